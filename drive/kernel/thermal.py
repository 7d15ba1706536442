"""Thermal models: I²t of the motor with derating, and the motor temperature.

I²t (after Festo CMMP-AS, chapter 5.5): the motor bears its peak torque for `i2t_time`; then the
torque is limited to the rated one until the integral has fallen. The limit sinks over the last
tenth of the integral, so it does not chatter. Temperature: one thermal mass, heated by the copper
loss, which grows with the square of the torque.
"""

from .faults import Cause, raise_fault
from .jit import block
from .record import Axis
from .words import Limit

DERATING_FROM = 0.9  # of the integral (inferred)


@block
def run(axis: Axis):
    """One position cycle of both models."""
    load = axis.torque * axis.torque
    rated = axis.rated_torque * axis.rated_torque
    _i2t(axis, load, rated)
    _temperature(axis, load / rated)


@block
def _i2t(axis: Axis, load, rated):
    od = axis.od
    peak = max(axis.torque_limit_positive, axis.torque_limit_negative)
    axis.torque_ceiling = peak
    capacity = (peak * peak - rated) * od.i2t_time * 1e-3
    if capacity <= 0.0:
        axis.heat = 0.0
        return
    axis.heat = min(max(axis.heat + (load - rated) * axis.position_period, 0.0), capacity)
    level = axis.heat / capacity
    if level > DERATING_FROM:
        share = (1.0 - level) / (1.0 - DERATING_FROM)
        axis.torque_ceiling = axis.rated_torque + (peak - axis.rated_torque) * share
        axis.limits |= Limit.I2T
        raise_fault(axis, Cause.I2T)
    od.i2t_level = int(level * 1000.0)


@block
def _temperature(axis: Axis, load):
    od = axis.od
    if od.motor_thermal_resistance > 0 and od.motor_thermal_time > 0:
        final = od.motor_winding_loss * 1e-3 * load * od.motor_thermal_resistance * 1e-3
        share = axis.position_period / od.motor_thermal_time
        axis.motor_heating += (final - axis.motor_heating) * share
    temperature = axis.ambient_temperature + axis.motor_heating
    shown = temperature / axis.temperature_unit
    od.motor_temperature = int(min(max(shown, -32768.0), 32767.0))
    if 0 < od.motor_temperature_limit < od.motor_temperature:
        raise_fault(axis, Cause.MOTOR_TEMPERATURE)
