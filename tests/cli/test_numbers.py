"""Each option with a number, of each command, says its range to the parser, which holds it."""


import contextlib

import pytest

from servogym.training import cli
from servogym.training.cli.arguments import Number

# options that take -1 and 0, or 0: positions, distances, ratios and methods with a sign; numbers
# and seeds that begin with 0; masses, bounds and a phase that may be nothing
SIGNED = {"at", "gear", "move", "range", "mode", "home", "method"}
FROM_ZERO = {"seed", "seeds", "position", "trace", "before", "payload", "bounds", "phase"}
OF_PYTHON_CAN = {"bitrate", "data_bitrate"}


def numbers():
    """(command, action, whether it is whole) of each option whose value is a number."""
    for name, command in cli.parser().commands.items():
        for action in command._actions:
            kind = action.type
            kind = Number(int) if action.dest in OF_PYTHON_CAN else kind
            for cell in getattr(kind, "__closure__", None) or ():  # numbers between commas
                kind = cell.cell_contents
            assert kind not in (int, float), f"{name} {action.option_strings}: it has no range"
            if isinstance(kind, Number):
                yield name, action, kind.kind is int


def says(command, action, text, capsys):
    """What the parser says of a value, empty if it takes it."""
    option = max(action.option_strings, key=len)
    words = [option, text, text] if action.nargs == 2 else [f"{option}={text}"]
    with contextlib.suppress(SystemExit):  # of a refusal, or as the command needs other words
        cli.parser(command).commands[command].parse_args(words)
    error = capsys.readouterr().err.rpartition("error: ")[2]
    return error if error.startswith("argument ") else ""


ROWS = [*numbers()]


def test_the_commands_have_about_a_hundred_options_with_a_number():
    assert len(ROWS) > 95


@pytest.mark.parametrize(
    ("command", "action", "whole"), ROWS, ids=[f"{name} {row.dest}" for name, row, _ in ROWS]
)
def test_a_number_that_cannot_be_is_refused_by_the_parser(command, action, whole, capsys):
    signed = action.dest in SIGNED
    refused = {
        "-1": not signed, "0": not (signed or action.dest in FROM_ZERO), "nan": True, "inf": True,
        "-inf": True, "1e300": True, "-9" * 30: True, "9" * 30: True, "": True, "many": True,
        "1.5": whole,
    }
    if action.dest in ("phase", "slow"):  # shares: 1.5 is none
        refused["1.5"] = True
    for text, wrong in refused.items():
        told = says(command, action, text, capsys)
        assert bool(told) is wrong, (text, told)
        assert not wrong or "range" in told or "number" in told, told


@pytest.mark.parametrize(
    ("line", "option"),
    [
        ("scope rigid --node-id 5", "--node-id"),
        ("scope rigid -c can0", "--channel"),
        ("scope rigid --rate 50", "--rate"),
        ("scope run.log --bitrate 500000", "--bitrate"),
        ("panel --axis linear -i virtual", "--interface"),
        ("twin run.log -o out --node-id 3", "--node-id"),
        ("twin --plan plan.csv -i virtual", "--interface"),
        ("observe --ethercat eth0 --node-id 3 -o new.json", "--node-id"),
        ("observe --node-id 3 --position 2 -o new.json", "--position"),
        ("observe --compare old.json -c can0", "--channel"),
        ("serve LinearAxis-v0 --ethercat eth0 --node-id 3 --check", "--node-id"),
        ("serve LinearAxis-v0 --ethercat eth0 -c can0 --check", "--channel"),
    ],
)
def test_an_option_of_a_bus_is_refused_where_there_is_none(
    line, option, tmp_path, monkeypatch, refused
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.log").touch()
    (tmp_path / "old.json").touch()
    assert f"{option} is " in refused(line.split())


def test_a_negative_number_in_scientific_form_is_a_value():
    options = cli.parser("scope").commands["scope"].parse_args(["--move", "-1e-2", "--at", "-.5"])
    assert (options.move, options.at) == (-0.01, -0.5)
