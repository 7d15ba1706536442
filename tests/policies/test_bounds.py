"""Certified bounds: against closed forms, against the physics, and against every row."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servogym.envs import ON_MODELS, TASKS
from servogym.envs.plants.axis_parameters import LinearAxisParameters
from servogym.envs.plants.rotary_parameters import CONVEYOR
from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.robot import RobotEnv
from servogym.envs.tasks.rotary import RotaryAxisEnv
from servogym.envs.tasks.tracking import LinearAxisTrackingEnv
from servogym.training.evaluate import comparison
from servogym.training.policies import SHIPPED, make, names, needed
from servogym.training.policies.bound import BOUNDS, Bound, _farthest
from servogym.training.policies.bounds.errors import least_squares
from servogym.training.policies.bounds.plant import LOAD, plant
from servogym.training.policies.bounds.times import Question, least_ticks, outside

MOVE = {"start": 0.1, "goal": 0.3}
ALL = (*TASKS, *ON_MODELS)
FREE = {"coulomb_friction": 0.0, "viscous_friction": 0.0}


def begun(task=LinearAxisEnv, options=MOVE, **arguments):
    env = task(**arguments)
    env.reset(seed=1, options=options)
    return env


def force_and_mass(env):
    axis, gear = env.machine.axes[0], float(env.machine.couplings[0]["gear"])
    inertia = np.zeros((env.machine.model.nv,) * 2)
    data = mujoco.MjData(env.machine.model)
    mujoco.mj_forward(env.machine.model, data)
    mujoco.mj_fullM(env.machine.model, data, inertia)
    return float(axis["torque_limit_positive"]) * gear, float(inertia.sum())


def test_a_free_mass_takes_full_force_forth_and_back():
    env = begun(parameters=LinearAxisParameters(**FREE), tolerance=1e-6)
    force, mass = force_and_mass(env)
    expected = 2.0 * math.sqrt(0.2 * mass / force)
    found = make("bound", env).values()["settling_time"]
    assert 0.99 * expected < found < expected + 1.5e-3, "the lag of the current loop is 0.3 ms"


def test_a_set_point_that_is_slow_takes_its_time_and_half_a_ramp():
    env = begun(parameters=LinearAxisParameters(**FREE), tolerance=1e-6)
    force, mass = force_and_mass(env)
    asked = Question(0.3, 1e-6, 1, 4000, 80, speed=0.5, ahead=1e-6)
    expected = 0.2 / 0.5 + 0.5 * 0.5 * mass / force
    found = least_ticks(plant(env, 4000), asked) * env.machine.model.opt.timestep
    assert 0.99 * expected < found < 1.01 * expected


def test_a_soft_spring_takes_longer_and_a_stiff_one_as_long_as_none():
    times = []
    for stiffness in (3e3, 3e7):
        parameters = LinearAxisParameters(stiffness=stiffness, structural_damping=5.0, **FREE)
        env = begun(CompliantAxisEnv, parameters=parameters, randomise={})
        times.append(make("bound", env).values()["settling_time"])
    rigid = begun(parameters=LinearAxisParameters(**FREE), tolerance=100e-6)
    assert times[1] == pytest.approx(make("bound", rigid).values()["settling_time"], rel=0.02)
    assert times[0] > 1.1 * times[1]


@pytest.mark.parametrize("name", ["rigid", "vertical", "spring"])
def test_the_plant_is_the_physics(name):
    """Torques of chance, played by the drive in cst, and the same through the responses."""
    spring = {"stiffness": 2e4, "structural_damping": 6.3} if name == "spring" else {}
    slope = 90.0 if name == "vertical" else 0.0
    parameters = LinearAxisParameters(**(FREE | spring), inclination=slope)
    env = begun(options={"start": 0.25, "goal": 0.3}, mode="cst", parameters=parameters)
    steps = 20
    ticks = round(env.step_time / env.machine.model.opt.timestep)
    whole = plant(env, steps * ticks)
    random, torques, places = np.random.default_rng(0), [], []
    elastic = [env.machine.model.joint("load").qposadr[0]] if spring else []
    for _ in range(steps):
        env.step(random.uniform(-0.3, 0.3, 1).astype(np.float32))
        torques.append(float(env.machine.axes[0]["torque_command"]))
        places.append(
            env.machine.data.qpos[0] + sum(float(env.machine.data.qpos[q]) for q in elastic)
        )
    at = ticks * (1 + np.arange(steps))
    command = np.repeat(torques, ticks)
    predicted = whole.free[at, LOAD] + whole.inputs[0].rows(at, LOAD) @ command[: at[-1]]
    assert np.abs(predicted - places).max() < 2e-6, "a cycle until the torque is taken over"


def test_no_torque_of_chance_is_nearer_than_the_certificate_says():
    env = begun(CompliantAxisEnv)
    whole = plant(env, 1200)
    asked = Question(0.3, 100e-6, 1, 1200, 400)
    sure = outside(whole, asked, 200)
    assert sure > 0.0
    random = np.random.default_rng(2)
    at = np.arange(200, 601)
    rows = [response.rows(at, LOAD) for response in whole.inputs]
    for _ in range(200):
        place = whole.free[at, LOAD].copy()
        for response, matrix in zip(whole.inputs, rows, strict=True):
            width = matrix.shape[1]
            signs = np.repeat(random.choice((-1.0, 1.0), width // 20 + 1), 20)[:width]
            place += matrix @ np.where(signs > 0, response.high, response.low)
        assert np.abs(place - 0.3).max() - 100e-6 >= sure


def test_a_jump_of_the_reference_leaves_an_error_and_a_slow_one_none():
    env = begun(LinearAxisTrackingEnv, {"reference": "step", "start": 0.2}, randomise={})
    every = round(env.step_time / env.machine.model.opt.timestep)
    whole = plant(env, 25 * every)
    jump = np.where(np.arange(100) < 50, 0.2, 0.202)
    force, mass = force_and_mass(env)
    found = least_squares(whole, jump, every, 0.0)
    within = (
        0.25 * force / mass * env.step_time**2
    )  # that it moves within a step, from rest to rest
    assert 0.0 < math.sqrt(found) < 0.002 - within
    assert least_squares(whole, 0.2 + 1e-3 * np.sin(np.arange(100) / 20), every, 0.0) < 1e-18


def test_mechanics_without_a_bound_are_refused():
    parameters = LinearAxisParameters(transmission_stiffness=2e7, backlash=1e-5)
    with pytest.raises(ValueError, match="linear mechanics"):
        Bound(begun(parameters=parameters))


def test_a_free_roller_takes_full_torque_forth_and_back():
    """A conveyor whose window of the following error leaves the set-points no say."""
    parameters = replace(CONVEYOR, coulomb_friction=0.0, viscous_friction=0.0)
    options = {"start": 0.5, "goal": 1.0}
    env = begun(RotaryAxisEnv, options, parameters=parameters, following_error_window=10.0)
    force, inertia = force_and_mass(env)
    expected = 2.0 * math.sqrt(0.5 * inertia / force)
    found = make("bound", env).values()["settling_time"]
    assert expected - 2 * env.step_time < found <= expected + 1e-3


def test_the_shorter_way_round_is_what_counts():
    """Over the end of the range: 0.4 rad at 6 rad/s, less what the axis may be ahead."""
    period = 2 * math.pi
    ends = {"start": 0.2, "goal": period - 0.2}
    env = begun(RotaryAxisEnv, ends)
    near = env.tolerance + 0.05 + 2 / env.units
    steps = math.ceil((0.4 - near) / env.episode._way) - 1
    assert steps > 5
    found = make("bound", env).values()["settling_time"]
    assert found == pytest.approx(steps * env.step_time, abs=0.1 * env.step_time)
    there = begun(RotaryAxisEnv, {"start": 1.0, "goal": 1.0})
    assert make("bound", there).values()["settling_time"] == 0.0


@settings(deadline=None)
@given(
    st.floats(0.2, 3.0), st.floats(0.05, 1.0), st.floats(0.0, 20.0),
    st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60),
)
def test_no_set_point_that_can_stop_in_time_is_ahead_of_the_farthest(most, ramp, left, wanted):
    """Steps of chance, of which those are taken from which a full stop is within the limit."""
    farthest = _farthest(most, ramp, left, len(wanted))
    place = step = 0.0
    for n, share in enumerate(wanted):
        asked = min(max(2.0 * share * most, step - ramp), step + ramp, most)
        stopping, slower = asked, asked - ramp
        while slower > 0.0:
            stopping, slower = stopping + slower, slower - ramp
        step = asked if place + max(stopping, asked) <= left else max(step - ramp, 0.0)
        place += step
        assert place <= farthest[n + 1] + 1e-9
    assert farthest[-1] <= left + 1e-9


def test_the_farthest_set_point_is_the_trapezoid_of_the_profile():
    """From rest to rest: way / speed + speed / acceleration."""
    places = _farthest(0.02, 0.0005, 1.0, 400)
    there = int(np.argmax(places > 1.0 - 1e-9))
    assert there == pytest.approx(1.0 / 0.02 + 0.02 / 0.0005, abs=2)
    assert np.diff(places).max() <= 0.02 + 1e-12
    assert np.abs(np.diff(places, 2)).max() <= 0.0005 + 1e-12


def test_the_return_of_a_robot_is_bounded_step_by_step():
    """One joint 1 rad away: nothing is earned for being settled until its set-point is near."""
    env = begun(RobotEnv, {"goal": {"turn": 1.0, "shoulder": 0.0, "elbow": 0.0}})
    limit = make("bound", env).values()
    speed, rate = env.episode._way[0] / env.step_time, env.episode._ramp[0] / env.step_time**2
    near = env.tolerance + float(env.episode._windows[0])
    fastest = (1.0 + near) / speed + speed / rate - 2.0 * math.sqrt(near / rate)
    assert limit["settling_time"] == pytest.approx(fastest, abs=3 * env.step_time)
    unsettled = limit["settling_time"] / env.step_time
    assert env.STEPS - unsettled < limit["episode_return"] < env.STEPS - 0.3 * unsettled


def test_every_task_has_a_bound():
    assert {task.BOUND for task in ALL} == BOUNDS.keys()
    assert all("bound" in task.POLICIES for task in ALL)


def above(task, rows, episodes, seed):
    """Rows that are better than the bound in an episode, with how much."""
    arguments = {}
    [bound] = comparison.evaluate(task.ID, ["bound"], "generic", episodes, seed, arguments)
    found = []
    for row in rows:
        [result] = comparison.evaluate(task.ID, [row], "generic", episodes, seed, arguments)
        for metric, limit in bound.values.items():
            if metric not in result.metrics or not np.isfinite(limit).any():
                continue  # a score follows from the others
            sign = -1.0 if result.metrics[metric].better == "low" else 1.0
            fair = np.array([not fault for fault in result.faults])
            better = sign * (result.values[metric] - np.tile(limit, result.trainings))
            if (better[fair] > 1e-9).any():
                found.append((row, metric, float(better[fair].max())))
    return found


QUICK = {
    "servogym/LinearAxis-v0": ["ruckig", "informed_ruckig"],
    "servogym/LinearAxisTracking-v0": ["basis_feed_forward"],
    "servogym/CompliantAxis-v0": ["informed_ruckig+zvd", "adaptive_lqr"],
    "servogym/GantrySway-v0": ["informed_ruckig+zv"],
    "servogym/GantrySync-v0": ["informed_squaring"],
    "servogym/Homing-v0": ["informed_search", "built_in_fast"],
    "servogym/Commissioning-v0": ["informed_plc"],
    "servogym/RotaryAxis-v0": ["ruckig", "tuned_proportional"],
    "servogym/Robot-v0": ["trapezoid"],
}


@pytest.mark.parametrize("name", QUICK)
def test_a_sample_of_rows_stays_behind_the_bound(name):
    [task] = [task for task in ALL if name == task.ID]
    assert not above(task, QUICK[name], 3, 0)


@pytest.mark.slow
@pytest.mark.parametrize("task", ALL, ids=lambda task: task.ID)
def test_no_row_is_above_its_bound_in_any_episode(task):
    rows = [row for row in names(task()) if row != "bound" and not needed(row)]
    learned = ["learned"] if (SHIPPED / task.ID.rpartition("/")[2]).is_dir() else []
    assert not above(task, [*rows, *learned], 20, 0)
