"""The motor's winding on the DC link: the torque that the voltage allows at a speed.

The motor is modelled as its equivalent DC motor with -U..U of the DC link at its terminals:

    L di/dt + R i = u - Ke w,        torque = Kt i

so the torque is limited to Kt (±U - Ke w) / R, which it approaches with the electrical time
constant L / R. Above the no-load speed U / Ke both ends are braking torques: the motor feeds the
link through the diodes. The speed is the true one of the shaft, not that of the encoder.
"""

import math

from .jit import block
from .record import Axis


@block
def receive(axis: Axis):
    """Set the motor's data from the objects; return whether its voltage limits the torque."""
    od = axis.od
    constant, back = od.motor_torque_constant * 1e-6, od.motor_voltage_constant * 1e-6
    axis.torque_constant = constant
    axis.voltage_constant = back if back > 0.0 else constant
    on = od.motor_resistance > 0 and constant > 0.0
    axis.resistance = od.motor_resistance * 1e-6 if on else 0.0
    time = od.motor_inductance * 1e-9 / axis.resistance if on else 0.0
    axis.current_decay = math.exp(-axis.velocity_period / time) if time > 0.0 else 0.0
    if not on:
        axis.angle_known = 0
    return on


@block
def torque_range(axis: Axis):
    """Lowest and highest torque (Nm) that the current can reach in this velocity cycle."""
    speed = 0.0
    if axis.angle_known:
        speed = (axis.shaft_angle - axis.last_angle) / axis.velocity_period
    follow(axis)
    back = axis.voltage_constant * speed
    rest = axis.torque * axis.current_decay
    gain = (1.0 - axis.current_decay) * axis.torque_constant / axis.resistance
    return rest - gain * (axis.dc_link + back), rest + gain * (axis.dc_link - back)


@block
def follow(axis: Axis):
    """Remember the angle, for the speed."""
    axis.last_angle = axis.shaft_angle
    axis.angle_known = 1


@block
def loss(axis: Axis):
    """Power (W) that the current turns into heat in the winding."""
    if axis.resistance <= 0.0:
        return 0.0
    current = axis.torque / axis.torque_constant
    return axis.resistance * current * current
