"""`servogym results --train`: the trainings of committed rows, from their commands."""

import json
from itertools import pairwise
from types import SimpleNamespace

import pytest

from servogym.training import cli
from servogym.training.evaluate import repeat
from servogym.training.policies import SHIPPED
from servogym.training.policies.trained import saved

TWO_HOURS = 2 * 3600  # s, of two cores
LINE = "servogym train LinearAxis-v0 --steps {steps} --seed {seed}"
TINY = " --argument max_episode_steps=10 --envs 8 --setting n_steps=16 --setting batch_size=64"
TINY += " --evaluate-every 128"


def task(path, commands, steps, **more):
    folder = path / "LinearAxis-v0"
    folder.mkdir(parents=True)
    data = {"commands": commands, "steps": steps, **more}
    (folder / "trainings.json").write_text(json.dumps(data), encoding="utf-8")
    return path


def test_all_committed_trainings_can_be_repeated_within_two_hours_of_two_cores(tmp_path):
    """Each command is one `servogym train` takes, and makes what the checkpoint beside it was."""
    parser = cli.parser("train")
    trainings = repeat.plan(SHIPPED, tmp_path)
    kept = {path.parent for path in SHIPPED.glob("*-v*/seed_*/checkpoint.json")}
    assert kept == {SHIPPED / each.task / f"seed_{each.seed}" for each in trainings}
    for each in trainings:
        about = json.loads(
            (SHIPPED / each.task / f"seed_{each.seed}" / "checkpoint.json").read_text()
        )
        stages = [parser.parse_args(command) for command in each.commands]
        assert stages[-1].out == each.out == tmp_path / each.task / f"seed_{each.seed}"
        given = {name: value for stage in stages for name, value in stage.argument or ()}
        assert given == about["arguments"]
        corrected = [stage.residual for stage in stages if stage.residual] or [None]
        assert (corrected[-1], stages[0].bounds) == (about.get("residual"), about.get("bounds"))
        assert stages[0].demonstrate == about.get("demonstrate")
        assert {stage.seed for stage in stages} == {about["seed"]}
        assert sum(stage.steps for stage in stages) == each.steps >= about["steps"]
        assert (len(stages) > 1) == bool(about.get("start"))
        for before, after in pairwise(stages):
            assert after.start == before.out
        assert each.cpu_seconds > 0.0
    assert sum(each.cpu_seconds for each in trainings) / repeat.CORES <= TWO_HOURS


def test_a_training_goes_on_where_it_was_interrupted(tmp_path, capsys, monkeypatch):
    """In this process, because another one would import torch anew."""
    pytest.importorskip("stable_baselines3", reason="needs pip install 'servogym[train]'")
    monkeypatch.setattr(
        repeat.subprocess, "run", lambda call: SimpleNamespace(returncode=cli.main(call[3:]))
    )
    lines = [
        LINE + TINY + " --out {out}/first_{seed}",
        LINE + " --start {out}/first_{seed} --out {out}/seed_{seed}",
    ]
    folder = task(tmp_path / "rows", lines, {"3": [128, 128]}, cpu_us_per_step_at_most=1e6)
    out = tmp_path / "out"
    assert cli.main(["results", str(folder), "--train"]) == 0
    shown = capsys.readouterr().out
    assert "--seed 3" in shown
    assert "Together they took at most 256 CPU-seconds" in shown
    assert "Measured" not in shown
    assert not out.exists()
    for _ in range(2):
        assert cli.main(["results", str(folder), "--train", str(out)]) == 0
    about = saved.read(out / "LinearAxis-v0" / "seed_3" / "checkpoints" / "0000000128")
    assert (about["seed"], about["start"]["steps"]) == (3, 128)


def test_the_cpu_seconds_are_those_of_the_whole_training_not_of_its_best_checkpoint(tmp_path):
    """The best of 1000 steps was at 400, after 20 s; it began with 300 s for all of its 500."""
    folder = task(tmp_path, [LINE + " --out {out}/a", LINE + " --out {out}/b"], {"1": [500, 1000]})
    seed = folder / "LinearAxis-v0" / "seed_1"
    seed.mkdir()
    kind = {"env_id": "servogym/LinearAxis-v0", "algorithm": "PPO", "versions": {}}
    kind |= {"arguments": {}, "hyperparameters": {}}
    first = kind | {"steps": 250, "cpu_seconds": 150.0}
    about = kind | {"steps": 400, "cpu_seconds": 20.0, "start": first}
    (seed / "checkpoint.json").write_text(json.dumps(about), encoding="utf-8")
    (training,) = repeat.plan(folder, tmp_path)
    assert training.cpu_seconds == pytest.approx(350.0)
    assert not training.inferred
    assert repeat.in_sentences([training]) == (
        "Together they took 350 CPU-seconds, 3 minutes of 2 cores. These times were measured."
    )
    guessed = training._replace(task="Other-v0", cpu_seconds=50.0, inferred=True)
    said = repeat.in_sentences([training, guessed])
    assert said.startswith("Together they took at most 400 CPU-seconds")
    assert "Of these, 350 were measured (LinearAxis-v0)." in said
    assert "The times of Other-v0, at most 50, were not recorded" in said


@pytest.mark.parametrize(
    ("content", "says"),
    [(None, "has no trainings.json"), ("{}", "says no trainings"), ("[1]", "is damaged: a table")],
)
def test_a_folder_without_trainings_is_told(tmp_path, capsys, content, says):
    folder = tmp_path / "LinearAxis-v0"
    folder.mkdir()
    if content is not None:
        (folder / "trainings.json").write_text(content, encoding="utf-8")
    assert cli.main(["results", str(tmp_path), "--train"]) == 2
    assert says in capsys.readouterr().err
