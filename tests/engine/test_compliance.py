"""The elastic payload against the closed form of a two-mass system."""

import math

import numpy as np
import pytest

from servogym.drive.master import Master
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort

K, PAYLOAD, CARRIAGE = 20_000.0, 5.0, 1.5


def axis(**more):
    return linear_axis(payload=PAYLOAD, stiffness=K, coulomb_friction=0, viscous_friction=0, **more)


def frequency(machine, cycles=4000):
    """Of the free vibration of the load after it was displaced by 1 mm (Hz)."""
    machine.data.qpos[1] = 1e-3
    vibration = []
    for _ in range(cycles):
        machine.step()
        vibration.append(machine.data.qpos[1])
    signal = np.array(vibration) - np.mean(vibration)
    rising = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    exact = rising - signal[rising] / (signal[rising + 1] - signal[rising])
    return 1 / (np.mean(np.diff(exact)) * machine.cycle_time)


def test_the_free_axis_vibrates_at_the_resonance():
    machine = axis()
    motor_side = CARRIAGE + machine.model.dof_armature[0]
    expected = math.sqrt(K * (1 / motor_side + 1 / PAYLOAD)) / (2 * math.pi)
    assert frequency(machine) == pytest.approx(expected, rel=0.01)


def test_with_the_motor_held_it_vibrates_at_the_antiresonance():
    machine = axis(brake_torque=100.0)
    expected = math.sqrt(K / PAYLOAD) / (2 * math.pi)
    assert frequency(machine) == pytest.approx(expected, rel=0.01)


def test_damping_makes_it_die_out_as_the_decrement_says():
    damping = 20.0
    machine = axis(brake_torque=100.0, structural_damping=damping)
    machine.data.qpos[1] = 1e-3
    machine.step(2000)
    envelope = 1e-3 * math.exp(-damping / (2 * PAYLOAD) * machine.time)
    rate = math.sqrt(K / PAYLOAD)
    amplitude = math.hypot(machine.data.qpos[1], machine.data.qvel[1] / rate)
    assert amplitude == pytest.approx(envelope, rel=0.05)


def test_a_move_with_jerk_shakes_the_load_less():
    swing = {}
    for profile in (0, 3):
        machine = linear_axis(payload=PAYLOAD, stiffness=K, max_jerk=200.0)
        machine.reset(positions={"x": 0.1})
        seen = []
        master = Master(
            MachinePort(machine, lambda seen=seen, m=machine: seen.append(m.data.qpos[1]))
        )
        master.enable()
        master.home(37)
        machine.drives["x"].write("motion_profile_type", profile)
        master.move_to(0.2)
        swing[profile] = np.abs(seen).max()
    static = PAYLOAD * 10.0 / K
    assert swing[0] > 1.4 * static, "a step of the acceleration overshoots"
    assert swing[3] < 0.9 * swing[0], swing
