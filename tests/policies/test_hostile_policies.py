"""Policy folders of somebody else: a program in them never runs, damage is told in one line."""

import contextlib
import json
import shutil
from pathlib import Path

import pytest

from servogym.envs.tasks.tracking import LinearAxisTrackingEnv
from servogym.training import cli
from servogym.training.evaluate import repeat, results
from servogym.training.policies import SHIPPED, make
from servogym.training.policies.trained import saved
from servogym.training.policies.trained.residual import ResidualVectorEnv

TASK = "LinearAxisTracking-v0"
ABOUT = saved.ABOUT
EVIL = "open('ran.txt', 'w')\nclass act:\n    pass\n"
VALUES = [None, True, -1, 1.5, 10**30, "", "evil.py:act", [], [[]], {}, {"a": {}}]


@pytest.fixture
def downloaded(tmp_path, monkeypatch):
    """A folder of a policy that corrects another one, with a program beside it."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SHIPPED / TASK / "seed_1", "downloaded")
    Path("downloaded", "evil.py").write_text(EVIL, encoding="utf-8")
    Path("evil.py").write_text(EVIL, encoding="utf-8")

    def write(**changes):
        file = Path("downloaded", ABOUT)
        about = json.loads((SHIPPED / TASK / "seed_1" / ABOUT).read_text(encoding="utf-8"))
        file.write_text(json.dumps(about | changes), encoding="utf-8")
        return file

    return write


def line(capsys, *words):
    assert cli.main([*words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1, error
    return error


@pytest.mark.parametrize("base", ["downloaded/evil.py:act", "evil.py:act", "downloaded", "../x"])
def test_what_a_folder_corrects_has_a_registered_name(base, downloaded, capsys):
    """eval, compare, watch, train --start and make: the folder runs no file that it names."""
    downloaded(residual=base)
    says = f"corrects {base!r}, which is not a registered policy"
    for words in (
        ["eval", TASK, "--policy", "downloaded"],
        ["compare", TASK, "--policies", "hold,downloaded"],
        ["compare", TASK, "--policies", "hold,downloaded", "--conditions", "delay"],
        ["watch", TASK, "--policy", "downloaded", "--record", "run.gif"],
        ["benchmark", "learned", "--policy", "downloaded", "--tasks", TASK],
    ):
        assert says in line(capsys, *words)
    with pytest.raises(ValueError, match="not a registered policy"):
        make("downloaded", LinearAxisTrackingEnv())
    with pytest.raises(ValueError, match="not a registered policy"):
        ResidualVectorEnv(LinearAxisTrackingEnv, residual=base, bounds=[0.1, 0.1])
    assert not Path("ran.txt").exists()


def test_a_stage_that_a_folder_began_with_is_read_the_same_way(downloaded, capsys):
    about = json.loads(downloaded().read_text(encoding="utf-8"))
    downloaded(start=about["start"] | {"residual": "evil.py:act"})
    assert "not a registered policy" in line(capsys, "eval", TASK, "--policy", "downloaded")


@pytest.mark.parametrize("key", saved.KEYS)
def test_a_damaged_checkpoint_is_refused_in_words_or_plays(key, downloaded):
    """Every key with every kind of value, and without it."""
    env = LinearAxisTrackingEnv(history=3)
    whole = json.loads(downloaded().read_text(encoding="utf-8"))
    without = {name: value for name, value in whole.items() if name != key}
    for about in (*(whole | {key: value} for value in VALUES), without):
        Path("downloaded", ABOUT).write_text(json.dumps(about), encoding="utf-8")
        with contextlib.suppress(ValueError):
            make("downloaded", env)
    assert not Path("ran.txt").exists()


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"[]", b"null", b"\xff\xfe", b"[" * 100_000, b'{"a":' * 5000, b'{"steps": 1}'],
)
def test_a_checkpoint_that_is_no_table_is_one_line(data, downloaded, capsys):
    downloaded().write_bytes(data)
    assert ABOUT in line(capsys, "eval", TASK, "--policy", "downloaded")


def test_weights_that_were_changed_are_refused(downloaded, capsys):
    downloaded()
    other = SHIPPED / TASK / "seed_2" / "weights.npz"
    shutil.copy(other, Path("downloaded", "weights.npz"))
    assert "was changed or damaged: its SHA-256 is" in line(
        capsys, "eval", TASK, "--policy", "downloaded"
    )


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("compare.json", {"command": "servogym compare T --policies evil.py:act", "env": TASK}),
        ("compare.json", {"command": f"servogym compare {TASK}", "env": "evil:Task-v0"}),
        ("trainings.json", {"commands": [f"servogym train {TASK} --demonstrate evil.py:act"],
                            "steps": {"1": 100}}),
    ],
)
def test_a_page_of_somebody_else_is_repeated_without_its_programs(
    name, content, downloaded, capsys
):
    folder = Path("theirs", TASK)
    folder.mkdir(parents=True)
    (folder / name).write_text(json.dumps(content), encoding="utf-8")
    if name == results.FILE:
        for words in (["--again"], []):
            error = line(capsys, "results", "theirs", *words)
            assert "is a program: read it, and say --run-code" in error
    else:
        error = line(capsys, "results", "theirs", "--train", "out")
        assert "is a program: read it, and say --run-code" in error
    assert not Path("ran.txt").exists()


@pytest.mark.parametrize(
    "command",
    [
        "panel --out {out}", f"train {TASK} --out /etc/theirs", f"train {TASK} --out {{out}}/../..",
        f"train {TASK} --out {{out}} --out /etc/theirs", f"train {TASK} --out={{out}}",
        f"train {TASK} --out {{out}} --ou=/etc/theirs", f"train {TASK}", f"train {TASK} --out",
    ],
)
def test_only_trainings_into_the_folder_are_commands_of_a_training(tmp_path, command):
    (tmp_path / TASK).mkdir()
    content = {"commands": [f"servogym {command}"], "steps": {"1": 100}}
    (tmp_path / TASK / repeat.FILE).write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match="says no trainings"):
        repeat.plan(tmp_path, tmp_path)
