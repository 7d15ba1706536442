"""Metrics of the tasks: against the truth looked at from Python."""

import numpy as np
import pytest

from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.contour import CENTRE, GantryContourEnv
from servogym.envs.tasks.gantry_sync import GantrySyncEnv
from servogym.envs.tasks.tracking import LinearAxisTrackingEnv


def play(env, action, steps=None, seed=1):
    env.reset(seed=seed)
    seen = []
    for _ in range(steps or env.STEPS):
        *_, info = env.step(action)
        seen.append((env.machine.data.qpos.copy(), env.machine.data.qvel.copy(), info))
    return seen


def test_the_contour_error_is_that_of_the_tool_and_success_asks_for_speed():
    """On a circle: distance from the centre less the radius."""
    slow, fast = np.zeros(3, np.float32), np.array([0.0, 0.0, 1.0], np.float32)
    for action, progress in ((slow, 0.6), (fast, 1.0)):
        env = GantryContourEnv(feed_forward=1.0)
        seen = play(env, action)
        x, y = (env.machine.model.joint(name).qposadr[0] for name in "xy")
        errors = [abs(np.hypot(q[x] - CENTRE[0], q[y] - CENTRE[1]) - 0.04) for q, *_ in seen]
        figures = env.figures()
        assert figures["contour_error"] == pytest.approx(1e6 * np.mean(errors), rel=1e-6)
        assert figures["contour_worst"] == pytest.approx(1e6 * np.max(errors), rel=1e-6)
        assert figures["progress"] == pytest.approx(progress)
        info = seen[-1][-1]
        assert info["laps"] > 1.0
        assert info["is_success"] == (progress == 1.0 and info["worst"] <= env.tolerance)
        assert np.isnan(figures["corner_error"])


def test_the_worst_at_a_corner_is_that_of_the_square():
    env = GantryContourEnv(contour="square", feed_forward=1.0)
    seen = play(env, np.array([0.0, 0.0, 1.0], np.float32))
    x, y = (env.machine.model.joint(name).qposadr[0] for name in "xy")
    near = [
        abs(info["contour_error"]) for q, _, info in seen
        if min(abs(q[x] - CENTRE[0]), abs(q[y] - CENTRE[1])) >= 0.04 - 2e-3
    ]
    assert env.figures()["corner_error"] == pytest.approx(1e6 * max(near), rel=1e-6)


def test_the_skew_of_the_bridge_is_in_the_figures():
    env = GantrySyncEnv()
    env.reset(seed=1)
    first = float(env.episode.skew)
    skews = [first]
    for _ in range(50):
        *_, info = env.step(np.zeros(2, np.float32))
        skews.append(info["skew"])
    wanted = 1e6 * np.sqrt(np.mean(np.square(skews)))
    assert env.figures()["rms_skew"] == pytest.approx(wanted, rel=1e-6)
    assert env.figures()["last_skew"] == pytest.approx(1e6 * abs(skews[-1]))


@pytest.mark.parametrize("mechanics", ["rigid", "toothed_belt"])
def test_tracking_at_the_load_is_that_of_all_that_is_elastic(mechanics):
    env = LinearAxisTrackingEnv(parameters=mechanics, reference="sine")
    seen = play(env, np.zeros(2, np.float32))
    age = env.machine.cycle_time
    errors = [
        env.episode._position[i + 1] - (q.sum() - age * v.sum()) for i, (q, v, _) in enumerate(seen)
    ]
    rms, motor = np.sqrt(np.mean(np.square(errors))), seen[-1][-1]["rms_error"]
    assert seen[-1][-1]["rms_load_error"] == pytest.approx(rms, rel=0.02)
    if mechanics == "rigid":
        assert rms == pytest.approx(motor, rel=0.05), "motor and load are one"
    else:
        assert abs(rms - motor) > 0.05 * motor


def test_encoder_noise_reaches_the_sensor_of_the_load():
    def noise(deviation):
        env, apart = CompliantAxisEnv(randomise={"encoder_noise": deviation}), []
        env.reset(seed=2, options={"start": 0.2, "goal": 0.2})
        for _ in range(200):
            seen, *_, info = env.step(np.zeros(2, np.float32))
            apart.append(env.named(seen).deflection * 5e-3 - info["deflection"])
        return np.std(apart)

    assert noise(0.0) < 1e-9
    assert noise(20e-6) == pytest.approx(20e-6, rel=0.2)
