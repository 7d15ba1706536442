"""Switches, index pulses and stops as a builder lays them out: homing repeats on every axis."""

import numpy as np
import pytest

from servogym.drive.kernel.homing import METHODS
from servogym.drive.kernel.words import Mode
from servogym.drive.kernel.words import Statusword as S
from servogym.drive.master import Master
from servogym.envs import FAMILY, linear_axis
from servogym.envs.masters.homing_figures import built_in
from servogym.envs.masters.port import MachinePort
from servogym.training.pictures.homing_gallery import fit_home_switch, home_switch

ON_AN_INDEX = [method for method in METHODS if 1 <= method <= 14]
INCREMENT = 0.06 / 2**20  # m, of the coarsest axis


STARTS = (0.033, 0.217, 0.364)  # m, on both sides of the switch
CASES = [  # on each mechanics from one of the places, the other two are slow
    pytest.param(mechanics, seed, id=f"{mechanics}-{seed}", marks=[pytest.mark.slow] * (n % 3 != i))
    for n, mechanics in enumerate(FAMILY)
    for i, seed in enumerate(range(1, 1 + len(STARTS)))
]


@pytest.mark.parametrize(("mechanics", "seed"), CASES)
def test_methods_on_the_index_find_the_same_pulse_from_anywhere(mechanics, seed):
    machine = linear_axis(mechanics=mechanics)
    own = home_switch(machine)
    for method in ON_AN_INDEX:
        fit_home_switch(machine, method, own)
        machine.mechanics["switch_seed"] = seed  # the switches answer elsewhere each time
        run = built_in(machine, method, STARTS[seed - 1])
        assert run.attained, method
        assert abs(run.error) <= 1.01 * INCREMENT, method
        assert not run.index_near, method


def jumps(home_switch_at, method=8):
    """Homes (m) found with a scattered switch, and what the drive says of them."""
    machine = linear_axis(mechanics="ball_screw", home_switch=home_switch_at, switch_scatter=50e-6)
    x, homes, words = machine.drives["x"], [], set()
    for seed in range(1, 7):
        machine.mechanics["switch_seed"] = seed
        machine.reset(positions={"x": 0.1})
        master = Master(MachinePort(machine))
        master.enable()
        master.set_mode(Mode.HOMING)
        x.write("homing_method", method)
        master.home()
        homes.append((x.axis.zero_counts * x.axis.rad_per_increment) / machine.couplings[0].gear)
        words.add(bool(x.read("statusword") & S.WARNING))
    return np.ptp(homes), words, x


def test_an_edge_on_the_pulse_jumps_by_a_pitch_and_the_drive_warns():
    spread, warned, x = jumps(0.2)
    assert spread == pytest.approx(0.01, rel=0.01)
    assert warned == {True}
    assert x.read("homing_index_distance") < 100 or x.read("homing_index_distance") > 900
    spread, warned, x = jumps(0.205)
    assert spread < 1e-6
    assert warned == {False}
    assert 400 < x.read("homing_index_distance") < 600


def test_the_warning_is_told_by_its_code_and_goes_with_the_mode():
    machine = linear_axis(feed_constant=0.01, home_switch=0.2)
    machine.reset(positions={"x": 0.1})
    x = machine.drives["x"]
    master = Master(MachinePort(machine))
    master.enable()
    x.write("homing_method", 9)
    master.home()
    assert x.read("statusword") & S.WARNING
    assert x.read(0x1003, 1) & 0xFFFF == 0xFF10
    master.set_mode(Mode.PROFILE_POSITION)
    machine.step(4)
    assert not x.read("statusword") & S.WARNING


@pytest.mark.parametrize("drive", ["generic", "festo_cmmp_as"])
@pytest.mark.parametrize("mechanics", FAMILY)
def test_homing_on_a_stop_at_50_mm_per_s_attains_on_every_mechanics(mechanics, drive):
    machine = linear_axis(drive, mechanics=mechanics)
    fast = {"speed_during_search_for_zero": 50_000}
    for method, start in ((-1, 0.02), (-2, 0.48), (-17, 0.02), (-18, 0.48)):
        run = built_in(machine, method, start, objects=fast)
        assert run.attained, method
        if method in (-1, -2):
            assert abs(run.error) <= 1.01 * INCREMENT * 2**20 / 65536, method
