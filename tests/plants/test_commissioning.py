"""Every axis moves as delivered, or one sentence says which payload this motor takes."""

import math

import numpy as np
import pytest
from delivered import (
    CELLS,
    LEAST,
    LIKE,
    MODELS,
    PLANTS,
    Cell,
    margins,
    play,
    settling_of,
)
from later import only_with

from servogym.drive.master import Master
from servogym.envs import linear_axis, rotary_axis
from servogym.envs.masters.port import MachinePort
from servogym.envs.plants.loops import gains_of
from servogym.envs.plants.sheet import size

SAMPLE = {  # and what becomes of them
    Cell("generic", "toothed_belt", 50.0): "moves",
    Cell("festo_cmmp_as", "toothed_belt", 10.0): "moves",
    Cell("metronix_ars2000", "rack_pinion", 100.0): "moves",
    Cell("kollmorgen_akd", "rigid", 100.0): "moves",
    Cell("metronix_ars2000", "toothed_belt", 100.0): "refused",
    Cell("generic", "vertical", 100.0): "refused",
    Cell("festo_cmms", "rotary_table", 50.0): "refused",
    Cell("festo_cmmp_as", "conveyor", 0.035): "moves",
    Cell("generic", "gantry-x1x2", 2.0): "moves",
    Cell("bonfiglioli_act", "linear_motor", 5.0): "refused",
    Cell("bonfiglioli_act", "vertical", 100.0): "moves",
}
# what torque and speed allow, and a drive's gains do not: too soft a belt or gear for the longest
# action time of a velocity controller; an asynchronous motor without a rotor of its own
SHORT_TIMES = ("festo_cmmp_as", "festo_cmmp_as_m0", "festo_cmms", "festo_cmmd", "metronix_ars2000")
NO_GAINS = {
    *(Cell(m, "toothed_belt", 100.0) for m in SHORT_TIMES),
    *(Cell(m, "rotary_table", inertia) for m in SHORT_TIMES for inertia in (15.0, 50.0)),
    *(Cell(m, "rotary_table", 500.0) for m in MODELS[:-1]),
    *(Cell("bonfiglioli_act", "linear_motor", load) for load in (1.0, 5.0)),
}


@only_with("control", "scipy")
@pytest.mark.parametrize("cell", SAMPLE, ids=str)
def test_a_sample_of_the_matrix_moves_with_measured_margins_or_says_what_would(cell):
    found = play(cell, measure=True)
    assert found.kind == SAMPLE[cell], found.said


@only_with("control", "scipy")
@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("model", MODELS)
def test_the_whole_matrix(model, plant):
    """Each at most two minutes on a quiet machine; its table is docs/results/commissioning.md."""
    for cell in CELLS:
        if (cell.model, cell.plant) == (model, plant):
            found = play(cell, measure=True, tuned=cell.tuned)
            moves = cell.torque_allows and cell not in NO_GAINS
            assert found.kind == ("moves" if moves else "refused"), found.said
            assert "tune: " not in found.said, found.said
            assert not cell.tuned or abs(found.changed) <= LIKE


def test_of_what_torque_and_speed_allow_nine_in_ten_move():
    """Which cells are refused is proved one by one above."""
    allowed = [cell for cell in CELLS if cell.torque_allows]
    assert len(CELLS) == 528
    assert sum(cell not in NO_GAINS for cell in allowed) >= 0.9 * len(allowed)


@only_with("control", "scipy")
@pytest.mark.parametrize(
    "cell",
    [
        Cell("generic", "rack_pinion", 5.0), Cell("festo_cmms", "toothed_belt", 5.0),
        # a heavy load behind a gear with losses: what is measured is the plant while it is pushed
        Cell("generic", "rack_pinion", 100.0),
        # gains of the rule would let it creep into the window
        Cell("metronix_ars2000", "rack_pinion", 5.0),
    ],
    ids=str,
)
def test_tune_leaves_the_settling_of_a_freshly_commissioned_axis_as_it_is(cell):
    """It was halved before commissioning ended tuned; all usual and heaviest loads: the matrix."""
    found = play(cell, tuned=True)
    assert found.kind == "moves", found.said
    assert abs(found.changed) <= LIKE


@only_with("control", "scipy")
@pytest.mark.parametrize("factor", [0.3, 3.0])
@pytest.mark.parametrize(
    "cell",
    [
        # with soft gains backlash hides the plant, and the first fit is unstable
        Cell("generic", "rack_pinion", 100.0),
        *(pytest.param(cell, marks=pytest.mark.slow) for cell in (
            Cell("generic", "rack_pinion", 5.0), Cell("generic", "rack_pinion", 50.0),
            Cell("metronix_ars2000", "rack_pinion", 100.0), Cell("generic", "toothed_belt", 50.0),
            Cell("festo_cmms", "rack_pinion", 100.0), Cell("generic", "rotary_table", 5.0),
            Cell("kollmorgen_akd", "rack_pinion", 100.0), Cell("generic", "vertical", 50.0),
            Cell("kollmorgen_akd", "rotary_table", 15.0), Cell("generic", "ball_screw", 100.0),
            Cell("generic", "gantry-x1x2", 2.0),
        )),
    ],
    ids=str,
)
def test_from_detuned_gains_an_axis_settles_as_soon_as_it_did_commissioned(cell, factor):
    machine, plant = cell.machine(), PLANTS[cell.plant]
    machine.reset(positions=plant.middle)
    before, after = settling_of(machine, plant, factor)
    assert after <= (1 + LIKE) * before + LEAST


def test_no_position_loop_is_commissioned_that_is_too_slow_to_be_measured():
    """It took 240 kg·m² with a crossover at 0.1 Hz, and `tune` changed its settling by 13 %."""
    said = r"would cross over at 0\.11 Hz, too slow to measure, .*; it takes 130 kg·m²; with a gear"
    with pytest.raises(ValueError, match=said):
        rotary_axis("kollmorgen_akd", mechanics="rotary_table", inertia=240.0)
    gains = gains_of(rotary_axis("kollmorgen_akd", inertia=130.0).drives["x"])
    assert gains.position_gain >= 0.4 * math.pi
    assert gains.integral_time == pytest.approx(1 / (0.4 * math.pi), abs=1e-6)


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
    )
    margins(machine)
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
