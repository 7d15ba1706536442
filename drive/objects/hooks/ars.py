"""Hooks of the ARS family (Metronix ARS 2000, Festo CMMP-AS, CMMS, CMMD).

Fault management 2100h and the objects that are views on it (CMMP-AS 5.4, 5.5, 5.7, 5.18), limits
of the factor group (5.3), compatibility bits (5.2), the lock on 60C1h (7.4.2), set position (5.7),
ranges printed in 1/min (5.7, 5.14), the period 60C2h (7.4.2), digital outputs 60FEh (5.13), analog
inputs 2400h (5.12), ramps by direction 2090h (7.6).
"""

from ...kernel.factors.units import FRACTION_LIMIT, reduced
from ...kernel.homing import Progress
from ...kernel.words import Compatibility
from ...model.rows import Object
from ..abort import Abort
from ..device import Dictionary
from ..reactions import REACTIONS, of, reaction_code, set_reaction
from .hook import Hook

LARGEST_FACTOR = 1 << 24
RUNNING = (Progress.SEARCHING, Progress.STOPPING, Progress.TO_ZERO)
UNDERVOLTAGE, FOLLOWING_ERROR, I2T = 2, 17, 31  # main fault numbers


def _error_reaction(od: Dictionary, row: Object, value: int) -> Abort:
    if value not in REACTIONS:
        return Abort.INVALID_VALUE
    set_reaction(od.drive, of(od.drive, int(od.names["error_number"].get())), value)
    return Abort.STORED


def _error_reaction_now(od: Dictionary, row: Object) -> int:
    return _code(od, int(od.names["error_number"].get()))


def _code(od: Dictionary, main: int) -> int:
    """Reaction code of sub-number 0 of a main fault number."""
    return next((reaction_code(od.drive, fault) for fault in of(od.drive, main)), 0)


def _switch(main: int) -> Hook:
    """0 makes fault `main` a warning, 1 lets it take the controller enable away."""

    def write(od: Dictionary, row: Object, value: int) -> Abort:
        set_reaction(od.drive, of(od.drive, main, 0), 5 if value else 3)
        return Abort.STORED

    def read(od: Dictionary, row: Object) -> int:
        return int(_code(od, main) >= 5)

    return Hook(write, read)


def _position_error_limit(od: Dictionary, row: Object, value: int) -> Abort:
    set_reaction(od.drive, of(od.drive, FOLLOWING_ERROR, 0), 8 if value else 0)
    return Abort.NONE


def _position_error_limit_now(od: Dictionary, row: Object) -> int:
    if _code(od, FOLLOWING_ERROR) != 8:
        return 0
    return int(od.drive.axis.od.position_error_limit)


def _older_factor(od: Dictionary, row: Object, value: int) -> Abort:
    """6093h, 6094h: numerator / divisor is at most 2^24, and has to stay computable."""
    if value == 0:
        return Abort.VALUE_TOO_LOW
    parts = [int(od.slots[row.index, subindex].get()) for subindex in (1, 2)]
    parts[row.subindex - 1] = value
    numerator, divisor = parts
    bounded = row.index != 0x6097 and row.hook != "older_factor_unbounded"
    if bounded and numerator > LARGEST_FACTOR * divisor:
        return Abort.INTERNAL_INCOMPATIBLE
    if row.index == 0x6093 and max(_position_fraction(od, *parts)) > FRACTION_LIMIT:
        return Abort.INTERNAL_INCOMPATIBLE
    return Abort.NONE


def _position_fraction(od: Dictionary, numerator: int, divisor: int) -> tuple[int, int]:
    increments, turns = (int(v) for v in od.drive.axis.od.position_encoder_resolution)
    a, b = reduced(65536 * turns, increments)
    a, c = reduced(a, numerator)
    d, b = reduced(divisor, b)
    d, c = reduced(d, c)
    return a * d, b * c


def _compatibility(od: Dictionary, row: Object, value: int) -> Abort:
    """Bits 0 and 2 mirror each other: setting one sets the other."""
    scheme = Compatibility.HOMING_METHOD_SCHEME
    od.drive.axis.od.compatibility_control = value | scheme if value & scheme else value
    return Abort.STORED


def _ip_data(od: Dictionary, row: Object, value: int) -> Abort:
    """60C1h is locked until 60C4h:06 gives access."""
    return Abort.NONE if od.drive.axis.od.interpolation_buffer_clear else Abort.DEVICE_STATE


def _set_position(od: Dictionary, row: Object, value: int) -> Abort:
    od.drive.axis.set_position_wanted = 1
    return Abort.NONE


def _multiple_of_4(od: Dictionary, row: Object, value: int) -> Abort:
    """201Ah:01: increments are four times a number of lines (5.10)."""
    return Abort.NONE if value % 4 == 0 else Abort.INVALID_VALUE


def _at_most(limit: int, factor: str, per_minute: int) -> Hook:
    """A range printed in 1/min (or 1/min per second), of a value in units of `factor`."""

    def write(od: Dictionary, row: Object, value: int) -> Abort:
        numerator, divisor = (int(v) for v in od.drive.axis.od[factor])
        too_high = value * numerator > limit * per_minute * divisor
        return Abort.VALUE_TOO_HIGH if too_high else Abort.NONE

    return Hook(write)


# 60C2h:02 -> values of 60C2h:01: 1..10 ms, or 10, 20 .. 100 times 0.1 ms
PERIODS = {-3: range(1, 11), -4: range(10, 101, 10)}


def _ip_time_units(od: Dictionary, row: Object, value: int) -> Abort:
    index = int(od.drive.axis.od.interpolation_time_index)
    return Abort.NONE if value in PERIODS[index] else Abort.INVALID_VALUE


def _outputs_now(od: Dictionary, row: Object) -> int:
    """60FEh:01 shows what the outputs really are: the brake, and the functions of 2420h."""
    return int(od.drive.axis.outputs)


def _profile_ramp(od: Dictionary, row: Object, value: int) -> Abort:
    """6083h and 6084h go to both directions of 2090h too (Metronix 8.6, Festo 7.6)."""
    first = row.index - 0x6083
    for subindex in (2 + first, 4 + first):
        od.put(od.slots[0x2090, subindex], min(value, 0x7FFFFFFF))
    od.drive.axis.ramps_seen[first] = 0.0  # which stands for: already there
    return Abort.NONE


def _analog_voltage(od: Dictionary, row: Object) -> int:
    """2400h: the voltage (mV) without its offset 2401h."""
    axis, n = od.drive.axis, row.subindex - 1
    volts = float(axis.analog_inputs[n])
    millivolts = round(volts * 1e3) - int(axis.od.analog_input_offset[n])
    return min(max(millivolts, -0x8000), 0x7FFF)


HOOKS = {
    "multiple_of_4": Hook(_multiple_of_4, judges=True),
    "position_control_v_max": _at_most(131_072, "velocity_encoder_factor", 4096),
    "limit_switch_deceleration": _at_most(3_000_000, "acceleration_factor", 256),
    "ip_time_units": Hook(_ip_time_units),
    "outputs": Hook(read=_outputs_now),
    "profile_ramp": Hook(_profile_ramp),
    "analog_voltage": Hook(read=_analog_voltage),
    "error_reaction": Hook(_error_reaction, _error_reaction_now),
    "undervoltage_error": _switch(UNDERVOLTAGE),
    "i2t_error": _switch(I2T),
    "position_error_limit": Hook(_position_error_limit, _position_error_limit_now),
    "older_factor": Hook(_older_factor, judges=True),
    "older_factor_unbounded": Hook(_older_factor, judges=True),
    "compatibility": Hook(_compatibility),
    "ip_data": Hook(_ip_data),
    "set_position": Hook(_set_position),
}
