"""What is identified in the first motion is what was drawn, and rows with numbers are tuned."""

import json
import math
from itertools import islice

import numpy as np
import pytest

from servogym.envs import ON_MODELS, TASKS
from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.sway import GantrySwayEnv
from servogym.training import cli
from servogym.training.evaluate import tuner
from servogym.training.policies import make
from servogym.training.policies.numbers import FILE, tuned
from servogym.training.policies.profiles import TunedRuckig

TOLD = {CompliantAxisEnv: "informed_ruckig+zvd", GantrySwayEnv: "informed_ruckig+zv"}
MOVES = {CompliantAxisEnv: {"start": 0.1, "goal": 0.3}, GantrySwayEnv: {"start": 0.1, "goal": 0.6}}


def play(env, policy, **options):
    """-> steps until the last one that was not settled."""
    observation, info = env.reset(seed=3, options=options)
    policy.reset(observation, info)
    unsettled = 0
    for step in range(env.STEPS):
        observation, *_, info = env.step(policy.act(observation))
        unsettled = unsettled if info["is_success"] else step + 1
    return unsettled


@pytest.mark.parametrize("stiffness", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("payload", [2.0, 8.0])
def test_the_resonance_of_a_spring_is_found(stiffness, payload):
    """Of the load on a carriage that is held, as a shaper of the set-point wants it."""
    env = CompliantAxisEnv(randomise={"stiffness": stiffness, "payload": payload})
    policy = make("identified+zvd", env)
    play(env, policy, **MOVES[CompliantAxisEnv])
    true = math.sqrt(stiffness * 20_000.0 / payload)
    assert policy._axes[0].frequency == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("length", [0.2, 0.3, 0.4])
def test_the_length_of_a_cable_is_found(length):
    env = GantrySwayEnv(randomise={"cable_length": length})
    policy = make("identified+zv", env)
    play(env, policy, **MOVES[GantrySwayEnv])
    assert policy._axes[0].frequency == pytest.approx(math.sqrt(9.81 / length), rel=0.02)


@pytest.mark.parametrize("task", TOLD, ids=lambda task: task.ID)
def test_what_identifies_is_hardly_later_than_what_is_told(task):
    names = {CompliantAxisEnv: "identified+zvd", GantrySwayEnv: "identified+zv"}
    drawn = (
        {"stiffness": 1.6, "payload": 3.0} if task is CompliantAxisEnv else {"cable_length": 0.23}
    )
    env = task(randomise=drawn)
    found, told = (play(env, make(n, env), **MOVES[task]) for n in (names[task], TOLD[task]))
    assert found <= 1.15 * told


def test_without_the_sensor_nothing_is_identified():
    with pytest.raises(ValueError, match="load_sensor=True"):
        make("identified+zv", CompliantAxisEnv(load_sensor=False))


def test_the_points_of_the_tuner_fill_the_ranges():
    found = list(islice(tuner.points(TunedRuckig.RANGES), 65))
    assert found[0] == {name: one.untuned for name, one in TunedRuckig.RANGES.items()}
    for name, one in TunedRuckig.RANGES.items():
        values = np.log([point[name] / one.low for point in found[1:]]) / math.log(
            one.high / one.low
        )
        assert (np.abs(np.sort(values) - (np.arange(64) + 0.5) / 64) < 0.08).all(), name


def test_the_tuner_finds_numbers_that_are_no_worse_and_says_the_budget(tmp_path, capsys):
    file = tmp_path / "tuned.json"
    words = ["tune-policy", "tuned_ruckig", "--task", "LinearAxis-v0", "--budget", "40000"]
    assert cli.main([*words, "--out", str(file)]) == 0
    found = json.loads(file.read_text())["tuned_ruckig"]["LinearAxis-v0"]
    assert found["tuned"] <= found["untuned"]
    assert 0 < found["steps"] <= 60_000
    assert f"{found['steps']:,} steps" in capsys.readouterr().out


class Risky(TunedRuckig):
    """With much torque it gives up where the way is long: the interquartile mean hides that."""

    def reset(self, observation, info):
        super().reset(observation, info)
        share = self.numbers(self._known.task)["share"]
        self._gives_up = share > 0.6 and abs(self._way) > 0.3

    def act(self, observation):
        return (0.0 if self._gives_up else 1.0) * super().act(observation)


def test_the_tuner_takes_no_numbers_that_fail_where_the_untuned_ones_do_not():
    untuned = TunedRuckig.RANGES | {"share": TunedRuckig.RANGES["share"]._replace(untuned=0.5)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Risky, "RANGES", untuned)
        assert tuner.tune(Risky, LinearAxisEnv, 40_000)["numbers"]["share"] <= 0.6


@pytest.mark.slow
def test_the_committed_numbers_of_the_cheapest_row_are_what_its_command_writes(tmp_path):
    """Byte by byte, into a copy of the file without them: 216,648 steps."""
    again, committed = tmp_path / "tuned.json", FILE.read_bytes()
    rows = json.loads(committed)
    command = rows.pop("tuned_search")["Homing-v0"]["command"]
    again.write_text(json.dumps(rows), encoding="utf-8")
    assert cli.main([*command.split()[1:], "--out", str(again)]) == 0
    assert again.read_bytes() == committed


def test_the_committed_file_has_every_row_and_task_of_the_tuner_with_its_command():
    every = (*TASKS, *ON_MODELS)
    offering = {(row, t.ID) for row in tuner.offered() for t in every if row in t.POLICIES}
    found = {(row, f"servogym/{t}") for row, own in tuned().items() for t in own}
    assert found == offering
    for row, own in tuned().items():
        for name, one in own.items():
            assert one["command"] == f"servogym tune-policy {row} --task {name}"
    text = json.dumps(tuned(), indent=1, sort_keys=True) + "\n"
    assert text == FILE.read_text(encoding="utf-8")


def test_a_row_plays_with_the_numbers_that_come_with_the_laboratory():
    assert TunedRuckig.GIVEN is None
    for policy, tasks in tuned().items():
        kind = tuner.tunable(policy)
        for task, found in tasks.items():
            assert found["numbers"].keys() == kind.RANGES.keys(), (policy, task)
            assert found["steps"] <= 1.1 * tuner.BUDGET
    own = tuned().get("tuned_ruckig", {}).get("LinearAxis-v0", {}).get("numbers", {})
    policy = make("tuned_ruckig", LinearAxisEnv())
    assert own == {} or policy.numbers(LinearAxisEnv.ID) == own


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["tuned_rukig"], "tuned_ruckig"),
        (["identified+zv"], "add --task"),
        (["identified+zv", "--task", "LinearAxis-v0"], "does not offer"),
    ],
)
def test_what_cannot_be_tuned_is_refused(words, reason, capsys, tmp_path):
    assert cli.main(["tune-policy", *words, "--out", str(tmp_path / "x.json")]) == 2
    assert reason in capsys.readouterr().err
