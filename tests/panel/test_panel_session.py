"""The panel without a browser: what is commanded, what is shown, what is refused."""

import json
import time

import numpy as np
import pytest

from servogym.drive.kernel.words import State
from servogym.drive.trace import Edge
from servogym.envs.panel.clock import Clock
from servogym.envs.panel.recorder import Run
from servogym.envs.panel.session import Session
from servogym.envs.plants.linear_axis import linear_axis


@pytest.fixture
def session():
    machine = linear_axis()
    machine.reset(positions={"x": 0.12})
    machine.step(4)
    return Session(machine, "test")


@pytest.fixture
def homed(session):
    assert session.enable("x") == ""
    assert session.home("x") == ""
    return session


@pytest.fixture
def clock(homed):
    clock = Clock(homed)
    clock.start()
    yield clock
    clock.stop()


def state(session):
    return State(session.shown()["axes"]["x"]["state"])


# ---------------------------------------------------------------- motions


def test_enable_home_and_move_bring_the_axis_to_the_target(homed):
    assert homed.move("x", 0.25) == ""
    seen = homed.shown()["axes"]["x"]
    assert seen["homed"]
    assert seen["position"] == pytest.approx(250.0, abs=0.03)
    assert homed.move("x", -0.05, relative=True) == ""
    assert homed.shown()["axes"]["x"]["position"] == pytest.approx(200.0, abs=0.05)


def test_a_move_without_power_is_refused_and_says_the_next_step(session):
    assert "Enable" in session.move("x", 0.2)
    assert session.messages[-1].kind == "refused"
    assert state(session) is State.SWITCH_ON_DISABLED


def test_a_target_beyond_the_software_limits_is_refused_before_it_moves(homed):
    before = homed.shown()["axes"]["x"]["position"]
    assert "stroke" in homed.move("x", 0.9)
    assert homed.shown()["axes"]["x"]["position"] == pytest.approx(before, abs=0.02)


def test_stop_drops_the_move_and_leaves_the_axis_enabled(homed):
    homed.master = homed.masters["x"]
    homed.master.move_to(0.4, wait=False)
    homed.advance(0.05)
    assert homed.stop("x") == ""
    stopped = homed.shown()["axes"]["x"]["position"]
    homed.advance(0.5)
    assert state(homed) is State.OPERATION_ENABLED
    assert homed.shown()["axes"]["x"]["position"] == pytest.approx(stopped, abs=0.1)
    assert stopped < 300


def test_jog_runs_until_it_is_given_zero(homed):
    assert homed.jog("x", 0.1) == ""
    begin = homed.shown()["axes"]["x"]["position"]
    homed.advance(1.0)
    assert homed.shown()["axes"]["x"]["position"] - begin == pytest.approx(100.0, rel=0.02)
    assert homed.jog("x", 0.0) == ""
    assert abs(homed.shown()["axes"]["x"]["velocity"]) < 6


def test_a_fault_is_told_with_its_remedy_and_reset_when_its_cause_is_gone(homed):
    drive = homed.machine.drives["x"]
    drive.inject("overvoltage")
    homed.advance(0.01)
    seen = homed.shown()["axes"]["x"]
    assert seen["fault"].startswith("3210h")
    assert "reset is refused" in seen["remedy"]
    assert "still present" in homed.reset_fault("x")
    drive.clear_injected()
    assert homed.reset_fault("x") == ""
    assert state(homed) is State.SWITCH_ON_DISABLED


def test_a_refused_write_says_the_abort_code_in_words(session):
    assert "06090031h" in session.write("x", "max_torque", 60_000_000)
    assert "06020000h" in session.write("x", 0x5FFF, 0, 1)


# ------------------------------------------------------------------ scope


def test_the_trigger_sees_a_single_sample_and_keeps_what_came_before(session):
    scope = session.scope
    session.advance(0.2)
    scope.choose(["statusword", "controlword"])
    scope.set_window(0.1, 0.5)
    scope.set_trigger(Run.SINGLE, "controlword", Edge.RISING, 6)
    session.advance(0.1)
    session.write("x", "controlword", 6)
    session.advance(session.machine.cycle_time)  # for one cycle
    session.write("x", "controlword", 0)
    session.advance(0.2)
    assert scope.state == "stopped"
    assert scope.captures == 1
    times, words = scope._captured[0], scope._captured[1][1]
    assert len(times) == round(0.1 / session.machine.cycle_time)
    assert np.flatnonzero(words == 6).tolist() == [len(times) // 2]  # no sample is missing
    assert np.allclose(np.diff(times), session.machine.cycle_time)


def test_pictures_are_smaller_than_what_they_show_and_lose_no_peak(session):
    scope = session.scope
    scope.choose(["controlword"])
    scope.set_window(5.0, 0.0)
    session.advance(3.0)
    session.write("x", "controlword", 6)
    session.advance(session.machine.cycle_time)
    session.write("x", "controlword", 0)
    session.advance(2.0)
    window = scope.view(500)
    assert 200 < len(window.time) <= 500
    assert window.values.max() == 6
    assert window.time[-1] <= 0
    assert len(scope.csv().splitlines()) == 1 + round(5.0 / scope.period)


def test_normal_waits_for_the_next_event_and_single_for_none(session):
    scope = session.scope
    scope.set_window(0.01, 0.0)
    for run, expected in ((Run.NORMAL, 3), (Run.SINGLE, 1)):
        scope.set_trigger(run, "controlword", Edge.CHANGE)
        for word in (6, 0, 6):
            session.advance(0.02)
            session.write("x", "controlword", word)
        session.advance(0.02)
        assert scope.captures == expected
        session.write("x", "controlword", 0)
        session.advance(0.01)


@pytest.mark.parametrize("names", [[], ["nonsense"], ["axis.od"], [f"axis.{i}" for i in "abc"]])
def test_unknown_channels_leave_the_scope_as_it_is(session, names):
    channels = session.scope.channels
    with pytest.raises(ValueError, match="channel"):
        session.scope.choose(names)
    assert session.scope.channels == channels


def test_a_set_up_is_kept_and_brought_back_and_what_is_none_changes_nothing(session):
    scope = session.scope
    scope.choose(["statusword", "position_actual_value"])
    scope.set_window(0.5, 0.1)
    scope.set_trigger(Run.SINGLE, "statusword", Edge.RISING, 5)
    kept = json.loads(json.dumps(scope.set_up()))
    scope.choose(["controlword"])
    scope.set_trigger(Run.ROLL)
    scope.use(kept)
    assert scope.set_up() == kept
    for wrong in ({}, [], {"channels": []}, kept | {"channels": ["nonsense"]}, kept | {"run": 9},
                  kept | {"span": "long"}, kept | {"more": 1}, kept | {"trigger": 3}):
        with pytest.raises(ValueError, match=r"set-up|channel|Run|convert"):
            scope.use(wrong)
        assert scope.set_up() == kept


def test_a_table_of_the_scope_is_in_the_units_that_are_shown(session):
    session.advance(0.2)
    rows = session.scope.csv({"position_actual_value": (1e-3, "mm")}).splitlines()
    drive = session.scope.csv().splitlines()
    assert rows[0].startswith("time (s),position_actual_value (mm),velocity")
    shown, raw = (float(line.split(",")[1]) for line in (rows[-1], drive[-1]))
    assert shown == pytest.approx(raw * 1e-3)


# --------------------------------------------------------- time, control


def test_a_motion_ends_the_one_before_it(clock):
    first = clock.move(lambda s: s.move("x", 0.45))
    second = clock.move(lambda s: s.stop("x"))
    assert "ended" in first.result(20)
    assert second.result(20) == ""


def at_once_after(clock, *motions):
    """Futures of motions that are given between two cycles, as by quick clicks or keys."""
    return clock.ask(lambda _: [clock.move(motion, **how) for motion, how in motions]).result(20)


def test_enable_clicked_right_after_reset_fault_comes_after_it(clock):
    drive = clock.session.machine.drives["x"]
    clock.ask(lambda _: drive.inject("overvoltage")).result(20)
    assert clock.move(lambda s: s.move("x", 0.3)).result(20)  # words: it begins or ends in a fault
    assert clock.ask(state).result(20) is State.FAULT
    clock.ask(lambda _: drive.clear_injected()).result(20)
    given = at_once_after(
        clock,
        (lambda s: s.reset_fault("x"), {}),
        (lambda s: s.set_mode("x", 1), {}),
        (lambda s: s.enable("x"), {}),
        (lambda s: s.move("x", 0.2), {}),
    )
    assert [each.result(20) for each in given] == [""] * 4
    assert clock.ask(state).result(20) is State.OPERATION_ENABLED


@pytest.mark.parametrize("stop", ["disable", "quick_stop", "stop"])
def test_a_stop_does_not_wait_for_a_reset_that_waits_for_its_cause(clock, stop):
    drive = clock.session.machine.drives["x"]
    clock.ask(lambda _: drive.inject("overvoltage")).result(20)
    assert clock.move(lambda s: s.move("x", 0.3)).result(20)
    begun = []
    given = at_once_after(
        clock,
        (lambda s: begun.append(s.time) or s.reset_fault("x"), {}),
        (lambda s: s.enable("x"), {}),
        (lambda s: (getattr(s, stop)("x"), s.time), {"at_once": True}),
    )
    first, second, ended = (each.result(20) for each in given)
    assert "ended by another command" in first
    assert second
    assert ended[1] - begun[0] < 0.5  # a reset goes on for 2 s
    after = clock.move(lambda s: s.reset_fault("x"))  # carried through again, to its own end
    assert clock.move(lambda s: s.stop("x")).result(20) is not None
    assert "still present" in after.result(20)


def test_time_stands_while_it_is_paused_and_goes_cycle_by_cycle(clock):
    clock.pause(True)
    at = clock.ask(lambda s: s.time).result(20)
    clock.single(3)
    end = time.monotonic() + 20
    three = pytest.approx(3 * clock.session.machine.cycle_time)
    while clock.ask(lambda s: s.time).result(20) - at != three and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(0.05)
    assert clock.ask(lambda s: s.time).result(20) - at == three


@pytest.mark.parametrize("speed", [0.0, 0.05, 11, float("nan")])
def test_a_speed_out_of_range_is_refused(clock, speed):
    with pytest.raises(ValueError, match=r"0\.1\.\.10"):
        clock.set_speed(speed)


def test_an_error_in_a_request_reaches_who_asked_and_time_goes_on(clock):
    with pytest.raises(ZeroDivisionError):
        clock.ask(lambda s: 1 / 0).result(20)
    at = clock.ask(lambda s: s.time).result(20)
    end = time.monotonic() + 20
    while clock.ask(lambda s: s.time).result(20) <= at:
        assert time.monotonic() < end


def test_one_tab_commands_and_taking_over_is_an_act(session):
    control = session.control
    control.take("a")
    with pytest.raises(ValueError, match="another window has control"):
        control.check("b")
    control.take("b")
    assert control.holds("b")
    assert not control.holds("a")
    control.leave("a")  # who does not sit there cannot stand up
    assert control.holder == "b"


def test_a_snapshot_brings_back_where_the_axis_was(homed):
    homed.keep("here")
    before = homed.shown()["axes"]["x"]["position"]
    homed.move("x", 0.3)
    assert homed.back("here") == ""
    assert homed.shown()["axes"]["x"]["position"] == before
    assert homed.back("nowhere")
