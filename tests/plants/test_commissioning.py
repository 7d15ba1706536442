"""Every axis moves as delivered, or one sentence says which payload this motor takes."""

import math
import re

import numpy as np
import pytest

from servogym.drive.master import Master
from servogym.envs import FAMILY, ROTARY_FAMILY, gantry, linear_axis, rotary_axis
from servogym.envs.masters.port import MachinePort
from servogym.envs.plants.loops import gains_of
from servogym.envs.plants.shaft import seen
from servogym.envs.plants.sheet import size

MODELS = (
    "generic", "festo_cmmp_as", "festo_cmmp_as_m0", "festo_cmms", "festo_cmmd",
    "metronix_ars2000", "kollmorgen_akd", "bonfiglioli_act",
)  # fmt: skip
PAYLOADS = (1.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # kg
LIMITS = 6.0, 35.0  # dB and degree, of every loop
REST = 0.5  # s after a move
SAMPLE = [
    ("generic", "toothed_belt", 50.0), ("festo_cmmp_as", "toothed_belt", 10.0),
    ("metronix_ars2000", "rack_pinion", 100.0), ("kollmorgen_akd", "rigid", 100.0),
    ("metronix_ars2000", "toothed_belt", 100.0), ("generic", "vertical", 100.0),
]  # fmt: skip
TURNS = {"rotary_table": (0.01, 0.5, 50.0, 500.0), "conveyor": (0.01, 0.035, 0.5, 5.0)}  # kg·m²


def keeps_margins(machine, *names):
    """Of the model behind the gains the drive has taken."""
    for name in names:
        plant = seen(machine, name)
        for gain, phase, stable in plant.margins(gains_of(machine.drives[name])):
            assert stable
            assert gain >= LIMITS[0]
            assert phase >= LIMITS[1]


def moves(machine, goals):
    """Enable, home by the switch, move to each goal; the following error stays in its window."""
    (name,) = machine.drives
    drive, gear = machine.drives[name], abs(machine.joint(name)[0])
    farthest = [0.0]

    def look():
        farthest[0] = max(farthest[0], abs(float(drive.axis.following_error)) / gear)

    master = Master(MachinePort(machine, look), name)
    master.enable()
    master.home()
    for goal in goals:
        farthest[0] = 0.0
        master.move_to(goal, timeout=60.0)
        assert farthest[0] <= float(drive.axis.following_error_window) / gear
        machine.step(round(REST / machine.cycle_time))
        away = abs(float(drive.axis.position) / gear - goal)
        if drive.axis.range > 0.0:  # the same place a turn farther
            turn = float(drive.axis.range) / gear
            away = min(away % turn, turn - away % turn)
        assert away <= float(drive.axis.position_window) / gear
    assert not drive.fault


def delivered(model, mechanics, payload):
    """Whether the combination moves; else it was refused, with the payload it takes."""
    try:
        machine = linear_axis(model, mechanics=mechanics, payload=payload)
    except ValueError as error:
        said = str(error)
    else:
        return moves_with_margins(machine)
    takes = float(re.search(r"it takes ([0-9.]+) kg", said)[1])
    assert 0.0 < takes < payload
    assert re.search(r"a gear ratio|a higher gear ratio", said)
    assert moves_with_margins(linear_axis(model, mechanics=mechanics, payload=takes))
    return False


def moves_with_margins(machine):
    """Measured of the model itself, then in motion."""
    x = machine.drives["x"]
    if not x.model.positions:
        return True  # an inverter: it has no position to move to
    machine.reset(positions={"x": 0.25})
    keeps_margins(machine, "x")
    machine.reset(positions={"x": 0.12})
    moves(machine, (0.05, 0.15, 0.48, 0.02))  # the last two reach the profile velocity
    assert x.read("profile_velocity") > 0
    return True


@pytest.mark.parametrize("cell", SAMPLE, ids=str)
def test_a_sample_of_the_matrix_moves_or_says_what_would(cell):
    model, mechanics, payload = cell
    heavy = (mechanics, payload) == ("vertical", 100.0)
    soft = (model, mechanics, payload) == ("metronix_ars2000", "toothed_belt", 100.0)
    assert delivered(*cell) is not (heavy or soft)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("mechanics", FAMILY)
def test_the_whole_matrix(model, mechanics):
    """Refused are a vertical axis beyond its rated torque, and the softest belt of some drives."""
    refused = [p for p in PAYLOADS if not delivered(model, mechanics, p)]
    assert refused in ([], [100.0])
    assert not refused or mechanics in ("vertical", "toothed_belt")


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS[:-1])
@pytest.mark.parametrize("mechanics", ROTARY_FAMILY)
def test_rotary_axes_of_every_inertia(model, mechanics):
    for inertia in TURNS[mechanics]:
        try:
            machine = rotary_axis(model, mechanics=mechanics, inertia=inertia)
        except ValueError as error:
            said = str(error)
        else:
            said = ""
        if said:
            assert inertia == max(TURNS[mechanics])
            takes = float(re.search(r"it takes ([0-9.]+) kg", said)[1])
            assert 0.0 < takes < inertia
            machine = rotary_axis(model, mechanics=mechanics, inertia=takes)
        machine.reset(positions={"x": 0.5})
        keeps_margins(machine, "x")
        moves(machine, (0.5, 2.0))


@pytest.mark.parametrize("mechanics", ROTARY_FAMILY)
def test_a_rotary_axis_moves_as_delivered(mechanics):
    machine = rotary_axis("festo_cmmp_as", mechanics=mechanics)
    machine.reset(positions={"x": 0.5})
    keeps_margins(machine, "x")
    moves(machine, (0.5,))


@pytest.mark.parametrize(
    "model", ["generic", *(pytest.param(m, marks=pytest.mark.slow) for m in MODELS[1:-1])]
)
def test_gantries_move_as_delivered(model):
    for payload in (0.5, 9.0):
        machine = gantry(model, payload=payload)
        machine.reset(positions={"x": 0.3, "y": 0.2, "z": -0.1})
        keeps_margins(machine, *machine.drives)
        master = Master(MachinePort(machine), *machine.drives)
        master.enable()
        master.home()
        master.move_to({"x": 0.3, "y": 0.3, "z": -0.15})
        master.move_to({"x": 0.7, "y": 0.1, "z": -0.02})


def test_an_axis_that_moves_well_keeps_the_gains_of_the_rule():
    """Environments of version 0 have them all, so nothing that was learned there changes."""
    rule, tuned = (linear_axis(tuned=tuned).drives["x"] for tuned in (False, True))
    assert rule.parameters.export() == tuned.parameters.export()
    belt = linear_axis(mechanics="toothed_belt", tuned=False).drives["x"]
    tuned = linear_axis(mechanics="toothed_belt").drives["x"]
    assert tuned.read("position_control_gain") > 2 * belt.read("position_control_gain")


@pytest.mark.parametrize("timestep", [None, 31.25e-6])
@pytest.mark.parametrize("mechanics", ["toothed_belt", "ball_screw", "rack_pinion"])
def test_what_vibrates_without_damping_is_damped_by_its_drive(mechanics, timestep):
    machine = linear_axis(
        mechanics=mechanics, timestep=timestep, transmission_damping=0, backlash=0, brake_torque=0,
        static_friction=0, coulomb_friction=0, viscous_friction=0, chain_drag=0,
        chain_drag_growth=0, cogging_torque=0, efficiency=1,
    )  # fmt: skip
    keeps_margins(machine, "x")
    machine.reset(positions={"x": 0.25})
    machine.data.qpos[1] += 1e-4
    kept = vibration(machine)
    assert kept[-400:].max() > 0.9 * kept[:400].max(), "nothing else damps it"
    master = Master(MachinePort(machine), "x")
    master.enable()
    damped = vibration(machine)
    assert damped[-400:].max() < 0.6 * kept[:400].max()


def vibration(machine):
    """Of the load against the motor, in 2 s, about its mean (m)."""
    seen = []
    for _ in range(round(2.0 / machine.cycle_time)):
        machine.step()
        seen.append(float(machine.data.qpos[1]))
    return np.abs(np.array(seen) - np.mean(seen[-400:]))


def test_the_sheet_has_the_textbook_figures_of_two_masses():
    sheet = size(linear_axis(mechanics="toothed_belt"))
    gear = 2 * math.pi / 0.06
    motor, carried, stiffness = (0.6e-4 + 0.1e-4) * gear**2, 6.5, 4e5
    both = math.sqrt(stiffness * (1 / carried + 1 / motor)) / (2 * math.pi)
    alone = math.sqrt(stiffness / carried) / (2 * math.pi)
    assert sheet.resonances[0] == pytest.approx((alone, both), rel=0.01)
    assert sheet.inertia_ratio == pytest.approx(carried / motor, rel=0.02)
    # 10 m/s² of all masses, dry friction, cable chain, cogging and viscous friction at 1 m/s
    force = 10.0 * (carried + motor) + 12.0 + 2.0 + 3.0 * 0.54 + 20.0
    assert sheet.peak_share == pytest.approx((force / gear + 0.013) / 3.81, rel=0.01)
    assert "39.5/121" in str(sheet)


def test_gains_lie_in_the_ranges_of_the_drives_own_objects():
    x = linear_axis("metronix_ars2000", mechanics="toothed_belt", payload=50.0).drives["x"]
    assert 1 <= x.read("velocity_control_time") <= 32000  # 6.6.2.1
    assert 20 <= x.read("velocity_control_gain") <= 16384
    assert 0 <= x.read("position_control_gain") <= 16384  # 6.7.2.3
