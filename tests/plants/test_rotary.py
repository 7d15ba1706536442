"""Axes without ends, gears, the warm motor and the encoder at the load, against closed forms."""

import math
from fractions import Fraction

import numpy as np
import pytest

from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.envs import ROTARY_FAMILY, Machine, RotaryParameters, linear_axis, rotary_axis
from servogym.envs.masters.port import MachinePort

G = 9.81
RIGID = {
    "coulomb_friction": 0.0, "viscous_friction": 0.0, "efficiency": 1.0, "backlash": 0.0,
    "transmission_stiffness": 0.0,
}


def master_of(machine):
    master = Master(MachinePort(machine))
    master.enable()
    return master


def in_mode(machine, mode, **objects):
    for name, value in objects.items():
        machine.drives["x"].write(name, value)
    master = master_of(machine)
    master.set_mode(mode)
    return master


@pytest.mark.parametrize("drive", ["generic", "festo_cmmp_as", "metronix_ars2000"])
@pytest.mark.parametrize("mechanics", ROTARY_FAMILY)
def test_every_axis_without_ends_homes_and_moves(mechanics, drive):
    machine = rotary_axis(drive, mechanics=mechanics)
    machine.reset(positions={"x": 0.5})
    x = machine.drives["x"]
    master = master_of(machine)
    master.home()
    p = ROTARY_FAMILY[mechanics]
    place = machine.data.qpos.sum() % p.period
    slack = p.backlash + 0.001 * p.period
    assert place == pytest.approx(0.25 * p.period, abs=slack), "the edge, before its hysteresis"
    master.move_to(0.4 * p.period)
    machine.step(400)
    window = x.read("position_window")
    assert abs(x.read("position_actual_value") * p.unit - 0.4 * p.period) <= window * p.unit


def test_a_table_counts_on_over_its_turns_and_shows_one():
    machine = rotary_axis(**RIGID, max_velocity=30.0, max_acceleration=100.0, inertia=0.05)
    x = machine.drives["x"]
    master = master_of(machine)
    x.write("homing_method", 37)
    master.home()
    master.set_mode(Mode.PROFILE_VELOCITY)
    x.write("target_velocity", 1_700_000)  # 0.001 degree/s
    while machine.data.qpos[0] < 20 * 2 * math.pi:
        machine.step(20)
        assert 0 <= x.read("position_actual_value") < 360_000
    x.write("target_velocity", 0)
    machine.step(2000)
    degrees = math.degrees(machine.data.qpos[0]) % 360.0
    assert x.read("position_actual_value") == pytest.approx(1e3 * degrees, abs=1.5)
    assert x.axis.counts == math.floor(machine.data.qpos[0] * 50 / x.axis.rad_per_increment)


def test_a_conveyor_goes_pitch_by_pitch_without_drift():
    steps = 40
    machine = rotary_axis(mechanics="conveyor", pitch=0.3)
    p = RotaryParameters(circumference=0.4, pitch=0.3)
    x = machine.drives["x"]
    master = master_of(machine)
    x.write("homing_method", 37)
    master.home()
    # relative moves of a whole pitch: the shown position is the same after each, the belt goes on
    shown = []
    for _ in range(steps):
        master.move_to(p.period, relative=True)
        shown.append(x.read("position_actual_value"))
    away = (np.array(shown) + 150_000) % 300_000 - 150_000
    assert np.abs(away).max() <= x.read("position_window")
    way = machine.data.qpos[0] * 0.4 / (2 * math.pi)
    assert way == pytest.approx(steps * 0.3, abs=1e-6 * x.read("position_window") + 1e-6)


def test_the_feed_of_a_conveyor_is_an_exact_fraction():
    machine = rotary_axis(mechanics="conveyor")
    x = machine.drives["x"]
    feed = Fraction(x.read("feed"), x.read("feed_shaft_revolutions"))
    assert feed == Fraction(400_000, 8), "0.4 m in 8 motor revolutions, µm"


@pytest.mark.parametrize("mechanics", ROTARY_FAMILY)
def test_a_table_accelerates_with_the_torque_over_its_inertia(mechanics):
    machine = rotary_axis(mechanics=mechanics, **RIGID)
    in_mode(machine, Mode.PROFILE_TORQUE, target_torque=100, torque_slope=10**6)
    machine.step(100)
    before, torque = machine.data.qvel[0], float(machine.drives["x"].axis.torque)
    machine.step(100)
    p = ROTARY_FAMILY[mechanics]
    inertia = p.inertia + 0.6e-4 * p.gear_ratio**2
    expected = torque * p.gear_ratio / inertia * 100 * machine.cycle_time
    assert machine.data.qvel[0] - before == pytest.approx(expected, rel=0.01)


def test_a_gear_winds_up_by_the_torque_over_its_stiffness():
    stiffness, torque = 2e4, 30.0
    machine = rotary_axis(
        **(RIGID | {"transmission_stiffness": stiffness}), transmission_damping=60.0
    )
    master_of(machine)
    machine.data.body("table").xfrc_applied[5] = torque
    machine.step(4000)
    assert machine.data.qpos[1] == pytest.approx(torque / stiffness, rel=0.01)


def lifting_torque(efficiency, direction):
    """Mean motor torque (Nm) that lifts (+1) or lowers a load at constant speed."""
    machine = linear_axis(
        tuned=False,  # for a moment, beyond the rated torque
        inclination=90.0, payload=10.0, coulomb_friction=0.0, viscous_friction=0.0,
        transmission_stiffness=1e6, transmission_damping=400.0, efficiency=efficiency,
    )
    machine.reset(positions={"x": 0.3 if direction < 0 else 0.1})
    x = machine.drives["x"]
    in_mode(machine, Mode.PROFILE_VELOCITY, target_velocity=direction * 50_000)
    machine.step(2000)
    torques = []
    for _ in range(1000):
        machine.step()
        torques.append(float(x.axis.torque))
    assert machine.data.qvel[0] == pytest.approx(direction * 0.05, rel=0.02)
    return np.mean(torques)


@pytest.mark.parametrize("efficiency", [0.95, 0.7])
def test_a_gear_needs_more_torque_to_lift_and_less_to_lower(efficiency):
    load = 11.5 * G * 0.06 / (2 * math.pi)
    assert lifting_torque(efficiency, 1) == pytest.approx(load / efficiency, rel=0.01)
    assert lifting_torque(efficiency, -1) == pytest.approx(load * (2 - 1 / efficiency), rel=0.02)


@pytest.mark.parametrize(("efficiency", "locks"), [(0.49, True), (0.51, False)])
def test_a_gear_of_half_efficiency_locks_itself(efficiency, locks):
    machine = linear_axis(
        inclination=90.0, coulomb_friction=0.0, viscous_friction=0.0,
        transmission_stiffness=1e6, transmission_damping=400.0, efficiency=efficiency,
    )
    machine.reset(positions={"x": 0.4})
    machine.step(4000)
    fallen = 0.4 - machine.data.qpos[0]
    assert fallen < 1e-3 if locks else fallen > 0.01


def test_a_motor_warms_as_one_thermal_mass():
    loss, resistance, time = 200.0, 1.5, 2.0
    machine = linear_axis(
        brake_torque=100.0, motor_winding_loss=loss, motor_thermal_resistance=resistance,
        motor_thermal_time=time, motor_temperature_limit=150.0,
    )
    x = machine.drives["x"]
    in_mode(machine, Mode.PROFILE_TORQUE, i2t_time=0)
    machine.couplings["brake_friction"] = 0.0
    machine.couplings["friction"] = 1e5  # it stands and holds
    x.write("torque_slope", 10**6)
    x.write("target_torque", 800)
    machine.step(500)
    begin = x.read("motor_temperature") / 10
    machine.step(round(1.5 / machine.cycle_time))
    final = 25.0 + loss * 0.8**2 * resistance
    expected = final - (final - begin) * math.exp(-1.5 / time)
    assert x.read("motor_temperature") / 10 == pytest.approx(expected, rel=0.005)
    machine.step(round(6 / machine.cycle_time))
    assert x.read("error_code") == 0x4310, "above 150 degC"


def displaced(load_encoder):
    """How far a pushed carriage stands from where the drive shows it (m)."""
    machine = linear_axis(
        transmission_stiffness=1e6, transmission_damping=300.0, coulomb_friction=0.0,
        load_encoder=load_encoder,
    )
    machine.reset(positions={"x": 0.2})
    x = machine.drives["x"]
    x.write("homing_method", 37)
    x.write("home_offset", 0)
    master = master_of(machine)
    master.home()
    master.move_to(0.1)
    for push in range(1, 51):  # N, slowly
        machine.data.body("payload").xfrc_applied[0] = push
        machine.step(40)
    machine.step(2000)
    assert abs(x.read("position_actual_value") - 100_000) <= 1
    return machine.data.qpos.sum() - 0.3, machine.data.qpos[1]


def test_an_encoder_at_the_load_makes_up_for_the_spring():
    carriage, _ = displaced(False)
    assert carriage == pytest.approx(50.0 / 1e6, rel=0.03), (
        "the encoder at the motor sees none of it"
    )
    carriage, spring = displaced(True)
    assert carriage == pytest.approx(0.0, abs=1.5e-6)
    assert spring == pytest.approx(50.0 / 1e6, rel=0.03)


def test_the_speed_stays_the_motors_and_the_source_is_chosen_while_disabled():
    machine = linear_axis(mechanics="ball_screw_scale")
    x = machine.drives["x"]
    machine.data.qvel[1] = 0.3  # the carriage moves within the spring, the motor does not
    machine.step(1)
    assert abs(x.axis.velocity) < 5.0
    master_of(machine)
    with pytest.raises(Exception, match="present device state"):
        x.write("position_source", 0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"mechanics": "carousel"},
            "mechanics = 'carousel' is unknown: choose one of rotary_table, conv",
        ),
        ({"inertia": 0}, r"inertia = 0 is out of range .* kg·m²"),
        ({"mechanics": "conveyor", "efficiency": 0.9}, "needs a transmission_stiffness"),
        ({"pitch": 0.2}, "a table repeats after a turn"),
        ({"transmission_stiffness": 1e8}, r"1e\+08 Nm/rad between .* kg·m² .* too fast"),
        ({"load_encoder": 1}, "use True or False"),
        ({"parameters": RotaryParameters(), "inertia": 1.0}, "choose one way"),
        ({"timestep": math.nan}, "timestep = nan"),
    ],
)
def test_what_cannot_be_is_named(values, message):
    with pytest.raises(ValueError, match=message):
        rotary_axis(**values)


def test_a_gear_of_an_mjcf_is_checked():
    text = """
    <mujoco><option timestep="0.00025"/><custom><numeric name="a.efficiency" data="{0}"/></custom>
     <worldbody><body><joint name="j" type="slide"/><geom size=".1" mass="2"/></body></worldbody>
     <actuator><motor name="a" joint="j" gear="100"/></actuator></mujoco>"""
    for efficiency, message in (("0.9", "elastic"), ("0", "above 0"), ("2", "out of range 0..1")):
        with pytest.raises(ValueError, match=message):
            Machine.from_mjcf(text.format(efficiency), {"a": "generic"})
    Machine.from_mjcf(text.format("1"), {"a": "generic"})
