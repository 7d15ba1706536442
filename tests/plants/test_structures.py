"""Other control structures than P over PI, against an independent simulation of the same loop.

The simulation has plant and current loop from scipy, the controller as its block diagram says, and
the encoder as a rounding; nothing of the kernel. It gets the demand that the drive shows.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from later import Later

from servogym.drive.advice import remedy
from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.envs import linear_axis, rotary_axis
from servogym.envs.masters.port import MachinePort

signal = Later("scipy.signal")
INERTIA, VISCOUS = 2e-4, 1e-3  # kg·m², Nm·s/rad
GAIN, INTEGRAL, DERIVATIVE, FFV, FFA = 6.0, 90.0, 0.12, 1.5e-3, 2e-4
PERIOD, LAG = 250e-6, 300e-6  # s, of the generic drive


def turning(encoder=65536, **objects):
    """A disc with viscous friction, its drive enabled in csp, its encoder with so many lines."""
    machine = rotary_axis(
        mechanics="rotary_table", inertia=INERTIA, gear_ratio=1.0, rotor_inertia=0.0,
        coulomb_friction=0.0, viscous_friction=VISCOUS, efficiency=1.0, backlash=0.0,
        transmission_stiffness=0.0, max_velocity=100.0, tuned=False,
    )
    x = machine.drives["x"]
    x.commission({
        "encoder_increments": encoder, "following_error_window": 2**32 - 1,
        "acceleration_feed_forward": FFA * 1e9, "max_motor_speed": 60_000,
        "min_position_range_limit": 0, "max_position_range_limit": 0,
    } | objects)
    machine.reset()
    master = Master(MachinePort(machine), "x")
    master.set_mode(Mode.CYCLIC_SYNC_POSITION)
    master.enable()
    return machine, x


PID = {
    "control_structure": 1, "pid_gain": GAIN * 1e6, "pid_integral_gain": INTEGRAL * 1e3,
    "pid_derivative_gain": DERIVATIVE * 1e6, "velocity_torque_feed_forward": FFV * 1e6,
}


def wave(machine, x, cycles=1200, amplitude=2.0):
    """Command a step and a wave; -> demands of each position cycle, and positions (rad)."""
    unit, rows = float(x.axis.rad_per_position_unit), []
    for k in range(cycles):
        goal = amplitude * math.sin(2 * math.pi * 2.0 * k * 500e-6) + (0.2 if k > 50 else 0.0)
        x.write("target_position", round(goal / unit))
        before = machine.data.qpos[0]
        machine.step()
        rows.append((x.axis.position_demand, x.axis.velocity_demand, x.axis.acceleration_demand,
                     before))
    return np.array(rows)


@dataclass
class Loop:
    """The block diagram again: one call is one velocity cycle."""

    increment: float
    limit: float = 3.81
    integral: float = 0.0
    error: float = 0.0
    difference: float = 0.0
    torque: float = 0.0

    def __post_init__(self):
        self.share = signal.cont2discrete(([1.0], [LAG, 1.0]), PERIOD)[0].ravel()[1]
        filter_ = [1.0], [DERIVATIVE / (10 * GAIN), 1.0]
        self.low_pass = signal.cont2discrete(filter_, PERIOD)[0].ravel()[1]

    def seen(self, position):
        return math.floor(position / self.increment + 1e-12) * self.increment

    def limited(self, wanted):
        possible = min(max(wanted, -self.limit), self.limit)
        self.torque += self.share * (possible - self.torque)
        return possible

    def pid(self, position, demand, speed, acceleration):
        error = demand - self.seen(position)
        self.difference += self.low_pass * ((error - self.error) / PERIOD - self.difference)
        self.error = error
        wanted = GAIN * error + self.integral + DERIVATIVE * self.difference
        wanted += FFV * speed + FFA * acceleration
        possible = self.limited(wanted)
        if possible == wanted or (possible - wanted) * error >= 0.0:
            self.integral += PERIOD * INTEGRAL * error


def simulated(rows, loop, act):
    """Positions at the beginning of each position cycle, by the physics step of MuJoCo."""
    speed, position, positions = 0.0, rows[0, 3], []
    loop.error = rows[0, 0] - loop.seen(position)
    for demand, velocity, acceleration, _ in rows:
        positions.append(position)
        for part in range(2):  # the demand moves on with its velocity
            act(position, demand + part * PERIOD * velocity, velocity, acceleration)
            # the semi-implicit step of a damped inertia, its damping taken implicitly
            speed = (INERTIA * speed + PERIOD * loop.torque) / (INERTIA + PERIOD * VISCOUS)
            position += PERIOD * speed
    return np.array(positions)


@pytest.mark.parametrize("encoder", [65536, 4096, 48])
def test_a_position_pid_follows_the_independent_simulation_within_one_increment(encoder):
    machine, x = turning(encoder, **PID)
    rows = wave(machine, x)
    increment = 2 * math.pi / encoder
    loop = Loop(increment)
    expected = simulated(rows, loop, loop.pid)
    assert np.ptp(rows[:, 3]) > 1.0
    assert np.abs(rows[:, 3] - expected).max() <= increment
    assert not x.fault


def observer_gains(bandwidth):
    """By Ackermann: three poles at exp(-w T) of the error after the correction."""
    a = np.array([[1, PERIOD, PERIOD**2 / 2], [0, 1, PERIOD], [0, 0, 1]])
    c = np.array([[1.0, 0.0, 0.0]]) @ a  # of the prediction
    pole = math.exp(-2 * math.pi * bandwidth * PERIOD)
    wanted = np.linalg.matrix_power(a - pole * np.eye(3), 3)
    seen = np.vstack([c, c @ a, c @ a @ a])
    return (wanted @ np.linalg.solve(seen, [0.0, 0.0, 1.0])).ravel(), a


@pytest.mark.parametrize("encoder", [24, 48])
def test_a_coarse_encoder_with_an_observer_follows_it_within_one_increment(encoder):
    """Increments of 15 and 7.5 degrees; their differences are all or nothing."""
    bandwidth = 40.0
    gain, integral, kv = 0.02, 0.2, 20.0
    machine, x = turning(
        encoder, observer_bandwidth=bandwidth * 10, observer_inertia=INERTIA * 1e12,
        velocity_control_gain=gain * 1e6, velocity_control_time=gain / integral * 1e6,
        position_control_gain=kv * 1e3,
    )
    rows = wave(machine, x, amplitude=6.0)
    increment = 2 * math.pi / encoder
    loop, state = Loop(increment), np.zeros(3)
    correction, a = observer_gains(bandwidth)
    state[0] = loop.seen(rows[0, 3]) + increment / 2
    count = [0]

    def act(position, demand, velocity, acceleration):
        nonlocal state
        if count[0] % 2 == 0:
            loop.command = velocity + kv * (demand - loop.seen(position))  # once a position cycle
        count[0] += 1
        torque = np.array([PERIOD**2 / 2, PERIOD, 0.0]) * loop.torque / INERTIA
        state = a @ state + torque
        state = state + correction * (loop.seen(position) + increment / 2 - state[0])
        error = loop.command - state[1]
        loop.limited(gain * error + loop.integral + FFA * acceleration)
        loop.integral += PERIOD * integral * error

    expected = simulated(rows, loop, act)
    assert np.ptp(rows[:, 3]) > 8.0
    assert np.abs(rows[:, 3] - expected).max() <= increment
    assert abs(float(x.axis.velocity) - state[1]) < 2.0


def test_an_observer_knows_the_speed_that_differences_of_a_coarse_encoder_do_not():
    noise = []
    for objects in ({}, {"observer_bandwidth": 300, "observer_inertia": INERTIA * 1e12}):
        machine, x = turning(24, **objects)
        x.write("controlword", 0)
        machine.step(4)
        machine.data.qvel[0] = 300.0
        found = []
        for k in range(600):
            machine.step()
            if k > 200:
                found.append(float(x.axis.velocity) - machine.data.qvel[0])
        noise.append(float(np.std(found)))
    assert noise[1] < 0.05 * noise[0]
    assert noise[1] < 0.02 * 300.0


def torques(frequency, **objects):
    """Torque demand and torque command (Nm) of a sine in a torque mode."""
    machine = rotary_axis(mechanics="rotary_table", tuned=False)
    x = machine.drives["x"]
    x.commission({"torque_slope": 2**32 - 1, "max_motor_speed": 60_000} | objects)
    machine.reset()
    master = Master(MachinePort(machine), "x")
    master.set_mode(Mode.CYCLIC_SYNC_TORQUE)
    master.enable()
    rows = []
    for k in range(1000):
        x.write("target_torque", round(500 * math.sin(2 * math.pi * frequency * k * 500e-6)))
        machine.step()
        rows.append((x.axis.torque_demand, x.axis.torque_command))
    return np.array(rows).T


@pytest.mark.parametrize("frequency", [20.0, 80.0, 100.0, 300.0])
@pytest.mark.parametrize("kind", ["notch", "low-pass"])
def test_notch_and_low_pass_are_those_of_scipy(frequency, kind):
    w, damping, depth, time = 2 * np.pi * 100.0, 0.3, 0.1, 400e-6
    if kind == "notch":
        objects = {"notch_frequency_1": 1000, "notch_damping_1": 300, "notch_depth_1": 100}
        kept = 2 / PERIOD * math.tan(w * PERIOD / 2)  # so that the discrete one lies at w
        filter_ = signal.bilinear(
            [1, 2 * damping * depth * kept, kept**2], [1, 2 * damping * kept, kept**2], 1 / PERIOD
        )
    else:
        objects = {"torque_command_filter_time": time * 1e6}
        share = 1 - math.exp(-PERIOD / time)
        filter_ = [share], [1, share - 1]
    demand, command = torques(frequency, **objects)
    expected = signal.lfilter(*filter_, np.repeat(demand, 2))[1::2]  # held for two cycles
    assert np.ptp(demand) > 1.0
    assert command == pytest.approx(expected, abs=1e-9)


def test_a_velocity_feed_forward_filter_delays_the_command_by_its_time():
    machine = linear_axis()
    x = machine.drives["x"]
    x.commission({"feed_forward_filter_time": 5_000})
    machine.reset(positions={"x": 0.1})
    master = Master(MachinePort(machine), "x")
    master.set_mode(Mode.PROFILE_POSITION)
    master.enable()
    x.write("target_position", 300_000)
    x.write("controlword", 0x1F)
    machine.step(60)
    behind = float(x.axis.velocity_demand) - float(x.axis.feed_forward)
    gear = machine.joint("x")[0]
    assert behind == pytest.approx(10.0 * gear * 5e-3, rel=0.06)  # 10 m/s² for 5 ms


def test_why_says_what_stands_between_position_error_and_torque():
    machine, x = turning()
    assert x.why() == "no command has been refused", "a cascade is not news"
    machine, x = turning(
        **PID, notch_frequency_2=455, torque_command_filter_time=800, observer_bandwidth=300,
        observer_inertia=3e8, motor_resistance=2_000_000, motor_torque_constant=500_000,
    )
    for words in (
        "PID position controller gives the torque (P 6 Nm/rad, I 90 Nm/(rad·s), D 0.12 Nm·s/rad)",
        "notch filter at 45.5 Hz", "low-pass of 800 µs", "observer of 30 Hz for 0.0003 kg·m²",
        "325 V gives less torque the faster it turns, and none at 6207 1/min",
    ):
        assert words in x.why()
    x.inject("following_error")
    machine.step(20)
    assert "PID position controller" in remedy(x.axis)
    x.clear_injected()
