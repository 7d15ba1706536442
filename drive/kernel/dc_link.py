"""The DC link: a capacitor behind a rectifier, drained and charged by the motor, with a chopper.

The work of the torque on the shaft, by the encoder, is taken from the link; braking feeds it back,
the voltage rises, the brake chopper turns the surplus into heat, and above the limit the drive
faults (CiA 402-2 error codes 3210h, 3220h). Losses in motor and power stage are neglected
(inferred).
"""

import math

from .faults import Cause, raise_fault
from .jit import block
from .record import Axis


@block
def run(axis: Axis):
    """One position cycle: energy balance of the capacitor (J)."""
    od = axis.od
    work = axis.shaft_work
    axis.shaft_work = 0.0
    supply = od.supply_voltage * 1e-3
    capacitance = od.link_capacitance * 1e-6
    if capacitance <= 0.0:
        axis.dc_link = supply
    else:
        energy = 0.5 * capacitance * axis.dc_link * axis.dc_link
        energy -= work
        threshold = od.chopper_voltage * 1e-3
        if od.chopper_resistance > 0 and axis.dc_link > threshold:
            heat = axis.dc_link * axis.dc_link / (od.chopper_resistance * 1e-3)
            surplus = energy - 0.5 * capacitance * threshold * threshold
            heat = min(heat * axis.position_period, max(surplus, 0.0))
            energy -= heat
            axis.link_energy += heat
        axis.dc_link = max(math.sqrt(max(2.0 * energy / capacitance, 0.0)), supply)
    millivolt = min(axis.dc_link * 1e3, 4294967295.0)
    od.dc_link_circuit_voltage = int(millivolt)
    od.chopper_energy = int(min(axis.link_energy * 1e3, 4294967295.0))
    if 0 < od.overvoltage < millivolt:
        raise_fault(axis, Cause.OVERVOLTAGE)
    if millivolt < od.undervoltage:
        raise_fault(axis, Cause.UNDERVOLTAGE)
