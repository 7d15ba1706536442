"""Device control: the CiA 402 state machine as a table, and the one writer of the state.

Source of every row: CiA 402-2 / IEC 61800-7-201, device control, transitions 0-16. A pair of state
and event that is not in TRANSITIONS is ignored: the state stays and the command is noted as
refused. Commands act by level in each cycle; only the fault reset needs a rising edge.
"""

from enum import IntEnum

import numpy as np

from . import brake, contacts, statusword, stop
from .cascade import energised, torque_allowed
from .faults import Cause, Reaction, show_register
from .jit import block, rare
from .record import Axis
from .stop import OPTION_STAYS, OPTION_STOP, Stop, option
from .words import COMMANDS, Command, Mode, State


class Event(IntEnum):
    """Commands of the master, and events inside the drive."""

    NONE = Command.NONE
    SHUTDOWN = Command.SHUTDOWN
    SWITCH_ON = Command.SWITCH_ON  # disable operation, where operation is enabled
    ENABLE_OPERATION = Command.ENABLE_OPERATION
    DISABLE_VOLTAGE = Command.DISABLE_VOLTAGE
    QUICK_STOP = Command.QUICK_STOP
    FAULT_RESET = Command.FAULT_RESET
    SELF_TEST_PASSED = 7
    FAULT = 8
    STOPPED = 9  # the ramp of a quick stop or of a fault reaction has ended


_S, _E = State, Event
# number, source, event, target. Transition 0 is power-on itself: reset makes NOT_READY.
TRANSITIONS = (
    (1, _S.NOT_READY_TO_SWITCH_ON, _E.SELF_TEST_PASSED, _S.SWITCH_ON_DISABLED),
    (2, _S.SWITCH_ON_DISABLED, _E.SHUTDOWN, _S.READY_TO_SWITCH_ON),
    (3, _S.READY_TO_SWITCH_ON, _E.SWITCH_ON, _S.SWITCHED_ON),
    (3, _S.READY_TO_SWITCH_ON, _E.ENABLE_OPERATION, _S.SWITCHED_ON),  # 4 follows next cycle
    (4, _S.SWITCHED_ON, _E.ENABLE_OPERATION, _S.OPERATION_ENABLED),
    (5, _S.OPERATION_ENABLED, _E.SWITCH_ON, _S.SWITCHED_ON),  # option code 605Ch
    (6, _S.SWITCHED_ON, _E.SHUTDOWN, _S.READY_TO_SWITCH_ON),
    (7, _S.READY_TO_SWITCH_ON, _E.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (7, _S.READY_TO_SWITCH_ON, _E.QUICK_STOP, _S.SWITCH_ON_DISABLED),
    (8, _S.OPERATION_ENABLED, _E.SHUTDOWN, _S.READY_TO_SWITCH_ON),  # option code 605Bh
    (9, _S.OPERATION_ENABLED, _E.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (10, _S.SWITCHED_ON, _E.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (10, _S.SWITCHED_ON, _E.QUICK_STOP, _S.SWITCH_ON_DISABLED),
    (11, _S.OPERATION_ENABLED, _E.QUICK_STOP, _S.QUICK_STOP_ACTIVE),  # option code 605Ah
    (12, _S.QUICK_STOP_ACTIVE, _E.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (12, _S.QUICK_STOP_ACTIVE, _E.STOPPED, _S.SWITCH_ON_DISABLED),  # codes 0-4 of 605Ah
    (13, _S.NOT_READY_TO_SWITCH_ON, _E.FAULT, _S.FAULT_REACTION_ACTIVE),
    (13, _S.SWITCH_ON_DISABLED, _E.FAULT, _S.FAULT_REACTION_ACTIVE),
    (13, _S.READY_TO_SWITCH_ON, _E.FAULT, _S.FAULT_REACTION_ACTIVE),
    (13, _S.SWITCHED_ON, _E.FAULT, _S.FAULT_REACTION_ACTIVE),
    (13, _S.OPERATION_ENABLED, _E.FAULT, _S.FAULT_REACTION_ACTIVE),
    (13, _S.QUICK_STOP_ACTIVE, _E.FAULT, _S.FAULT_REACTION_ACTIVE),
    (14, _S.FAULT_REACTION_ACTIVE, _E.STOPPED, _S.FAULT),
    (15, _S.FAULT, _E.FAULT_RESET, _S.SWITCH_ON_DISABLED),  # only if the cause is gone
    (16, _S.QUICK_STOP_ACTIVE, _E.ENABLE_OPERATION, _S.OPERATION_ENABLED),  # codes 5-8 of 605Ah
)

# Reaction to a fault -> option code of the stop, -1: the one in 605Eh.
REACTION_CODE = tuple(
    {Reaction.DISABLE: 0, Reaction.QUICK_STOP: 2, Reaction.CURRENT_LIMIT: 3}.get(reaction, -1)
    for reaction in Reaction
)

# Not refused although no row has them: the command that led to the state is still present.
STANDING = (
    (_S.READY_TO_SWITCH_ON, _E.SHUTDOWN),
    (_S.SWITCHED_ON, _E.SWITCH_ON),
    (_S.OPERATION_ENABLED, _E.ENABLE_OPERATION),
    (_S.QUICK_STOP_ACTIVE, _E.QUICK_STOP),
    (_S.SWITCH_ON_DISABLED, _E.DISABLE_VOLTAGE),
    (_S.SWITCH_ON_DISABLED, _E.QUICK_STOP),
)

NUMBER = np.full((len(State), len(Event)), -1, np.int64)  # [state, event] -> transition, -1 none
TARGET = np.zeros((len(State), len(Event)), np.int64)
for _number, _source, _event, _target in TRANSITIONS:
    NUMBER[_source, _event] = _number
    TARGET[_source, _event] = _target
for _source, _event in STANDING:
    NUMBER[_source, _event] = 0


@block
def run(axis: Axis):
    """Update the state from faults, the end of ramps and the controlword, in this order."""
    controlword = int(axis.od.controlword)
    reset = contacts.reset_bit(axis)
    reset_edge = reset and not axis.reset_bit
    axis.reset_bit = reset
    if axis.fault_raised != Cause.NONE:
        _take_fault(axis)
    elif axis.state == State.NOT_READY_TO_SWITCH_ON:
        _apply(axis, Event.SELF_TEST_PASSED)
    elif axis.pending_transition != 0 and stop.finished(axis) and _may_finish(axis):
        _finish(axis)
    if _reaction_cut_off(axis):
        _finish(axis)
    if axis.state == State.FAULT_REACTION_ACTIVE or axis.state == State.FAULT:
        if reset_edge:
            _reset_fault(axis)
        return
    asked = COMMANDS[controlword & 0x0F]
    if contacts.in_use(axis):
        running = axis.state == State.OPERATION_ENABLED or axis.state == State.QUICK_STOP_ACTIVE
        if running and contacts.blocked(axis):
            enabled = axis.state == State.OPERATION_ENABLED
            _apply(axis, Event.SWITCH_ON if enabled else Event.DISABLE_VOLTAGE)
            stop.begin(axis, Stop.NONE)
            return
        asked = contacts.command(axis, asked)
    permitted = _permitted(axis, asked)
    if permitted != asked:
        _refuse(axis, asked)
    _command(axis, permitted)


@block
def _permitted(axis: Axis, command):
    """The effective command: inputs and a lost connection override the controlword.

    Safe torque off acts as disable voltage, and the output stage obeys it in every state
    (`cascade.energised`); without the controller enable input the drive brakes
    as with quick stop and cannot be enabled (inferred); 6007h says what a lost connection does.
    """
    lost = int(axis.od.abort_connection_option_code) if axis.connection_lost else 0
    if contacts.alone(axis):
        lost = 0  # reactions 2 and 3 are of the state machine
    if not axis.sto_input:
        return Command.DISABLE_VOLTAGE
    if lost == 2 and not axis.connection_loss_runs_down:
        return Command.DISABLE_VOLTAGE
    if axis.remote_bit == 1 and axis.od.enable_logic != statusword.BUS_ENABLES:
        return Command.DISABLE_VOLTAGE
    if not axis.enable_input or lost == 3:
        if axis.torque_mode_coasts and axis.mode == Mode.PROFILE_TORQUE:
            return Command.DISABLE_VOLTAGE
        running = axis.state == State.OPERATION_ENABLED or axis.state == State.QUICK_STOP_ACTIVE
        return Command.QUICK_STOP if running else Command.DISABLE_VOLTAGE
    return Command.SWITCH_ON if lost == 2 else command


@block
def _reaction_cut_off(axis: Axis):
    """Whether a fault reaction can no longer brake: torque is off, or a torque mode coasts."""
    if axis.state != State.FAULT_REACTION_ACTIVE:
        return False
    coasts = axis.torque_mode_coasts and axis.mode == Mode.PROFILE_TORQUE
    return not torque_allowed(axis) or (coasts and not axis.enable_input)


@block
def _may_finish(axis: Axis):
    """Whether the power may go off after an orderly stop: the brake has to hold the axis."""
    return _quick_stop_stays(axis) or brake.gripped(axis)


@block
def _quick_stop_stays(axis: Axis):
    stays = OPTION_STAYS[option(axis.od.quick_stop_option_code)]
    return axis.pending_transition == 12 and stays and axis.enable_input


@block
def _apply(axis: Axis, event):
    """Take the row of (state, event); nothing else writes the state."""
    axis.transition = NUMBER[axis.state, event]
    axis.state = TARGET[axis.state, event]
    axis.pending_transition = 0
    axis.brake_gripping = 0


@block
def _refuse(axis: Axis, command):
    """Note the command that was refused last, and in which state."""
    axis.refused_command = command
    axis.refused_state = axis.state


@block
def _command(axis: Axis, command):
    number = NUMBER[axis.state, command]
    if number < 0:
        _refuse(axis, command)
    elif number == 0:  # standing; a shutdown or disable ramp that was under way is called off
        braking = axis.stop == Stop.CURRENT_LIMIT  # nothing calls that off
        if axis.state == State.OPERATION_ENABLED and axis.pending_transition != 0 and not braking:
            _resume(axis)
    elif number == 5:
        _ramp_then(axis, command, int(axis.od.disable_operation_option_code))
    elif number == 8:
        _ramp_then(axis, command, int(axis.od.shutdown_option_code))
    elif number == 11:
        _apply(axis, command)
        _stop_then(axis, 12, int(axis.od.quick_stop_option_code))
    elif number == 16:
        if OPTION_STAYS[option(axis.od.quick_stop_option_code)]:
            _apply(axis, command)
            _resume(axis)
        else:
            _refuse(axis, command)
    else:
        _apply(axis, command)
        if not energised(axis):
            stop.begin(axis, Stop.NONE)


@rare
def _ramp_then(axis: Axis, command, code):
    """Take transition 5 or 8 at once or after a ramp; -1 is the quick stop ramp of some models."""
    kind = Stop.QUICK_STOP_RAMP if code < 0 else OPTION_STOP[option(code)]
    if kind == Stop.NONE:
        _apply(axis, command)
        stop.begin(axis, Stop.NONE)
        return
    if axis.pending_transition == 0:
        stop.begin(axis, kind)
    axis.pending_transition = NUMBER[axis.state, command]


@rare
def _stop_then(axis: Axis, number, code):
    """Brake by option code, then transition `number`; at once where there is nothing to brake."""
    axis.pending_transition = number
    kind = OPTION_STOP[option(code)]
    stop.begin(axis, kind)
    if kind == Stop.NONE:
        _finish(axis)


@rare
def _finish(axis: Axis):
    """The ramp has ended: take the transition that waited for it."""
    number = axis.pending_transition
    if number == 5:
        _apply(axis, Event.SWITCH_ON)
    elif number == 8:
        _apply(axis, Event.SHUTDOWN)
    elif _quick_stop_stays(axis):
        return  # stays in QUICK_STOP_ACTIVE until transition 12 or 16 is commanded
    else:
        _apply(axis, Event.STOPPED)
    stop.begin(axis, Stop.NONE)


@rare
def _take_fault(axis: Axis):
    cause = axis.fault_raised
    axis.fault_raised = Cause.NONE
    if axis.state == State.FAULT_REACTION_ACTIVE:
        if axis.od.fault_reaction[cause] == Reaction.DISABLE:
            _stop_then(axis, 14, 0)
        return
    if axis.state == State.FAULT:
        return  # already stopped
    axis.fault = cause
    was_energised = energised(axis)
    _apply(axis, Event.FAULT)
    code = REACTION_CODE[min(int(axis.od.fault_reaction[cause]), len(REACTION_CODE) - 1)]
    if code < 0:
        code = int(axis.od.fault_reaction_option_code)
    if not was_energised:
        code = 0
    _stop_then(axis, 14, code)


@rare
def _reset_fault(axis: Axis):
    """Transition 15, refused while a cause that stops the drive is still present."""
    age = (axis.cycle_count - axis.fault_cycle) * axis.position_period * 1e3
    locked = age < axis.reset_lock
    if axis.state != State.FAULT or axis.faults_present & ~axis.warnings or locked:
        _refuse(axis, Command.FAULT_RESET)
        return
    _apply(axis, Event.FAULT_RESET)
    axis.fault = Cause.NONE
    axis.faults = 0  # all or none
    axis.following_error_exceeded = 0
    show_register(axis)


@rare
def _resume(axis: Axis):
    """Give the demand back to the mode of operation."""
    axis.pending_transition = 0
    axis.brake_gripping = 0
    stop.begin(axis, Stop.NONE)
    axis.mode_started = 0
