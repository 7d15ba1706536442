"""The picture of one episode under several policies, and what is recorded for it."""

import math

import numpy as np
import pytest
from later import Later
from PIL import Image

from servogym.envs import TASKS
from servogym.envs.environment.servo_env import ServoEnv
from servogym.envs.tasks.commissioning import CommissioningEnv
from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training import cli
from servogym.training.evaluate import compare, comparison
from servogym.training.evaluate.episodes import Evaluator
from servogym.training.policies import make

trace = Later("servogym.training.pictures.episode")
VALUE, AIM, WINDOW = range(3)


def column(one, label):
    """Of a trace, value, aim and window of the channel whose label begins so."""
    labels = [channel.label.replace("\n", " ") for channel in one.channels]
    return one.samples[:, next(i for i, name in enumerate(labels) if name.startswith(label))]


def test_a_trace_is_what_the_environment_does_alone():
    one = Evaluator("CompliantAxis-v0", episodes=3, traced=1).run("ruckig+zvd").trace
    env = CompliantAxisEnv()
    observation, info = env.reset(seed=1_000_001)
    policy = make("ruckig+zvd", env)
    policy.reset(observation, info)
    seen = []
    for _ in range(env.STEPS):
        observation, *_, info = env.step(policy.act(observation))
        tpdo, shaft = env._batch.tpdos[0, 0], env.machine.axes[0]
        step = env.machine.couplings[0]  # peaks of the step, at its end or before
        assert abs(step.error_peak) >= abs(tpdo.following_error_actual_value)
        assert abs(step.torque_peak) >= abs(shaft.torque)
        seen.append(
            (
                1e3 * (info["goal"] - info["distance"]), 1e3 * info["deflection"],
                step.error_peak, step.torque_peak / shaft.rated_torque,
            )
        )
    load, deflection, error, torque = np.array(seen).T
    assert one.time.tolist() == pytest.approx([i * env.step_time for i in range(env.STEPS + 1)])
    np.testing.assert_allclose(column(one, "load (mm)")[1:, VALUE], load, atol=1e-9)
    assert (column(one, "load (mm)")[:, AIM] == 1e3 * info["goal"]).all()
    np.testing.assert_array_equal(column(one, "deflection")[1:, VALUE], deflection)
    np.testing.assert_array_equal(column(one, "following error")[1:, VALUE], error)
    assert (column(one, "following error")[:, WINDOW] == 20_000).all()
    np.testing.assert_array_equal(column(one, "torque")[1:, VALUE], torque)
    assert (column(one, "torque")[:, WINDOW] == 3.0).all()
    beyond = column(one, "load beyond")
    after = one.time > one.done
    assert (np.abs(beyond[after, VALUE]) <= beyond[after, WINDOW]).all()
    assert np.abs(beyond[~after, VALUE]).max() > 0.1


def test_what_is_reached_without_settling_is_told_too():
    """A lap takes 1.257 s, and the tool has to get going."""
    result = Evaluator("GantryContour-v0", episodes=1).run("full_feed")
    assert result.values["success"][0] == 1.0
    assert math.isnan(result.values["settling_time"][0])
    assert trace.outcome(result.trace) == ": a lap within the window after 1.255 s (dot)"


@pytest.mark.parametrize("task", [task for task in TASKS if not any(task.DONE)])
def test_a_task_that_goes_on_to_its_end_has_no_moment_of_success(task):
    result = Evaluator(task.ID, episodes=1).run(task.POLICIES[0])
    assert result.values["success"][0] == 1.0
    assert math.isnan(result.trace.done)
    assert trace.outcome(result.trace) == ""


def test_a_fault_ends_a_trace():
    result = Evaluator("LinearAxis-v0", episodes=4).run("random")
    i = int(np.flatnonzero(result.values["faults"])[0])
    one = Evaluator("LinearAxis-v0", episodes=4, traced=i).run("random").trace
    assert one.ended == "fault 8611h"
    assert math.isnan(one.done)
    assert one.time[-1] < LinearAxisEnv.STEPS * 5e-3
    assert np.abs(column(one, "following error")[-1, VALUE]) > 20_000
    assert trace.outcome(one) == f": fault 8611h after {one.time[-1]:.3f} s (cross)"


def test_a_method_for_another_reference_is_drawn_with_its_own_home():
    """The edge of the negative limit switch lies 0.2 m from the home switch."""
    one = Evaluator("Homing-v0", episodes=1, traced=0).run("built_in:17").trace
    carriage, beyond = column(one, "carriage"), column(one, "beyond the true reference")
    assert (np.abs(carriage[:, AIM]) < 20).all()
    assert abs(beyond[-1, VALUE]) < beyond[-1, WINDOW] == 0.1


def test_a_load_that_two_axes_move_is_drawn_along_both():
    evaluator = Evaluator("GantrySway-v0", episodes=1, traced=0, axes="xy")
    one = evaluator.run("hold").trace
    for name, goal in zip("XY", evaluator.vector.envs[0].episode._goal, strict=True):
        assert (column(one, f"load in {name}")[:, AIM] == 1e3 * goal).all()
        beyond = column(one, f"load beyond the goal in {name}")
        away = column(one, f"load in {name}")[:, VALUE] - 1e3 * goal
        np.testing.assert_allclose(beyond[:, VALUE], away, atol=1e-9)


def test_a_built_in_homing_is_recorded_to_the_moment_home_is_declared():
    result = Evaluator("Homing-v0", episodes=2, traced=1).run("built_in")
    one = result.trace
    assert one.done == one.time[-1] == result.values["settling_time"][1]
    beyond = column(one, "beyond the true reference")
    assert abs(beyond[-1, VALUE]) < beyond[-1, WINDOW] == 0.1
    assert column(one, "carriage")[0, VALUE] != column(one, "carriage")[-1, VALUE]
    scripted = Evaluator("Homing-v0", episodes=2, traced=1).run("search").trace
    assert (scripted.samples[0, 0, :2] == one.samples[0, 0, :2]).all(), "the same start and home"


def test_a_limit_that_sinks_is_drawn_where_it_is():
    one = Evaluator("GantrySway-v0", episodes=1).run("random").trace
    torque = column(one, "torque")
    assert torque[0, WINDOW] == 3.0
    assert torque[-1, WINDOW] < 2.0, "I²t"
    peaks = np.abs(torque[1:, VALUE])  # of a step, in which the limit goes on sinking
    assert (peaks <= torque[:-1, WINDOW] + 0.01).all()


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)
def test_every_task_has_its_picture(task, tmp_path):
    evaluator = Evaluator(task.ID, episodes=1)
    one = evaluator.run("plc" if task is CommissioningEnv else "random").trace
    trace.draw(tmp_path / "trace.png", task.ID, [one])
    with Image.open(tmp_path / "trace.png") as image:
        assert image.height > 130 * len(evaluator.vector.envs[0].channels())
        assert len(image.getcolors()) > 20
    assert task.CHANNELS is not ServoEnv.CHANNELS


def test_the_episode_asked_for_is_drawn(tmp_path, capsys):
    arguments = ["eval", "LinearAxis-v0", "--policy", "random", "--episodes", "2", "--trace", "1"]
    assert cli.main([*arguments, "--out", str(tmp_path)]) == 0
    assert (tmp_path / "eval_trace.png").is_file()
    assert "--trace 1\n" in (tmp_path / "eval.md").read_text(encoding="utf-8")


def test_idle_policies_are_drawn_only_alone(tmp_path):
    results = comparison.evaluate("LinearAxis-v0", ["hold", "ruckig", "random"], "generic", 1, 0)
    traces = [result.trace for result in results]
    assert [one.policy for one in compare._moving(traces)] == ["ruckig"]
    assert [one.policy for one in compare._moving(traces[:1])] == ["hold"]


def test_eight_policies_have_eight_colours(tmp_path):
    one = Evaluator("LinearAxis-v0", episodes=1).run("ruckig").trace
    shifted = [
        one._replace(policy=f"p{i}", samples=one.samples + 3.0 * i, done=math.nan) for i in range(8)
    ]
    trace.draw(tmp_path / "eight.png", "eight", shifted)
    with Image.open(tmp_path / "eight.png") as image:
        found = {pixel for _, pixel in image.convert("RGB").getcolors(1 << 24)}
    for colour in trace.COLOURS:
        rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        assert min(max(abs(a - b) for a, b in zip(rgb, pixel, strict=True)) for pixel in found) < 12


@pytest.mark.parametrize(
    ("number", "said"), [("-1", "-1 is out of range 0.."), ("2", "2 is out of range 0..1: choose")]
)
def test_an_episode_that_is_not_there_is_refused(number, said, tmp_path, refused):
    arguments = ["eval", "LinearAxis-v0", "--policy", "hold", "--episodes", "2", "--trace", number]
    assert said in refused([*arguments, "--out", str(tmp_path)])
