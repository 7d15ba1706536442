"""Modes of operation: the selection of the active one, and its calls.

Each mode is a file with three functions on the record: `start` continues from the present demand,
`demand` computes the demand of one position cycle, and `status` sets the statusword bits of the
mode, which are 0 before. Modes with negative numbers come with a drive model, see `own`.
"""

from collections.abc import Callable

from .. import brake, homing, stop
from ..cascade import energised
from ..faults import Cause, raise_fault
from ..homing import HomingError
from ..jit import block, block_of_lines
from ..ramps import rest
from ..stop import Stop
from ..words import Controlword, Latched, Mode, State
from . import csp, cst, csv, hm, ip, own, pp, pv, tq, vl

MODES = {  # the most used ones first
    Mode.PROFILE_POSITION: pp,
    Mode.PROFILE_VELOCITY: pv,
    Mode.HOMING: hm,
    Mode.CYCLIC_SYNC_POSITION: csp,
    Mode.CYCLIC_SYNC_VELOCITY: csv,
    Mode.CYCLIC_SYNC_TORQUE: cst,
    Mode.PROFILE_TORQUE: tq,
    Mode.INTERPOLATED_POSITION: ip,
    Mode.VELOCITY: vl,
}
LOWEST_MODE, HIGHEST_MODE = own.NUMBERS[0], int(max(Mode))


def _of_active_mode(function: str) -> Callable:
    """A block that calls `start`, `demand` or `status` of the active mode."""
    lines: list[str] = []
    for mode, file in MODES.items():
        lines.append(f"{'elif' if lines else 'if'} axis.mode == {int(mode)}:")
        lines.append(f"    {file.__name__.rpartition('.')[2]}.{function}(axis)")
    lines += ["elif axis.mode < 0:", f"    own.call(axis, own.Step.{function.upper()})"]
    return block_of_lines(f"_{function}", "axis", lines, globals())


_start, _demand, _status = map(_of_active_mode, ("start", "demand", "status"))


@block
def demand(axis):
    """Select the mode, handle halt and stops, and let the mode compute its demand."""
    controlword = int(axis.od.controlword)
    _select(axis)
    bit4 = 1 if controlword & Controlword.NEW_SET_POINT else 0
    if not energised(axis):
        if bit4 and not axis.bit4 and axis.mode == Mode.HOMING:
            raise_fault(axis, Cause.HOMING_START)
        rest(axis)
        homing.abandon(axis, HomingError.INTERRUPTED)
        pp.forget(axis)
        if axis.mode < 0 and axis.mode_started:
            own.call(axis, own.Step.LEAVE)
        axis.mode_started = 0
        axis.synchronised = 0
        axis.halted = 0
    else:
        _halt(axis, controlword)
        if axis.state != State.OPERATION_ENABLED:
            pp.forget(axis)
        elif axis.mode == Mode.PROFILE_POSITION:
            pp.handshake(axis, controlword, bit4)
        if axis.mode == Mode.INTERPOLATED_POSITION:
            ip.receive(axis)
        if axis.stop != Stop.NONE:
            homing.abandon(axis, HomingError.INTERRUPTED)
            stop.demand(axis)
        elif not brake.waits(axis):
            _demand_of_mode(axis)
        elif axis.mode == Mode.HOMING:
            bit4 = 0  # the rising edge counts once the brake is released
    axis.bit4 = bit4
    if axis.sync == Latched.CYCLIC:
        axis.synchronised = axis.mode_started
        axis.silence = 0
    axis.sync = Latched.NOT
    axis.last_target_position = axis.target_position + axis.position_offset
    axis.last_ip_data = axis.ip_data


@block
def _select(axis):
    """Change to the mode in 6060h if it is supported."""
    requested = int(axis.od.modes_of_operation)
    if requested in (0, axis.mode) or not LOWEST_MODE <= requested <= HIGHEST_MODE:
        return
    bit = requested - 1 if requested > 0 else 15 - requested  # `words.mode_bit`
    if axis.supported_modes >> bit & 1:
        if axis.mode < 0:
            own.call(axis, own.Step.LEAVE)
        axis.mode = requested
        axis.mode_started = 0
        axis.od.velocity_ramps_enable = 1  # with each choice of a mode (Metronix 8.1.2.3, 8.6)
        homing.abandon(axis, HomingError.INTERRUPTED)
        pp.forget(axis)


@block
def _halt(axis, controlword):
    """Obey controlword bit 8 (halt option code 605Dh) unless device control stops the axis."""
    halt = 1 if controlword & Controlword.HALT else 0
    if axis.state == State.OPERATION_ENABLED and axis.pending_transition == 0:
        by_slope = axis.halt_ends_job and axis.mode == Mode.PROFILE_TORQUE
        if halt and axis.stop == Stop.NONE and not by_slope:
            stop.begin(axis, stop.OPTION_STOP[stop.option(axis.od.halt_option_code)])
            if axis.halt_ends_job:
                pp.forget(axis)
                homing.abandon(axis, HomingError.HALTED)
        elif not halt and axis.halted:
            stop.begin(axis, Stop.NONE)
            axis.mode_started = 0
        axis.halted = halt


@block
def _demand_of_mode(axis):
    if not axis.mode_started:
        axis.mode_started = 1
        _start(axis)
    if axis.mode == Mode.NONE:
        axis.velocity_demand = 0.0  # hold
    _demand(axis)


@block
def status(axis):
    """Statusword bits 10, 12 and 13 of the active mode.

    In QUICK_STOP_ACTIVE bit 10 says in every mode that the stop is over (CiA 402-2, statusword).
    """
    axis.mode_bit10 = axis.mode_bit12 = axis.mode_bit13 = 0
    _status(axis)
    if axis.state == State.QUICK_STOP_ACTIVE:
        axis.mode_bit10 = axis.standstill
