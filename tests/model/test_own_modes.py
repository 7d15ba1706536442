"""Modes of operation of a drive model: numbers in its drive.toml, functions in its modes.py."""

import copy
import math
import subprocess
import sys

import pytest

from servogym.drive import Drive, SdoAbort, run_code
from servogym.drive.diagrams import controlword_bits, statusword_bits
from servogym.drive.kernel.jit import DISABLED
from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.drive.model.model import load
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort
from servogym.training import cli

TOML = """based_on = "generic"
[modes.wobble]
number = -3
bits = ["in_swing", "crest", ""]
bit_4 = "start_wobble"
section = "my manual 7.3"
"""
MODES = """
import math
from servogym.drive import ModeOfOperation
from servogym.drive.kernel.cascade import Control
from servogym.drive.kernel.jit import block

SPEED = 10.0

def start(axis):
    axis.control = Control.VELOCITY
    axis.od.motion_profile_type += 1

@block
def swing(axis):
    return SPEED * math.sin(2.0 * math.pi * axis.cycle_count * axis.position_period)

def demand(axis):
    axis.velocity_demand = swing(axis)
    axis.position_demand = axis.position

def status(axis):
    axis.mode_bit10 = 1
    axis.mode_bit12 = swing(axis) > 9.0

def leave(axis):
    axis.od.motion_profile_type = 100

MODES = {"wobble": ModeOfOperation(start, demand, status, leave)}
"""


@pytest.fixture
def folder(tmp_path):
    """Makes a model with a mode; without consent."""

    def make(toml=TOML, modes=MODES, name="swinging"):
        place = tmp_path / name
        place.mkdir()
        (place / "drive.toml").write_text(toml)
        if modes:
            (place / "modes.py").write_text(modes)
        return place

    return make


def enabled(drive, mode=-3):
    drive.write("modes_of_operation", mode)
    for word in (6, 7, 15):
        drive.write("controlword", word)
        cycle(drive, 4)
    return drive


def cycle(drive, n):
    """The demand (rad/s) of each of `n` cycles on a shaft that is held."""
    demands = []
    for _ in range(n):
        drive.cycle(angle=0.0, speed=0.0)
        demands.append(float(drive.axis.velocity_demand))
    return demands


def test_a_mode_is_not_run_without_consent(folder):
    own = folder(modes="raise SystemExit('it ran')")
    load(own)
    with pytest.raises(ValueError, match=r"drive.toml: modes.wobble: .*modes.py is a program"):
        Drive(own)


def test_the_demand_is_the_one_of_the_folder(folder):
    run_code(own := folder())
    drive = enabled(Drive(own))
    first = int(drive.axis.cycle_count)
    period = float(drive.axis.position_period)
    expected = [10.0 * math.sin(2 * math.pi * (first + n) * period) for n in range(2000)]
    assert cycle(drive, 2000) == pytest.approx(expected, abs=1e-9)
    assert drive.mode == -3
    assert drive.mode.name == "MANUFACTURER_3"
    assert copy.deepcopy(drive.mode) is drive.mode


def test_a_master_is_told_of_it_as_of_each_mode(folder):
    """6502h: bit 18 is -3 (CiA 402-2: 16-31 are the maker's); 6060h takes it, 6061h shows it."""
    run_code(own := folder())
    drive = enabled(Drive(own))
    standard = Drive("generic").read("supported_drive_modes")
    assert drive.read("supported_drive_modes") == standard | 1 << 18
    assert drive.read("modes_of_operation_display") == -3
    with pytest.raises(SdoAbort):
        drive.write("modes_of_operation", -4)
    with pytest.raises(SdoAbort):
        Drive("generic").write("modes_of_operation", -3)


def test_its_bits_have_their_names(folder):
    run_code(own := folder())
    drive = enabled(Drive(own))
    crest = [drive.describe().endswith("in_swing crest") for _ in range(4000)
             if cycle(drive, 1)]
    assert 0 < sum(crest) < len(crest) / 4
    assert drive.read("statusword") & 1 << 10
    own_modes = drive.model.own_modes
    assert [bit.name for bit in statusword_bits(-3, own_modes)][10:14] == [
        "in_swing", "internal_limit_active", "crest", "bit 13",
    ]
    assert controlword_bits(-3, own_modes)[4].name == "start_wobble"


def test_leave_is_called_when_another_mode_is_selected_and_when_the_power_goes_off(folder):
    run_code(own := folder())
    drive = enabled(Drive(own))
    assert drive.read("motion_profile_type") == 1  # `start`, once
    drive.write("modes_of_operation", 3)
    cycle(drive, 2)
    assert (drive.mode, drive.read("motion_profile_type")) == (Mode.PROFILE_VELOCITY, 100)
    enabled(drive)
    assert drive.read("motion_profile_type") == 101
    drive.write("controlword", 0)
    cycle(drive, 2)
    assert drive.read("motion_profile_type") == 100


def test_start_is_called_anew_after_a_halt(folder):
    run_code(own := folder())
    drive = enabled(Drive(own))
    drive.write("controlword", 0x10F)
    assert cycle(drive, 2000)[-1] == 0.0
    drive.write("controlword", 0xF)
    assert max(cycle(drive, 4000)) > 9.9
    assert drive.read("motion_profile_type") == 2


def test_two_folders_have_a_mode_of_one_number_each_its_own(folder):
    ones = folder(), folder(modes=MODES.replace("10.0", "5.0"), name="slower")
    highest = []
    for own in ones:
        run_code(own)
        highest.append(max(cycle(enabled(Drive(own)), 4000)))
    assert highest == pytest.approx([10.0, 5.0], rel=1e-4)


def test_a_snapshot_goes_on_in_another_drive_of_the_model(folder):
    run_code(own := folder())
    drive = enabled(Drive(own))
    cycle(drive, 123)
    other = Drive(own)
    other.restore(drive.snapshot())
    assert cycle(other, 500) == cycle(drive, 500)


def test_it_moves_an_axis_and_a_master_sets_it_by_name(folder):
    run_code(own := folder())
    machine = linear_axis(load(own))
    master = Master(MachinePort(machine))
    master.enable()
    master.set_mode("wobble")
    assert [drive.mode for drive in machine.drives.values()] == [-3]


def test_commands_show_it_by_its_name(folder, capsys):
    run_code(own := folder())
    assert cli.main(["drives", str(own)]) == 0
    assert "wobble" in capsys.readouterr().out


def test_a_model_based_on_one_with_a_mode_has_the_mode(folder):
    own = folder()
    above = folder(f'based_on = "{own}"\n', modes="", name="above")
    run_code(above)
    assert max(cycle(enabled(Drive(above)), 4000)) > 9.9


@pytest.mark.parametrize(
    ("toml", "says"),
    [
        (("-3", "3"), "wobble.number = 3: numbers of a maker are -1 to -16"),
        (("-3", "-17"), "wobble.number = -17: numbers of a maker are -1 to -16"),
        (("number = -3", ""), "wobble.number = None"),
        (("bits", "bit"), "modes.wobble.bit is unknown: .*bits"),
        (('"crest", ', ""), "bits = .* is not a list of three names"),
        (('"start_wobble"', "4"), "bit_4 = 4 is not a text"),
        (("wobble", "csp"), "modes.csp: the standard has a mode of this name"),
        (("[modes.wobble]", "[modes]"), "modes.number is not a table"),
        (("[modes.wobble]", "[modes.w]\nnumber = -3\n[modes.wobble]"), "each for one mode"),
    ],
)
def test_what_cannot_be_right_is_refused_with_file_and_key(folder, toml, says):
    with pytest.raises(ValueError, match=rf"drive.toml: .*{says}"):
        load(folder(TOML.replace(*toml)))


@pytest.mark.parametrize(
    ("modes", "says"),
    [
        ("", "drive.toml: modes.wobble: there is no program: write MODES"),
        ("MODES = {}", "modes.wobble: there is no program"),
        ("MODES = {'wobble': print}", "has to be a servogym ModeOfOperation"),
        ("1 / 0", "modes.py fails .ZeroDivisionError"),
        pytest.param(
            MODES.replace("axis.velocity_demand", "axis.velocity_demnd"),
            r"modes.py, line 18, in demand: .*no 'velocity_demnd' here.*velocity_demand",
            marks=pytest.mark.skipif(DISABLED, reason="nothing is compiled"),
        ),
    ],
)
def test_a_program_that_cannot_be_right_is_told_with_its_place(folder, modes, says):
    run_code(own := folder(modes=modes))
    with pytest.raises(ValueError, match=says):
        Drive(own)


def test_a_mode_of_an_installed_package_needs_no_consent(folder, tmp_path, monkeypatch):
    place = tmp_path / "site-packages"
    about = place / "swings-1.0.dist-info"
    about.mkdir(parents=True)
    (place / "swings.py").write_text(f"{MODES}\nwobble = MODES['wobble']\n")
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: swings\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[servogym.modes]\nwobble = swings:wobble\n")
    monkeypatch.syspath_prepend(place)
    assert max(cycle(enabled(Drive(folder(modes=""))), 4000)) > 9.9


PLAIN = """
import sys
from servogym.drive import Drive, run_code
run_code(sys.argv[1])
drive = Drive(sys.argv[1])
drive.write("modes_of_operation", -3)
for word in (6, 7, 15):
    drive.write("controlword", word)
    for _ in range(4):
        drive.cycle(angle=0.0, speed=0.0)
demands = []
for _ in range(50):
    drive.cycle(angle=0.0, speed=0.0)
    demands.append(float(drive.axis.velocity_demand))
print(demands == eval(sys.argv[2]))
"""


def test_python_runs_the_same_as_compiled_code(folder, monkeypatch):
    run_code(own := folder())
    compiled = cycle(enabled(Drive(own)), 50)
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    done = subprocess.run(
        [sys.executable, "-c", PLAIN, str(own), repr(compiled)], capture_output=True, text=True
    )
    assert done.stdout == "True\n", done.stderr
