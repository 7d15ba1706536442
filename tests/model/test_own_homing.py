"""Homing methods that a drive model brings in its homing.csv, with a speed of their own."""

import math

import numpy as np
import pytest

from servogym.drive import Drive
from servogym.drive.diagrams import homing_path, homing_words
from servogym.drive.kernel.homing import NUMBERS
from servogym.drive.model.model import load
from servogym.envs import linear_axis
from servogym.envs.masters.homing_figures import built_in, true_home
from servogym.training import cli

STANDARD = ", ".join(str(number) for number in NUMBERS if number < 0)
HEAD = "method,leg,direction,speed,until,next,at_limit_switch,section,from_home_switch\n"
OBJECTS = (
    "index,subindex,name,object_type,data_type,access,pdo,unit,min,max,default,storable,section,"
    "note,field,when,hook\n0x2012,0x06,homing_return_speed,RECORD,UNSIGNED32,rw,rx,velocity unit,"
    "1,,20000,yes,,,homing_speed_own,,\n"
)
LIKE_2 = "-109,0,+,slow,stop,1,,,\n-109,1,-,slow,index,home,,,\n"
OWN = "-109,0,+,slow,stop,1,,,\n-109,1,-,own,index,home,,,\n"
LIKE_23 = (  # the standard's, which begins on the switch with another leg
    "-23,0,+,fast,home_on,3,1,,\n-23,1,-,fast,home_on,2,error,,\n"
    "-23,2,-,fast,home_off,0,,,yes\n-23,3,-,slow,home_off,home,,,\n"
)


@pytest.fixture
def model(tmp_path):
    """Makes a model with these rows of homing.csv."""

    def make(rows, name="mine"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "drive.toml").write_text('based_on = "generic"\ntitle = "mine"\n')
        (folder / "homing.csv").write_text(HEAD + rows)
        (folder / "objects.csv").write_text(OBJECTS)
        return folder

    return make


def figures(machine, method, start):
    objects = {"speed_during_search_for_zero": 50_000}
    return built_in(machine, method, start, objects=objects, timeout=20.0)._replace(method=0)


def test_a_method_with_the_legs_of_a_standard_one_is_that_method(model):
    machine = linear_axis(load(model(LIKE_2 + LIKE_23)))
    for start in (0.1, 0.4):
        assert figures(machine, -109, start) == figures(machine, -2, start)
    for start in (0.1, 0.25, 0.4):  # right of the switch, on it, left of it
        machine.couplings[0].switch_from[2], machine.couplings[0].switch_to[2] = 0.2, 0.3
        one, other = (figures(machine, method, start) for method in (-23, 23))
        assert one == other
        assert one.attained


def test_its_own_speed_is_the_one_of_the_object_that_the_model_has(model):
    """From the stop to the first index pulse before it, at the speed of 2012h:06."""
    machine = linear_axis(load(model(OWN)))
    high = float(machine.mechanics["high"][0])
    turn = 2 * math.pi / abs(float(machine.couplings[0].gear))
    assert true_home(machine, -109) == pytest.approx(math.floor(high / turn) * turn)
    for speed in (20_000, 5_000):  # µm/s
        assert returned(machine, speed) == pytest.approx(-1e-6 * speed, rel=0.02)


def returned(machine, speed):
    """Velocity (m/s) on the way back from the stop, which it leaves for its home."""
    seen = []
    objects = {"speed_during_search_for_zero": 50_000, "homing_return_speed": speed}
    found = built_in(
        machine, -109, 0.45, objects=objects,
        observer=lambda _: seen.append(float(machine.data.qvel[0])),
    )
    assert abs(found.error) < 20e-6
    back = np.array(seen)
    return np.median(back[back < -1e-3])


def test_a_master_sees_the_method_and_the_panel_has_words_and_a_path(model):
    drive = Drive(load(model(OWN)))
    listed = [drive.read(0x60E3, n) for n in range(1, drive.read(0x60E3) + 1)]
    assert -109 in listed
    own = drive.model.own_homing
    assert homing_words(-109, own) == (
        "Slowly right until the mechanical stop, at the model's own speed left until the first "
        "index pulse: home."
    )
    assert homing_path(-109, 0.5, own)[1] == 1.0
    with pytest.raises(ValueError, match="homing method -109 is unknown"):
        homing_words(-109)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("-1,0,+,slow,stop,home,,,\n", f"and {STANDARD} are there already"),
        ("9,0,+,slow,stop,home,,,\n", "numbers of a maker are -1 to -128"),
        ("-109,1,+,slow,stop,home,,,\n", "leg '1' of method -109 has to be 0"),
        ("-109,0,up,slow,stop,home,,,\n", "direction 'up' is none of -, +"),
        ("-109,0,+,slow,wall,home,,,\n", "until 'wall' is none of negative_limit_on"),
        ("-109,0,+,slow,stop,2,,,\n", "method -109 has no leg 2"),
        ("-109,0,+,slow,stop,0,,,\n", "method -109 has no leg that ends at home"),
        ("".join(f"-{20 + n},0,+,slow,stop,home,,,\n" for n in range(5)), "at most 4 homing"),
    ],
)
def test_a_file_that_cannot_be_right_is_refused_with_line_and_reason(rows, says, model):
    with pytest.raises(ValueError, match=says):
        load(model(rows))


def test_the_gallery_and_the_benchmark_have_it(model, tmp_path):
    folder = str(model(OWN))
    words = ["homing", "--gallery", str(tmp_path), "--drive", folder, "--method=-109"]
    assert cli.main([*words, "--format", "png"]) == 0
    assert (tmp_path / "method_-109.png").read_bytes()[:4] == b"\x89PNG"
    words = ["benchmark", "homing", "--quick", "--mechanics", "rigid", "--drive", folder]
    assert cli.main([*words, "--method=-109", "--out", str(tmp_path)]) == 0
    assert "| -109 | rigid |" in (tmp_path / "homing.md").read_text(encoding="utf-8")
