"""The oscilloscope of the command line."""

import csv

import pytest

from servogym.training.cli import main


def test_a_trigger_with_pre_trigger_catches_the_crossing(tmp_path):
    arguments = ["--channels", "6064h,axis.torque", "--trigger", "6064h:rising:20000",
                 "--before", "50", "--depth", "150", "--out", str(tmp_path)]  # fmt: skip
    assert main(["scope", "rigid", *arguments]) == 0
    with (tmp_path / "scope.csv").open(encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert head[1].startswith("position_actual_value")
    positions = [float(row[1]) for row in rows]
    assert len(positions) == 150
    assert positions[49] < 20_000 <= positions[50]
    assert (tmp_path / "scope.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--channels", "9999h"], "has no such object"),
        (["--channels", "nonsense"], "there is no channel 'nonsense'"),
        (["--trigger", "6064h"], "use CHANNEL:EDGE:LEVEL"),
        (["--trigger", "6064h:rising:1e9"], "did not come"),
    ],
)
def test_wrong_options_of_the_scope_are_one_line(arguments, text, capsys, tmp_path):
    assert main(["scope", "rigid", "--out", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1
