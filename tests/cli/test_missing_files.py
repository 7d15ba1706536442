"""A file that is not there is refused before a machine is built for it, by every command."""

import argparse
from pathlib import Path

import pytest

from servogym.envs.engine.machine import Machine
from servogym.training import cli
from servogym.training.cli import COMMANDS, parser

# words of each command before the option or the file
BEFORE = {
    "bode": "vertical", "tune": "toothed_belt", "machines": "", "scope": "rigid", "panel": "",
    "replay": "run.log", "benchmark": "positioning", "train": "LinearAxis-v0", "classroom": "",
    "course": "list", "drives": "-o made", "observe": "", "decode": "", "twin": "-o made",
    "curves": "", "results": "",
}
MADE = {  # paths that a command writes, and has no `files` or `folders` for
    ("drives", "out"), ("observe", "out"), ("sweep", "out"), ("twin", "plan"), ("twin", "out"),
    ("classroom", "results"), ("compare", "out"), ("watch", "record"), ("tune-policy", "out"),
    ("panel", "parameter_file"),  # 1010h stores into it
}
NEEDS = {("observe", "compare"): "--drive generic", ("twin", "against"): "run.log",
         ("panel", "mjcf"): "--joint elbow"}


def inputs():
    """Command and option of each path that a command reads."""
    for name, command in parser().commands.items():
        written = (*(command.get_default("files") or ()), *(command.get_default("folders") or ()))
        for action in command._actions:
            path = action.type is Path and action.dest not in written
            if path and (name, action.dest) not in MADE:
                yield name, action


CASES = [*inputs()]


def test_most_of_the_commands_that_read_files_are_here():
    assert len(CASES) >= 20
    assert {name for name, _ in CASES} <= {*BEFORE} & {*COMMANDS}


@pytest.mark.parametrize(
    ("name", "action"), CASES, ids=[f"{name} {action.dest}" for name, action in CASES]
)
def test_a_missing_file_is_refused_before_anything_is_built(
    name, action: argparse.Action, tmp_path, monkeypatch, capsys
):
    def built(*_, **__):
        raise AssertionError("a machine is built first")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Machine, "__init__", built)
    option = [action.option_strings[-1]] if action.option_strings else []
    more = NEEDS.get((name, action.dest), "").split()
    assert cli.main([name, *BEFORE[name].split(), *option, "nowhere", *more]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "nowhere" in said or "run.log" in said
    assert not [*tmp_path.iterdir()]
