"""The gallery draws every method from a real run."""

import math

import numpy as np
import pytest

from servogym.drive.diagrams import homing_words
from servogym.drive.kernel.homing import NUMBERS
from servogym.training import cli
from servogym.training.pictures.heat_map import outliers
from servogym.training.pictures.homing_gallery import STARTS, SWITCH, home, machine_for

OF_A_KIND = (-17, -1, 1, 8, 23, 33, 35)  # others: direction, edge
DRAWN = [n if n in OF_A_KIND else pytest.param(n, marks=pytest.mark.slow) for n in NUMBERS]


@pytest.mark.parametrize("method", DRAWN)
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


def test_the_switch_is_wider_than_the_pitch_of_the_index_pulses_and_the_starts_differ():
    low, high = SWITCH
    pitch = 2 * math.pi / float(machine_for(23).couplings[0].gear)
    assert high - low > pitch
    assert STARTS["left"] < low < STARTS["on the switch"] < high < STARTS["right"]


def test_a_method_in_words_is_what_the_standard_draws():
    """CiA 402-2, figures of methods 1, 19 and 35."""
    assert homing_words(1) == (
        "Left until the negative limit switch comes on, slowly right until the negative limit "
        "switch goes off, slowly right until the first index pulse: home."
    )
    assert homing_words(19) == (
        "Right until the home switch comes on, slowly left until the home switch goes off: home; "
        "beginning on the home switch: left until the home switch goes off, then as before."
    )
    assert homing_words(35).startswith("The position where the axis stands becomes home")


def test_outliers_of_a_heat_map_are_the_values_far_above_the_median():
    values = np.array([[1.0, 2.0, np.nan], [300.0, 1.5, 40.0]])
    assert outliers(values) == [(1, 0), (1, 2)]
    assert outliers(np.full((2, 2), np.nan)) == []


def test_an_unknown_method_names_the_known_ones(tmp_path, capsys):
    assert cli.main(["homing", "--gallery", str(tmp_path), "--method", "15"]) == 2
    assert "--method 15 is unknown, choose from" in capsys.readouterr().err
