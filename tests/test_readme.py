"""What the README shows works: its Python, its commands, its table of drives."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from servogym.drive.model import load, model_names
from servogym.drive.words import MODE_ABBREVIATION
from servogym.training import cli

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
COMMANDS = [
    line.partition("#")[0].strip()
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    for line in block.splitlines()
]


@pytest.mark.parametrize("code", PYTHON, ids=range(len(PYTHON)))
def test_a_python_block_prints_what_its_comments_say(code):
    promised = re.findall(r"^print\(.*\)  # (.*)$", code, re.MULTILINE)
    assert promised
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {})
    assert printed.getvalue().splitlines() == promised


def test_the_first_two_commands_are_make_demo_and_make_test():
    assert COMMANDS[:2] == ["make demo", "make test"]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_exists(command):
    program, *arguments = shlex.split(command)
    if program == "make":
        targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
        assert arguments[0] in targets
    else:
        assert program == "servogym"
        cli._parser().parse_args(arguments)  # exits where an option is unknown


def test_the_table_of_drives_is_what_the_models_say():
    rows = re.findall(r"^\| `(\w+)`[^|]*\|([^|]*)\|([^|]*)\|([^|]*)\|$", README, re.MULTILINE)
    assert sorted(name for name, *_ in rows) == model_names()
    for name, modes, methods, cycles in rows:
        model = load(name)
        assert modes.split() == [MODE_ABBREVIATION[mode] for mode in model.modes]
        assert _numbers(methods) == sorted(model.homing_methods)
        microseconds = [f"{time * 1e6:g}" for time in model.cycle_time.values()]
        assert cycles.strip() == ", ".join(microseconds) + " µs"


def test_the_parts_of_the_house_exist():
    for folder in re.findall(r"^\| `(\w+)/` \|", README, re.MULTILINE):
        assert (ROOT / folder).is_dir()


def _numbers(text: str) -> list[int]:
    """``"1–3, −2"`` -> ``[-2, 1, 2, 3]``."""
    numbers: list[int] = []
    if not text.strip():
        return numbers
    for part in text.replace("−", "-").split(","):
        first, _, last = part.strip().partition("–")
        numbers += range(int(first), int(last or first) + 1)
    return sorted(numbers)
