"""Causes of faults, and how a cause becomes a fault, a warning or nothing.

The kernel names a *cause*; its emergency error code, error register bits and reaction are data of
the drive model (``faults.csv``), held in the record. Error codes: CiA 402-2, error codes 603Fh;
error register and history: CiA 301, objects 1001h and 1003h.
"""

from enum import IntEnum

from .jit import block, rare
from .record import FAULT_CAUSES, HISTORY, Axis

WARNING_ACTIVE = 0x8000  # bit of the last warning code


class Cause(IntEnum):
    """Causes of faults; rows of a model's faults.csv refer to these names."""

    NONE = 0
    ENCODER_LOSS = 1  # the feedback is lost or not finite
    FOLLOWING_ERROR = 2
    OVERSPEED = 3
    I2T = 4  # the motor has borne its peak torque for too long
    MOTOR_TEMPERATURE = 5
    OVERVOLTAGE = 6  # DC link
    UNDERVOLTAGE = 7  # DC link
    SET_POINT_LOSS = 8  # cyclic set-points are missing
    CONNECTION = 9  # the bus is gone and 6007h asks for a fault
    SHORT_CIRCUIT = 10
    DRIVE_TEMPERATURE = 11
    EXTERNAL = 12
    RPDO_TIMEOUT = 13  # an RPDO's event timer has run out
    POSITION_ERROR = 14  # the switch-off limit of the following error
    HOMING_INTERRUPTED = 15
    HOMING_SWITCH = 16
    HOMING_INDEX = 17
    HOMING_TIMEOUT = 18
    NEGATIVE_BLOCKED = 19  # a limit switch blocks negative set-points
    POSITIVE_BLOCKED = 20
    SYNC_LOST = 21
    GUARDING = 22  # the master's node guarding is missing
    RPDO_TOO_SHORT = 23
    SOFTWARE_LIMIT_MIN = 24  # a software position limit stops the motion
    SOFTWARE_LIMIT_MAX = 25
    INDEX_NEAR = 26  # homing: the index pulse lies at the edge
    HOMING_START = 27  # homing is started without power
    NO_SYNC = 28  # interpolated position is asked for, and SYNC does not come in its grid
    FOLLOW_UP_MISSING = 29  # a target was passed at its end velocity, and no other one is there
    TARGET_BEHIND_MIN = 30  # a target behind a software limit: the positioning does not start
    TARGET_BEHIND_MAX = 31


class Reaction(IntEnum):
    """Reaction of a drive to a cause."""

    IGNORE = 0
    WARNING = 1  # statusword bit 7, operation goes on
    OPTION_CODE = 2  # fault reaction option code 605Eh
    DISABLE = 3  # power stage off at once
    QUICK_STOP = 4  # as quick stop option code 2, independent of 605Eh
    CURRENT_LIMIT = 5  # as quick stop option code 3


@rare
def raise_fault(axis: Axis, cause):
    """Report that `cause` is present in this cycle.

    The faults of a drive are a set: each cause is entered and reported once, until all are reset
    (Metronix ARS 2000 5.5.1, Festo CMMP-AS 3.5.1). The first decides how the drive stops, unless
    a further one takes the power away at once (inferred).
    """
    reaction = int(axis.od.fault_reaction[cause])
    if reaction == Reaction.IGNORE:
        return
    axis.faults_present |= 1 << cause
    if reaction == Reaction.WARNING:
        if not axis.warnings & (1 << cause):
            axis.warnings |= 1 << cause
            axis.od.last_warning_code = axis.fault_number[cause] | WARNING_ACTIVE
            record(axis, cause)
        return
    if axis.faults & (1 << cause):
        return
    axis.faults |= 1 << cause
    axis.fault_cycle = axis.cycle_count
    record(axis, cause)
    if axis.fault_raised == Cause.NONE or reaction == Reaction.DISABLE:
        axis.fault_raised = cause


@rare
def record(axis: Axis, cause):
    """Enter `cause` in 603Fh, 1001h and, newest first, in the history 1003h.

    Reports on the bus do not depend on the history, which a master may clear.
    """
    od = axis.od
    axis.event_code[axis.error_events % HISTORY] = axis.fault_code[cause]
    axis.event_cause[axis.error_events % HISTORY] = cause
    axis.error_events += 1
    od.error_code = axis.fault_code[cause]
    od.error_register |= axis.fault_register[cause]
    for i in range(HISTORY - 1, 0, -1):
        od.error_field[i] = od.error_field[i - 1]
    od.error_field[0] = od.error_code
    depth = int(axis.history_depth) if axis.history_depth else HISTORY
    od.error_count = min(int(od.error_count) + 1, depth)


@block
def expire_warnings(axis: Axis):
    """Clear the warnings whose cause was not reported again in the last position cycle."""
    left = axis.warnings & axis.faults_present
    if left != axis.warnings:
        axis.warnings = left
        show_register(axis)
    if left == 0:
        axis.od.last_warning_code &= WARNING_ACTIVE - 1


@rare
def show_register(axis: Axis):
    """1001h: the bits of the faults that are not reset and of the warnings that are left."""
    register = 0
    for cause in range(1, FAULT_CAUSES):
        if (axis.faults | axis.warnings) >> cause & 1:
            register |= axis.fault_register[cause]
    axis.od.error_register = register
