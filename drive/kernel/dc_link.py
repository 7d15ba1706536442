"""The DC link: a capacitor behind a rectifier and a brake chopper, discharged by the motor.

The work of the torque on the shaft, by the encoder, is taken from the link; braking feeds it back,
the voltage rises, the brake chopper turns the surplus into heat, and above the limit the drive
faults (CiA 402-2 error codes 3210h, 3220h). Where the winding's resistance is known its heat is
taken too; losses of the power stage are neglected (inferred). Behind a resistance the supply sags
under load, to U = supply - R P / U with the time constant R C.
"""

import math

from . import winding
from .faults import Cause, raise_fault
from .jit import block
from .record import Axis


@block
def run(axis: Axis):
    """One position cycle: energy balance of the capacitor (J)."""
    od = axis.od
    work = axis.shaft_work + winding.loss(axis) * axis.position_period
    axis.shaft_work = 0.0
    supply = od.supply_voltage * 1e-3
    capacitance = od.link_capacitance * 1e-6
    resistance = od.supply_resistance * 1e-6
    sagged = supply
    if resistance > 0.0 and work > 0.0:
        current = work / axis.position_period / max(axis.dc_link, 1.0)
        final = supply - resistance * current
        time = resistance * capacitance
        left = math.exp(-axis.position_period / time) if time > 0.0 else 0.0
        sagged = max(final + (min(axis.dc_link, supply) - final) * left, 0.0)
    if capacitance <= 0.0:
        axis.dc_link = sagged
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
        axis.dc_link = max(math.sqrt(max(2.0 * energy / capacitance, 0.0)), sagged)
    millivolt = min(axis.dc_link * 1e3, 4294967295.0)
    od.dc_link_circuit_voltage = int(millivolt)
    od.chopper_energy = int(min(axis.link_energy * 1e3, 4294967295.0))
    if 0 < od.overvoltage < millivolt:
        raise_fault(axis, Cause.OVERVOLTAGE)
    if millivolt < od.undervoltage:
        raise_fault(axis, Cause.UNDERVOLTAGE)
