"""servogym/GantryContour-v0: circle and square."""

import math

import numpy as np
import pytest

from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.contour import GantryContourEnv, deviation, length, point

CIRCLE, SQUARE = 0, 1
POSITION_GAIN = 95.2  # 1/s, of the generic drive on this gantry
FEED, CORRECTION = 0.2, 3e-3  # m/s, m
NONE = np.zeros(3)  # no correction, override 0.6


def lead(observation):
    """Set-points ahead on the path by what drives without feed-forward lag."""
    ahead = observation[:2] * 0.6 * FEED / POSITION_GAIN / CORRECTION
    return np.append(np.clip(ahead, -1.0, 1.0), 0.0)


def play(policy, steps=500, **arguments):
    """Return (mean contour error without sign (m), mean reward, last info)."""
    env = GantryContourEnv(correction=CORRECTION, **arguments)
    observation, _ = env.reset(seed=1)
    errors, rewards = [], []
    for _ in range(steps):
        observation, reward, terminated, _, info = env.step(policy(observation))
        assert not terminated
        errors.append(abs(info["contour_error"]))
        rewards.append(reward)
    return np.mean(errors), np.mean(rewards), info


@pytest.mark.parametrize(("contour", "better"), [("circle", 4.0), ("square", 1.5)])
def test_a_lead_follows_closer_than_the_drives_alone(contour, better):
    alone, reward, info = play(lambda observation: NONE, contour=contour)
    led, higher, _ = play(lead, contour=contour)
    assert alone > better * led
    assert higher > reward
    assert info["laps"] == pytest.approx(0.6 * FEED * 2.5 / length(contour == "square", 0.04))


def test_drives_without_feed_forward_cut_a_circle_as_their_position_loop_says():
    slow, fast = (
        play(lambda observation, a=a: np.array([0, 0, a]), 300)[2]["contour_error"]
        for a in (0.0, 1.0)
    )
    for error, speed in ((slow, 0.6 * FEED), (fast, FEED)):
        rate = speed / 0.04 / POSITION_GAIN
        assert error == pytest.approx(-0.5 * 0.04 * rate**2, rel=0.1), "first-order lag"
    assert fast / slow == pytest.approx(1 / 0.6**2, rel=0.1)


def test_feed_forward_takes_the_lag_away():
    alone, *_ = play(lambda observation: NONE)
    forward, *_ = play(lambda observation: NONE, feed_forward=1.0)
    assert forward < 0.25 * alone


def test_slower_is_closer_but_less_progress():
    closer, _, slow = play(lambda observation: np.array([0, 0, -1.0]))
    farther, _, fast = play(lambda observation: np.array([0, 0, 1.0]))
    assert closer < farther / 5
    assert slow["reward_progress"] == pytest.approx(0.2)
    assert fast["reward_progress"] == pytest.approx(1.0)
    assert fast["laps"] == pytest.approx(5 * slow["laps"])


@pytest.mark.parametrize("contour", [CIRCLE, SQUARE])
def test_the_path_is_closed_goes_at_unit_speed_and_does_not_deviate_from_itself(contour):
    radius, step = 0.04, 1e-5
    ways = np.linspace(0.0, 2 * length(contour, radius), 1001)[:-1] + 3e-6
    for way in ways:
        place = [point(contour, radius, way, axis) for axis in (0, 1)]
        after = [point(contour, radius, way + step, axis) for axis in (0, 1)]
        assert deviation(contour, radius, *place) == pytest.approx(0.0, abs=1e-12)
        corner = step if contour == SQUARE else 1e-9
        assert math.dist(place, after) == pytest.approx(step, abs=corner * 0.3)
        again = [point(contour, radius, way + length(contour, radius), axis) for axis in (0, 1)]
        assert place == pytest.approx(again, abs=1e-12)
    assert point(contour, radius, 0.0, 0) == radius
    assert point(contour, radius, 0.0, 1) == 0.0
    assert point(contour, radius, 0.01, 1) > 0.0, "anticlockwise"


@pytest.mark.parametrize(
    ("contour", "x", "y", "expected"),
    [
        (CIRCLE, 3.0, 4.0, 4.0),
        (CIRCLE, 0.0, 0.25, -0.75),
        (SQUARE, 1.5, 0.3, 0.5),
        (SQUARE, -0.2, -0.9, -0.1),
        (SQUARE, -4.0, 5.0, 5.0),
        (SQUARE, 0.0, 0.0, -1.0),
    ],
)
def test_the_contour_error_is_the_perpendicular_distance(contour, x, y, expected):
    assert deviation(contour, 1.0, x, y) == pytest.approx(expected)


def test_the_preview_points_along_the_path():
    env = GantryContourEnv()
    observation, info = env.reset(seed=1, options={"start": 0.0})
    assert observation[:8] == pytest.approx([0, 1] * 4, abs=0.11)
    assert observation[6] < observation[0] < 0.0, "it turns left"
    assert info["laps"] == 0.0
    assert info["contour_error"] == pytest.approx(0.0, abs=1e-6)


def test_a_delayed_first_command_does_not_move_the_axes():
    env = GantryContourEnv(randomise={"delay": 10})
    env.reset(seed=1)
    *_, terminated, _, info = env.step(NONE)
    assert not terminated
    assert abs(info["contour_error"]) < 2e-6


def test_the_error_of_each_is_its_own_in_a_vector():
    vector = ServoVectorEnv(GantryContourEnv, 3, threads=1)
    vector.reset(seed=4)
    actions = np.zeros((3, 3))
    actions[:, 2] = -1.0, 0.0, 1.0
    for _ in range(100):
        *_, infos = vector.step(actions)
    slow, middle, fast = np.abs(infos["contour_error"])
    assert slow < middle < fast


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"contour": "star"}, "contour = 'star': choose one of circle, square"),
        ({"radius": 0.3}, r"radius = 0.3 is out of range 0.005..0.2 m"),
        ({"feed": -1.0}, r"feed = -1.0 is out of range 0.01..0.5 m/s"),
        ({"correction": 1.0}, r"correction = 1.0 is out of range 0..0.01 m"),
        ({"feed_forward": 2.0}, "feed_forward = 2.0"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        GantryContourEnv(**arguments)


def test_the_ghost_of_the_gripper_is_where_the_path_is():
    env = GantryContourEnv()
    env.reset(seed=1, options={"start": 0.0})
    env.step(NONE)
    ghost = env.ghosts()["gripper"]
    place = env.machine.data.qpos[:2] + ghost[:2]
    way = 0.6 * FEED * env.step_time
    assert place == pytest.approx([0.4 + 0.04 * math.cos(way / 0.04), 0.25 + way], abs=1e-6)
