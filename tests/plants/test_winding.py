"""The speed-torque curve of a motor on its DC link, against the closed forms of a DC motor."""

import math

import numpy as np
import pytest
from delivered import PLANTS, moves

from servogym.drive.kernel.words import Limit, Mode
from servogym.drive.master import Master
from servogym.envs import linear_axis, rotary_axis
from servogym.envs.masters.port import MachinePort

KT, R, U, INERTIA = 0.05, 1.0, 24.0, 1e-4  # Nm/A, Ohm, V, kg·m²
NO_LOAD, STALL = U / KT, KT * U / R  # rad/s, Nm
MECHANICAL = INERTIA * R / KT**2  # s


def motor(torque=3000, timestep=None, **objects):
    """A disc of `INERTIA` on a motor that gives all it can, in mode tq with `torque` per mille."""
    machine = rotary_axis(
        mechanics="rotary_table", inertia=INERTIA, gear_ratio=1.0, rotor_inertia=0.0,
        coulomb_friction=0.0, viscous_friction=0.0, efficiency=1.0, backlash=0.0,
        transmission_stiffness=0.0, max_velocity=100.0, tuned=False, timestep=timestep,
    )
    x = machine.drives["x"]
    x.commission(
        {
            "motor_torque_constant": KT * 1e6, "motor_resistance": R * 1e6,
            "supply_voltage": U * 1e3, "undervoltage": 0, "max_motor_speed": 60_000,
            "torque_slope": 2**32 - 1, "link_capacitance": 0,
        } | objects
    )
    machine.reset()
    master = Master(MachinePort(machine), "x")
    master.set_mode(Mode.PROFILE_TORQUE)
    master.enable()
    x.write("target_torque", torque)
    return machine, x


def run(machine, x, cycles):
    """Time (s), speed (rad/s), torque (Nm) and limits after each position cycle."""
    rows = []
    for _ in range(cycles):
        machine.step()
        rows.append((machine.time, machine.data.qvel[0], x.axis.torque, x.axis.od.active_limits))
    return np.array(rows).T


def test_it_runs_up_as_an_exponential_to_the_no_load_speed_from_the_stall_torque():
    machine, x = motor()
    time, speed, torque, limits = run(machine, x, 800)
    shares = (0.1, 0.3, 0.5, 0.632, 0.8, 0.95)
    reached = np.interp(np.array(shares) * NO_LOAD, speed, time)
    expected = [MECHANICAL * math.log(0.9 / (1 - share)) for share in shares]
    assert reached[1:] - reached[0] == pytest.approx(expected[1:], rel=0.01)
    assert speed[-1] == pytest.approx(NO_LOAD, rel=0.01)
    slope = np.polyfit(speed[10:400], torque[10:400], 1)
    assert slope == pytest.approx([-STALL / NO_LOAD, STALL], rel=0.01)  # the straight line
    assert np.all(limits[10:100].astype(int) & Limit.VOLTAGE)


def test_a_shaft_that_is_held_gets_the_stall_torque_in_both_directions():
    for sign in (1, -1):
        machine, x = motor(sign * 3000)
        machine.model.dof_armature[0] = 1e6  # held
        machine.step(50)
        assert x.axis.torque == pytest.approx(sign * STALL, rel=1e-3)
        assert x.read("statusword") & 0x800


def test_the_current_comes_with_the_electrical_time_constant():
    electrical = 5e-3
    machine, x = motor(motor_inductance=electrical * R * 1e9)
    machine.model.dof_armature[0] = 1e6
    begin = machine.time
    time, _, torque, _ = run(machine, x, 80)
    after = time - begin
    expected = STALL * (1 - np.exp(-after / electrical))
    assert torque[10:] == pytest.approx(expected[10:], rel=0.05)
    slope = np.polyfit(after[4:30], np.log(1 - torque[4:30] / STALL), 1)[0]
    assert -1 / slope == pytest.approx(electrical, rel=0.01)


def test_below_its_limit_the_current_is_what_was_asked_for():
    machine, x = motor(100)  # 0.127 Nm, a tenth of the stall torque
    machine.step(20)
    assert x.axis.torque == pytest.approx(0.127, rel=1e-6)
    assert not x.axis.od.active_limits & Limit.VOLTAGE


def test_above_the_no_load_speed_the_motor_brakes_into_the_link():
    machine, x = motor(0)
    machine.data.qvel[0] = 1.5 * NO_LOAD
    machine.step(4)
    expected = KT * (U - KT * machine.data.qvel[0]) / R
    assert x.axis.torque == pytest.approx(expected, rel=0.01)
    assert expected < -0.4 * STALL


def test_a_supply_behind_a_resistance_sags_by_its_current_and_braking_charges_the_link():
    machine, x = motor(
        300, supply_resistance=500_000, link_capacitance=1000, chopper_voltage=40_000,
        overvoltage=60_000,
    )
    rows = []
    for _ in range(200):
        machine.step()
        power = float(x.axis.torque) * machine.data.qvel[0] + R * (float(x.axis.torque) / KT) ** 2
        rows.append((power, float(x.axis.dc_link)))
    power, link = np.array(rows).T
    # U = (U0 + sqrt(U0² - 4 R P)) / 2 of a source with a resistance
    expected = 0.5 * (U + np.sqrt(np.maximum(U * U - 4 * 0.5 * power, 0.0)))
    assert link[20:] == pytest.approx(expected[20:], rel=0.01)
    assert link.min() < 0.95 * U
    x.write("target_torque", -300)
    machine.step(40)
    assert float(x.axis.dc_link) > U


def test_why_says_that_the_voltage_holds_it_back():
    machine, x = motor()
    machine.step(20)
    assert "the voltage of the DC link" in x.why()
    assert x.read("statusword") & 0x800
    assert x.read("active_limits") & 0x100


def test_without_motor_data_nothing_is_limited_and_no_bit_changes():
    """The record of a run with a resistance of 0 is that of a run without the data."""
    states = []
    for objects in ({"motor_resistance": 0}, {"motor_resistance": 0, "motor_torque_constant": 0}):
        machine, x = motor(500, **objects)
        machine.step(100)
        states.append((machine.data.qvel[0], float(x.axis.torque), int(x.axis.od.active_limits)))
    assert states[0] == states[1]
    assert states[0][1] == pytest.approx(0.635)


def test_a_motor_from_its_parameters_is_sized_with_its_curve():
    machine = linear_axis(speed_torque_curve=True)
    x = machine.drives["x"]
    # inferred: 1.27 Nm at 2.5 A, and the copper loss of 45 W at rated torque
    assert x.axis.od.motor_torque_constant == pytest.approx(508_000)
    assert x.axis.od.motor_resistance == pytest.approx(45.0 / 2.5**2 * 1e6)
    slow = linear_axis(dc_link_voltage=48.0, speed_torque_curve=True, payload=50.0)
    fast = linear_axis(speed_torque_curve=True, payload=50.0)
    names = "profile_velocity", "profile_acceleration"
    assert slow.drives["x"].read(names[0]) < fast.drives["x"].read(names[0])
    for each in (slow, fast):
        each.reset(positions={"x": 0.12})
        master = Master(MachinePort(each), "x")
        master.enable()
        master.home()
        master.move_to(0.45)


OWN = {"dc_link_voltage": 48.0, "motor_torque_constant": KT, "motor_resistance": R}


@pytest.mark.parametrize(
    "weak", [{"supply_resistance": 1.0, "payload": 10.0}, {"dc_link_voltage": 20.0},
             {"supply_resistance": 3.0, "mechanics": "toothed_belt"}], ids=str,
)
def test_a_supply_below_the_rated_torque_still_moves_the_axis(weak):
    """Its profile velocity was 0: enabled, and homing for ever."""
    machine = linear_axis(**OWN | weak)
    machine.reset(positions={"x": 0.12})
    moves(machine, PLANTS["rigid"])


def test_a_supply_too_weak_to_break_away_is_refused_with_what_would_do():
    own = OWN | {"supply_resistance": 6.0, "coulomb_friction": 30.0, "static_friction": 36.0}
    with pytest.raises(ValueError, match=r"0\.343 Nm at most .* needs 0\.\d* Nm to break away"):
        linear_axis(**own, mechanics="toothed_belt")
