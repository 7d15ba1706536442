"""servogym/GantrySway-v0: a load on a cable."""

import math

import numpy as np
import pytest

from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.sway import GantrySwayEnv

G, SPEED = 9.81, 0.4  # m/s², m/s
STEPS = GantrySwayEnv.STEPS


def move(env, way, half_period=None):
    """Actions for a move of `way` (m) at constant speed; shaped with zero vibration (ZV) if a half
    period (s) of the load is given: half of the move now, half of it half a period later."""
    steps = abs(way) / (SPEED * env.step_time)
    plain = np.clip(steps - np.arange(STEPS), 0.0, 1.0) * math.copysign(SPEED, way) / env.speed
    if half_period is None:
        return plain
    late = half_period / env.step_time
    later = np.interp(np.arange(STEPS) - late, np.arange(STEPS), plain, left=0.0)
    return 0.5 * (plain + later)


def half_period(parameters):
    """Of the pendulum: a box of 80 x 80 x 60 mm on a cable (s)."""
    length = parameters["cable_length"]
    return math.pi * math.sqrt((length + (0.08**2 + 0.06**2) / 12 / length) / G)


def play(axes, actions_of, seed):
    """Return (mean reward, steps until it stays settled, last info)."""
    env = GantrySwayEnv(axes=axes)
    _, info = env.reset(seed=seed)
    ways = [
        info[f"goal_{name}"] - drive.read("position_actual_value") * 1e-6
        for name, drive in zip(axes, env.drives, strict=True)
    ]
    actions = np.stack([actions_of(env, way, info["parameters"]) for way in ways], axis=1)
    total, settled = 0.0, 0
    for step, action in enumerate(actions):
        _, reward, terminated, _, info = env.step(action)
        assert not terminated
        total += reward
        settled = settled if info["is_success"] else step + 1
    return total / STEPS, settled, info


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_a_shaped_move_settles_where_a_plain_one_still_swings(axes):
    held, *_ = play(axes, lambda env, way, p: np.zeros(STEPS), 4)
    plain, never, swinging = play(axes, lambda env, way, p: move(env, way), 4)
    shaped, settled, info = play(axes, lambda env, way, p: move(env, way, half_period(p)), 4)
    assert info["is_success"]
    assert settled < 0.4 * STEPS
    assert never == STEPS
    assert info["sway"] < 0.1 * swinging["sway"]
    assert shaped > plain + 0.4
    assert shaped > held + 0.4


def test_the_swing_has_the_period_of_the_cable_drawn():
    env = GantrySwayEnv()
    _, info = env.reset(seed=3, options={"sway": 0.05, "start": 0.4, "goal": 0.4})
    assert info["sway"] == 0.05
    angles = []
    for _ in range(STEPS):
        observation, *_ = env.step(np.zeros(1))
        angles.append(observation[6])
    signs = np.sign(angles)
    turns = np.flatnonzero(signs[1:] != signs[:-1])
    measured = np.mean(np.diff(turns)) * env.step_time
    assert measured == pytest.approx(half_period(info["parameters"]), rel=0.03)


def test_the_load_is_judged_not_the_axis():
    env = GantrySwayEnv(randomise={})
    _, info = env.reset(seed=3, options={"sway": 0.1, "start": 0.4, "goal": 0.4})
    assert info["parameters"] == {}
    assert info["distance"] == pytest.approx(0.3 * math.sin(0.1), abs=1e-5)
    assert not info["is_success"]
    _, info = env.reset(options={"start": 0.4, "goal": 0.4})
    assert info["is_success"]
    assert env.episode.reward == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("axes", "sensor", "width"), [("x", 0, 7), ("x", 1, 9), ("xy", 1, 18)])
def test_spaces_are_as_wide_as_axes_and_sensor_make_them(axes, sensor, width):
    env = GantrySwayEnv(axes=axes, sway_sensor=bool(sensor))
    assert env.action_space.shape == (len(axes),)
    assert env.observation_space.shape == (width,)
    assert GantrySwayEnv(axes=axes, history=3).observation_space.shape == (3 * 9 * len(axes),)


def test_without_the_sensor_the_torque_still_tells_of_the_sway():
    observations = []
    for sway in (0.0, 0.3):
        env = GantrySwayEnv(randomise={"payload": 5.0})
        env.reset(seed=3, options={"sway": sway, "start": 0.4, "goal": 0.4})
        observations.append([env.step(np.zeros(1))[0] for _ in range(50)])
    calm, swinging = np.abs(observations).max(axis=1)
    assert swinging[4] > calm[4] + 0.01


def test_load_and_cable_of_each_are_its_own_in_a_vector():
    vector = ServoVectorEnv(GantrySwayEnv, 3, threads=1)
    _, infos = vector.reset(seed=4, options={"sway": 0.1, "start": 0.4, "goal": 0.4})
    lengths = infos["parameters"]["cable_length"]
    assert len(set(lengths)) == 3
    np.testing.assert_allclose(infos["distance"], lengths * math.sin(0.1), atol=1e-5)
    vector.step(np.zeros((3, 1)))
    assert len(set(vector.reset(options={})[1]["goal_x"])) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"axes": "z"}, "axes = 'z', use one of x, xy"),
        ({"speed": 3.0}, r"speed = 3.0 is out of range 0.001..1 m/s"),
        ({"resting": 0.0}, r"resting = 0.0 is out of range 0.0001..1 m/s"),
        ({"randomise": {"cable_length": 0.01}}, r"within 0.05..10 m"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        GantrySwayEnv(**arguments)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goal": (0.1, 0.2)}, r"options\['goal'\] = \(0.1, 0.2\) must have a number"),
        ({"goal": 2.0}, r"options\['goal'\] = .* is out of range 0..0.8 m"),
        ({"sway": 2.0}, r"options\['sway'\] = 2.0 is out of range -0.5..0.5 rad"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        GantrySwayEnv().reset(options=options)


def test_the_ghost_of_the_load_is_at_the_goal():
    env = GantrySwayEnv(axes="xy")
    env.reset(seed=2, options={"start": (0.4, 0.2), "goal": (0.5, 0.1)})
    assert env.ghosts()["payload"].tolist() == pytest.approx([0.1, -0.1, 0.0], abs=1e-4)
