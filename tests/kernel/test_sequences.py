"""Whole drives under random masters, inputs, loads and links, against rules written from outside.

The driver is compiled and runs one position cycle after the other on a free shaft. A rule looks at
inputs, state, torque and energy only. Rules: CiA 402-2 device control, IEC 61800-5-2 safe torque
off, CiA 402-2 object 6007h, the energy balance of a capacitor.
"""

import math

import numpy as np
import pytest
from test_device_control import EXPECTED

from servogym.drive.drive import Drive
from servogym.drive.kernel import cycle, jit
from servogym.drive.kernel.faults import Cause
from servogym.drive.kernel.words import State

S = State
OE, QSA, FRA, FAULT = (
    int(state)
    for state in (S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE, S.FAULT)
)
SOD = int(S.SWITCH_ON_DISABLED)
WORDS = np.array([0, 2, 6, 7, 0xB, 0xF, 0xF, 0x1F, 0x3F, 0x7F, 0x80, 0x10F, 0x18F, 0x21F])
WAY = np.array([6, 7, 0xF, 0x1F])
MODES = np.array([1, 2, 3, 4, 6, 7, 8, 9, 10])
EXTERNAL = 1 << Cause.EXTERNAL
RULES = (
    "no torque with safe torque off",
    "no torque outside of operation enabled, quick stop and fault reaction",
    "no state that feeds the motor with safe torque off",
    "no operation enabled without the enable input",
    "every change of state is a row of the standard",
    "operation enabled begins with its command only",
    "a lost connection does what 6007h says",
    "the DC link has the energy that the shaft gave and the chopper left",
    "the chopper works above its threshold, and no more than its resistance",
    "an overvoltage is a fault",
    "a brake is released only while the motor is fed",
)

# [before, after]: in one cycle; a fault with nothing to brake is two rows, a stop may end as the
# next command comes
ROWS = np.eye(len(State), dtype=bool)
for (_before, _), (_, _after) in EXPECTED.items():
    ROWS[_before, _after] = True
ROWS[S.NOT_READY_TO_SWITCH_ON, S.SWITCH_ON_DISABLED] = True
ROWS[S.QUICK_STOP_ACTIVE, S.SWITCH_ON_DISABLED] = True
ROWS = (ROWS.astype(int) @ ROWS) > 0
ROWS[: S.FAULT, S.FAULT_REACTION_ACTIVE] = True
ROWS[: S.FAULT, S.FAULT] = True
ROWS[S.FAULT_REACTION_ACTIVE] = False
ROWS[S.FAULT_REACTION_ACTIVE, [S.FAULT_REACTION_ACTIVE, S.FAULT, S.SWITCH_ON_DISABLED]] = True
ROWS[: S.FAULT, S.SWITCH_ON_DISABLED] = True  # a fault that is reset as it comes


@jit.block
def _event(axis, random):
    """Something that a master, a wire or the load does; -> speed the shaft is kicked to, or nan."""
    od = axis.od
    kind = random.integers(0, 16)
    if kind < 6:
        od.controlword = WORDS[random.integers(0, len(WORDS))]
    elif kind == 6:
        od.modes_of_operation = MODES[random.integers(0, len(MODES))]
    elif kind == 7:
        od.target_velocity = random.integers(-40_000_000, 40_000_000)
        od.vl_target_velocity = random.integers(-3000, 3000)
        od.target_torque = random.integers(-3000, 3000)
        od.target_position = random.integers(-(2**31), 2**31 - 1)
    elif kind == 8:
        axis.sto_input = random.integers(0, 2)
    elif kind == 9:
        axis.enable_input = random.integers(0, 2)
    elif kind == 10:
        axis.connection_lost = random.integers(0, 2)
    elif kind == 11:
        od.abort_connection_option_code = random.integers(0, 4)
    elif kind == 12:
        axis.injected = EXTERNAL if random.integers(0, 3) == 0 else 0
    elif kind == 13:
        od.quick_stop_option_code = random.integers(0, 9)
        od.shutdown_option_code = random.integers(0, 2)
        od.disable_operation_option_code = random.integers(0, 2)
        od.fault_reaction_option_code = random.integers(0, 5)
        od.halt_option_code = random.integers(1, 5)
    elif kind == 14:
        od.chopper_resistance = random.integers(0, 2) * 47_000
        od.brake_fitted = random.integers(0, 2)
    else:
        return random.uniform(-500.0, 500.0)
    axis.parameters_changed = 1
    return math.nan


@jit.entry
def _sequences(axes, template, start, count, random, standard, broken, torque_in):
    """Run `count` sequences from the record `template`; counts broken rules in `broken`.

    `start` is the greatest number of control words on the way to operation enabled. `standard`
    is 1 for a model without an own way of being enabled. `torque_in` counts the cycles with torque
    by state.
    """
    axis = axes[0]
    inertia, energy_of = 0.6e-4, 0.5e-6
    for _ in range(count):
        axes[0] = template[0]
        angle, speed = 0.0, 0.0
        words = random.integers(0, start + 1)
        events = random.integers(2, 12)
        cycle.run(axes, 0, angle, speed)
        axis.od.modes_of_operation = MODES[random.integers(0, len(MODES))]
        for step in range(words + events):
            cycles, lost = 2, 0
            if step < words:
                axis.od.controlword = WAY[min(step, len(WAY) - 1)]
                axis.parameters_changed = 1
            else:
                kick = _event(axis, random)
                if not math.isnan(kick):
                    speed = kick
                cycles = random.integers(1, 9)
            for _ in range(cycles):
                od = axis.od
                before, torque = axis.state, axis.torque
                shown = math.floor(angle / axis.rad_per_increment) - axis.counts
                work = torque * shown * axis.rad_per_increment
                volts, heat = axis.dc_link, axis.link_energy
                now = cycle.run(axes, 0, angle, speed)
                after = axis.state
                torque_in[after] += now != 0.0
                powered = after in (OE, QSA, FRA)
                lost = lost + 1 if axis.connection_lost else 0
                if not axis.sto_input:
                    broken[0] += now != 0.0
                    broken[2] += powered
                broken[1] += not powered and now != 0.0
                broken[3] += after == OE and not axis.enable_input
                if standard:
                    broken[4] += not ROWS[before, after]
                    asked = od.controlword & 0xF == 0xF
                    broken[5] += before != OE and after == OE and not asked
                    code = od.abort_connection_option_code
                    if lost > 2 and before == after:
                        fault = after in (FRA, FAULT)
                        off = fault or after == SOD
                        broken[6] += code == 1 and not fault
                        broken[6] += code == 2 and not off
                        broken[6] += code == 3 and not (off or after == QSA)
                    capacitance = energy_of * od.link_capacitance
                    stored = capacitance * (axis.dc_link**2 - volts**2)
                    burnt = axis.link_energy - heat
                    drawn = stored + burnt + work  # from the mains, through the rectifier
                    small = 1e-9 * capacitance * axis.dc_link**2
                    broken[7] += drawn < -small
                    broken[7] += drawn > small and axis.dc_link > od.supply_voltage * 1e-3
                    most = 0.0
                    if od.chopper_resistance > 0 and volts > od.chopper_voltage * 1e-3:
                        most = volts**2 / (od.chopper_resistance * 1e-3) * axis.position_period
                    broken[8] += burnt < 0 or burnt > most * (1 + 1e-9) + 1e-12
                    over = 0 < od.overvoltage < od.dc_link_circuit_voltage
                    broken[9] += over and after != FRA and after != FAULT
                fed = powered and axis.sto_input
                broken[10] += od.brake_fitted and axis.brake_released and not fed
                angle += speed * axis.position_period
                speed += now / inertia * axis.position_period
                speed = min(max(speed, -600.0), 600.0)


def check_sequences(model, count, seed):
    """One velocity cycle a position cycle, so that the torque seen is all the torque there was."""
    drive = Drive(model)
    axis = drive.axis
    drive.cycle(0.0)
    axis.position_period = axis.velocity_period
    axis.velocity_cycles = 1
    if model == "bonfiglioli_act":
        for data_set in range(1, 5):
            drive.write(0x219C, data_set, 1)  # 412: the controlword, while contacts are closed
        axis.terminals = 3
        drive.cycle(0.0)
    axis.parameters_changed = 1
    template = drive.axes.copy()
    broken = np.zeros(len(RULES), np.int64)
    standard = int(model == "generic")
    if standard:
        axis.od.link_capacitance = template["od"]["link_capacitance"] = 20
    random = np.random.default_rng(seed)
    torque_in = np.zeros(len(State), np.int64)
    _sequences(drive.axes, template, 4, count, random, standard, broken, torque_in)
    assert {rule: int(n) for rule, n in zip(RULES, broken, strict=True) if n} == {}
    assert jit.DISABLED or torque_in[[OE, QSA, FRA]].min() > 0, (
        "the rules were never put to the test"
    )


MODELS = ("generic", "festo_cmmp_as", "metronix_ars2000", "kollmorgen_akd", "bonfiglioli_act")


@pytest.mark.parametrize("model", MODELS)
def test_no_sequence_breaks_a_rule(model):
    check_sequences(model, 5 if jit.DISABLED else 2_000, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_no_sequence_breaks_a_rule_long(model):
    check_sequences(model, 1_000_000 if model == "generic" else 200_000, seed=2)
