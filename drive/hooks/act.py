"""Parameters of a frequency inverter (Bonfiglioli ACT): data sets, RAM and EEPROM, two channels.

Source: CANopen manual of the ACT, 8.5-8.7 and chapter 9. Parameter n is the object 2000h + n, its
sub-index the data set: 1-4 in the EEPROM and 6-9 the same in the RAM, 0 and 5 all four of them.
Writing the EEPROM writes the RAM too. What the control cycle needs of the active data set is copied
into the record after each write (`apply`).
"""

from typing import TYPE_CHECKING

from ..abort import Abort
from ..faults import Cause
from . import act_channel
from .act_channel import FIRST, RAM, SETS
from .hook import Hook

if TYPE_CHECKING:
    from ..drive import Drive
    from ..objects import ObjectDictionary
    from ..rows import Object

ACTIVE, SELECTION, POLE_PAIRS = 249, 414, 373
F_MIN, F_MAX, UP, DOWN = 418, 419, (420, 422), (421, 423)
# parameter -> field of the record, factor to its unit
FIELDS = {
    392: ("transition_5", 1),
    412: ("local_remote", 1),
    434: ("ramp_setpoint", 1),
    480: ("internal_frequency", 10),  # 0.01 Hz -> mHz
    632: ("braking_time", 100),  # 0.1 s -> ms (inferred)
    638: ("stop_holding_time", 100),  # 0.1 s -> ms
}


def active_set(od: "ObjectDictionary") -> int:
    """The data set in force: parameter 414, or what the contacts choose: the first (inferred)."""
    chosen = int(od.slots[FIRST + SELECTION, 0].get())
    return chosen if chosen in SETS else 1


def parameter(od: "ObjectDictionary", number: int, data_set: int | None = None) -> int:
    """RAM value of a parameter in a data set, the active one if not given."""
    index = FIRST + number
    chosen = data_set or active_set(od)
    place = (index, RAM + chosen) if (index, RAM + chosen) in od.slots else (index, 0)
    return int(od.slots[place].get())


def apply(drive: "Drive") -> None:
    """Copy what the control cycle needs of the active data set into the record."""
    od, record = drive.objects, drive.axis.od
    for number, (field, factor) in FIELDS.items():
        setattr(record, field, parameter(od, number) * factor)
    pairs = max(parameter(od, POLE_PAIRS, 1), 1)  # always of data set 1
    record.pole_pairs = pairs
    per_minute = 0.6 / pairs  # 1/min a 0.01 Hz
    top = parameter(od, F_MAX)
    record.stop_threshold = parameter(od, 637) * top // 100  # 0.1 % of 0.01 Hz -> mHz
    record.control_deviation = parameter(od, 549) * top // 1000  # 0.01 % (inferred: of fmax)
    record.vl_velocity_min_max_amount[0] = round(parameter(od, F_MIN) * per_minute)
    record.vl_velocity_min_max_amount[1] = round(top * per_minute)
    for number, field in (
        (UP[0], "vl_acceleration"), (DOWN[0], "vl_deceleration"), (424, "vl_quick_stop")
    ):  # fmt: skip
        slope = max(round(parameter(od, number) * per_minute), 1)
        setattr(record, f"{field}_delta_speed", slope)
        setattr(record, f"{field}_delta_time", 1)
    drive.axis.parameters_changed = 1


def power_on(drive: "Drive") -> None:
    """The RAM begins as a copy of the EEPROM."""
    for (index, subindex), slot in drive.objects.slots.items():
        if slot.row.hook == "data_set" and subindex in SETS:
            drive.objects.slots[index, subindex + RAM].put(slot.get())  # type: ignore[arg-type]
    apply(drive)


def _data_set(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """8.6.3, 8.7: data set 0 can be written only while all four are the same."""
    index, data_set = row.index, row.subindex
    targets = {0: (*SETS, *(RAM + n for n in SETS)), RAM: tuple(RAM + n for n in SETS)}
    if data_set in targets:
        if not _same(od, index, data_set):
            return Abort.INTERNAL_INCOMPATIBLE
        places = targets[data_set]
    else:
        places = (data_set, data_set + RAM) if data_set in SETS else (data_set,)
    for place in places:
        od.slots[index, place].put(value)
    if data_set < RAM:
        od.drive.parameters.save()  # each write of the EEPROM is stored at once (8.6.3)
    apply(od.drive)
    return Abort.STORED


def _same(od: "ObjectDictionary", index: int, data_set: int) -> bool:
    base = RAM if data_set == RAM else 0
    return len({od.slots[index, base + n].get() for n in SETS}) == 1


def _data_set_now(od: "ObjectDictionary", row: "Object") -> int | Abort:
    if row.subindex not in (0, RAM):
        return int(od.slots[row.index, row.subindex].get())
    if not _same(od, row.index, row.subindex):
        return Abort.INTERNAL_INCOMPATIBLE
    return int(od.slots[row.index, row.subindex + 1].get())


def _single(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    od.slots[row.index, row.subindex].put(value)
    od.drive.parameters.save()
    apply(od.drive)
    return Abort.STORED


def _set_frequency(od: "ObjectDictionary", number: int, value: int, low: int = 0) -> Abort:
    """Write a parameter of data set 1, EEPROM and RAM, as far as its range allows."""
    row = od.slots[FIRST + number, 1].row
    value = round(min(max(value, row.minimum, low), row.maximum))
    for place in (1, 1 + RAM):
        od.slots[FIRST + number, place].put(value)
    return Abort.NONE


def _slope(parameters: tuple[int, ...], other: int):
    """6048h, 6049h: delta speed over delta time becomes a slope in Hz/s of data set 1."""

    def write(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
        parts = {row.subindex: value, other - row.subindex: 0}
        partner = other - row.subindex
        parts[partner] = int(od.slots[row.index, partner].get())
        pairs = max(parameter(od, POLE_PAIRS, 1), 1)
        slope = parts[1] / max(parts[2], 1) * pairs / 60 * 100
        od.slots[row.index, row.subindex].put(value)
        for number in parameters:
            _set_frequency(od, number, round(slope), 1)
        apply(od.drive)
        return Abort.STORED

    return write


def _amount(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """6046h: the least and the greatest speed become frequencies of data set 1."""
    pairs = max(parameter(od, POLE_PAIRS, 1), 1)
    number = F_MIN if row.subindex == 1 else F_MAX
    _set_frequency(od, number, round(value * pairs / 60 * 100))
    od.slots[row.index, row.subindex].put(value)
    apply(od.drive)
    return Abort.STORED


def _amount_now(od: "ObjectDictionary", row: "Object") -> int:
    pairs = max(parameter(od, POLE_PAIRS, 1), 1)
    number = F_MIN if row.subindex == 1 else F_MAX
    return round(parameter(od, number, 1) / 100 * 60 / pairs)


def _poles(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """604Dh: twice the pole pairs 373 of data set 1."""
    if value % 2:
        return Abort.INVALID_VALUE
    for place in (1, 1 + RAM):
        od.slots[FIRST + POLE_PAIRS, place].put(value // 2)
    apply(od.drive)
    return Abort.STORED


def _poles_now(od: "ObjectDictionary", row: "Object") -> int:
    return 2 * parameter(od, POLE_PAIRS, 1)


def _only_velocity_mode(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """8.4.1: another mode than 2 is ignored."""
    return Abort.NONE if value == 2 else Abort.STORED


def _actual(od: "ObjectDictionary", row: "Object") -> int:
    """Read-outs 228, 249, 250, 260, 270, 282, 283 (10.1)."""
    axis = od.drive.axis
    hertz = 100 * int(axis.od.pole_pairs) / 60  # 0.01 Hz a 1/min
    bus = round(int(axis.od.vl_target_velocity) * hertz)
    internal = int(axis.od.internal_frequency) // 10
    fault = int(axis.fault)
    values = {
        228: internal,
        249: active_set(od),
        250: int(axis.contacts),
        260: od.drive.model.fault_key(int(axis.fault_code[fault]), fault) if fault else 0,
        270: _warnings(axis),
        282: bus,
        283: round(int(axis.od.vl_velocity_demand) * hertz),
    }
    return values[row.index - FIRST]


def _warnings(axis) -> int:
    """Parameter 270 (11.1): Ixt, heat sink and motor temperature are what the emulator has."""
    bits = {Cause.I2T: 0x01, Cause.DRIVE_TEMPERATURE: 0x08, Cause.MOTOR_TEMPERATURE: 0x80}
    return sum(bit for cause, bit in bits.items() if int(axis.warnings) >> cause & 1)


def _string(od: "ObjectDictionary", row: "Object") -> Abort:
    """A string parameter cannot be read through 2nnnh (8.7)."""
    return Abort.INTERNAL_INCOMPATIBLE


HOOKS = {
    "data_set": Hook(_data_set, _data_set_now, power_on=power_on),
    "single_set": Hook(_single),
    "act_slope_up": Hook(_slope(UP, 3)),
    "act_slope_down": Hook(_slope(DOWN, 3)),
    "act_amount": Hook(_amount, _amount_now),
    "act_poles": Hook(_poles, _poles_now),
    "act_mode": Hook(_only_velocity_mode),
    "act_value": Hook(read=_actual),
    "act_string": Hook(read=_string),
    "act_channel": Hook(raw=act_channel.channel),
}
