"""The gallery draws every method from a real run."""

import pytest

from servogym.drive.kernel.homing import NUMBERS
from servogym.training import cli
from servogym.training.pictures.homing_gallery import STARTS, home, machine_for


@pytest.mark.parametrize("method", NUMBERS)
def test_every_method_homes_the_axis_and_is_drawn(method, tmp_path):
    arguments = ["homing", "--gallery", str(tmp_path), "--method", str(method), "--format", "svg"]
    assert cli.main(arguments) == 0
    picture = (tmp_path / f"method_{method:+d}.svg").read_text(encoding="utf-8")
    assert f"<!-- homing method {method} -->" in picture
    assert "time (s), downwards" in picture


@pytest.mark.parametrize("method", [m for m in NUMBERS if m not in (33, 34, 35, 37)])
def test_every_start_finds_the_same_home(method):
    machine = machine_for(method)
    homes = [home(machine, start).home for start in STARTS.values()]
    assert max(homes) - min(homes) <= 3e-6


def test_an_unknown_method_names_the_known_ones(tmp_path, capsys):
    assert cli.main(["homing", "--gallery", str(tmp_path), "--method", "15"]) == 2
    assert "--method 15 is unknown, choose from" in capsys.readouterr().err
