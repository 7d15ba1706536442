"""MuJoCo's clock stands still while a machine is stepped, and in nothing that is not ours."""

import multiprocessing
import os
import threading
import time

import mujoco
import pytest

from servogym.envs import linear_axis
from servogym.envs.engine.clock import clock

STEP = int(mujoco.mjtTimer.mjTIMER_POSITION)
FOREIGN = (
    '<mujoco><worldbody><body><joint type="slide"/><geom size="1"/></body></worldbody></mujoco>'
)


def timed(steps=50):
    """Seconds MuJoCo's timer has for steps of somebody else's model; what all of them took."""
    model = mujoco.MjModel.from_xml_string(FOREIGN)
    data = mujoco.MjData(model)
    begin = time.perf_counter()
    mujoco.mj_step(model, data, steps)
    passed = time.perf_counter() - begin
    assert data.timer[STEP].number == steps
    durations = [data.timer[i].duration for i in range(int(mujoco.mjtTimer.mjNTIMER))]
    assert all(0.0 <= each <= passed for each in durations), (durations, passed)
    return data.timer[STEP].duration


def test_the_timers_of_a_machine_count_but_take_no_time():
    machine = linear_axis()
    before, taken = machine.data.timer[STEP].number, machine.data.timer[STEP].duration
    machine.step(3)
    assert machine.data.timer[STEP].number == before + 3 * machine.physics_steps
    assert machine.data.timer[STEP].duration == taken


def test_the_clock_goes_on_for_others():
    assert timed() > 0.0
    linear_axis().step()
    assert timed() > 0.0


def test_it_goes_on_after_a_step_that_failed():
    machine = linear_axis()

    def fail(model, data):
        raise ArithmeticError("of the user's own")

    mujoco.set_mjcb_control(fail)
    try:
        with pytest.raises(ArithmeticError):
            machine.step()
    finally:
        mujoco.set_mjcb_control(None)
    assert timed() > 0.0


def test_a_clock_of_the_users_own_is_read_and_kept():
    machine, calls = linear_axis(), [0]

    def count():
        calls[0] += 1
        return float(calls[0])

    mujoco.set_mjcb_time(count)
    try:
        machine.step()
        assert calls[0] > 0
        assert mujoco.get_mjcb_time() is count
    finally:
        mujoco.set_mjcb_time(None)
    assert timed() > 0.0


def test_a_clock_set_while_machines_are_stepped_is_kept():
    with clock:
        mujoco.set_mjcb_time(time.perf_counter)
    try:
        assert mujoco.get_mjcb_time() is time.perf_counter
    finally:
        mujoco.set_mjcb_time(None)
    assert timed() > 0.0


def test_it_stands_still_for_the_thread_inside_alone():
    inside, leave = threading.Barrier(3), threading.Event()
    seen = []

    def stay():
        with clock:
            seen.append(timed())
            inside.wait()
            leave.wait()
        seen.append(timed())

    threads = [threading.Thread(target=stay) for _ in range(2)]
    for thread in threads:
        thread.start()
    inside.wait()
    assert timed() > 0.0
    leave.set()
    for thread in threads:
        thread.join()
    assert seen[:2] == [0.0, 0.0]
    assert min(seen[2:]) > 0.0


def test_timers_of_others_in_other_threads_hold_what_their_steps_took():
    """Each duration lies between 0 and what passed, while machines come and go beside it."""
    over = threading.Event()

    def step(machine):
        while not over.is_set():
            machine.step()

    threads = [threading.Thread(target=step, args=(linear_axis(),)) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(100):
            assert timed(200) > 0.0
    finally:
        over.set()
        for thread in threads:
            thread.join()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_child_forked_in_the_middle_has_it_going():
    with clock:
        with multiprocessing.get_context("fork").Pool(1) as pool:
            taken = pool.apply(timed)
        assert timed() == 0.0
    assert taken > 0.0
    assert timed() > 0.0
