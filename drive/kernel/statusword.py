"""The statusword 6041h, composed of state, inputs, warnings, limits and the bits of the mode.

Quirks of the models change bits of the standard: `AXIS.fault_shows_reaction` and the fields after
it. Bit 7 of 6510h:F0h (`words.Compatibility`) cancels two of the quirks.
"""

from . import contacts
from .encoder import Switch
from .faults import Cause
from .jit import block
from .record import Axis
from .words import STATE_PATTERN, Compatibility, Limit, ManufacturerStatus, State, Statusword

VALUE = tuple(STATE_PATTERN[state][1] for state in State)
THREE_STATES = tuple(  # shown by a drive that contacts start
    STATE_PATTERN[
        State.FAULT if state >= State.FAULT_REACTION_ACTIVE else max(state, State.SWITCHED_ON)
    ][1]
    for state in State
)
FAULT_REACTION = STATE_PATTERN[State.FAULT_REACTION_ACTIVE][1]
POWERED = tuple(  # the transistors are switched on
    State.SWITCHED_ON <= state <= State.FAULT_REACTION_ACTIVE for state in State
)
HEAT = 1 << Cause.I2T | 1 << Cause.MOTOR_TEMPERATURE | 1 << Cause.DRIVE_TEMPERATURE
DIN8, DIN9 = 1 << 28, 1 << 29  # of 60FDh (Metronix 6.13.2.2, Festo CMMP-AS 5.13)
BUS_ENABLES = 2  # value of enable_logic


@block
def compose(axis: Axis):
    """The word of this position cycle."""
    od = axis.od
    standard = od.compatibility_control & Compatibility.DEVICE_CONTROL
    word = VALUE[axis.state]
    if contacts.alone(axis):
        word = THREE_STATES[axis.state]
    if axis.state == State.FAULT and axis.fault_shows_reaction and not standard:
        word = FAULT_REACTION
    if _voltage_enabled(axis, standard):
        word |= Statusword.VOLTAGE_ENABLED
    if axis.warnings != 0 or (axis.switch_types and axis.blocked):
        word |= Statusword.WARNING
    if axis.moving_bit and not axis.standstill:
        word |= Statusword.MANUFACTURER_8
    remote = axis.remote_bit == 0 or od.enable_logic == BUS_ENABLES
    if contacts.remote(axis) if contacts.in_use(axis) else remote:
        word |= Statusword.REMOTE
    if axis.limits & (Limit.I2T if axis.limit_bit_is_i2t else 0xFFFF):
        word |= Statusword.INTERNAL_LIMIT_ACTIVE
    if axis.mode_bit10:
        word |= Statusword.TARGET_REACHED
    if axis.mode_bit12:
        word |= Statusword.MODE_12
    if axis.mode_bit13:
        word |= Statusword.MODE_13
    if axis.manufacturer_bit:
        od.manufacturer_status = manufacturer_status(axis)
        shown = int(od.manufacturer_status) ^ int(od.manufacturer_status_invert)
        if shown & int(od.manufacturer_status_mask):
            word |= Statusword.MANUFACTURER_14
    sampled = od.sample_status & od.sample_status_mask
    hot = axis.warnings & HEAT
    if (
        (axis.top_bit == 1 and axis.homed)
        or (axis.top_bit == 2 and sampled)
        or (axis.top_bit == 3 and hot)
    ):
        word |= Statusword.MANUFACTURER_15
    return word


@block
def _voltage_enabled(axis: Axis, standard):
    if axis.voltage_bit == 3:
        return False
    if axis.voltage_bit == 0:
        return axis.sto_input and axis.dc_link * 1e3 >= axis.od.undervoltage
    on = POWERED[axis.state]
    return on if standard or axis.voltage_bit == 1 else not on


@block
def manufacturer_status(axis: Axis):
    """2000h:01 of Festo CMMP-AS (6.1.5) and Metronix ARS 2000 (7.1.5.2)."""
    word: int = ManufacturerStatus.COMMUTATION_VALID
    if axis.homed:
        word |= ManufacturerStatus.IS_REFERENCED
    if axis.faults_present & ~axis.warnings == 0 and axis.state < State.FAULT_REACTION_ACTIVE:
        word |= ManufacturerStatus.READY_FOR_ENABLE
    return word


@block
def digital_inputs(axis: Axis):
    """60FDh: the switches, the interlock while an enable input is missing, further inputs.

    In models with `switch_types` the home switch is an input, DIN9 or DIN8 (Metronix 6.14).
    """
    missing = not (axis.enable_input and axis.sto_input)
    further = int(axis.inputs) & 0xFFFF0000
    if axis.switch_types and axis.home_switch:
        further |= DIN8 if axis.od.homing_switch_selector else DIN9
    return (
        axis.switches & (Switch.NEGATIVE_LIMIT | Switch.POSITIVE_LIMIT | Switch.HOME)
        | (8 if missing else 0)
        | further
    )
