"""Parameters of a frequency inverter (Bonfiglioli ACT): data sets, RAM and EEPROM, two channels.

Source: CANopen manual of the ACT, 8.5-8.7 and chapter 9. Parameter n is the object 2000h + n, its
sub-index the data set: 1-4 in the EEPROM and 6-9 the same in the RAM, 0 and 5 all four of them; of
a parameter that exists once 0 is in the EEPROM and 5 in the RAM. Writing the EEPROM writes the RAM
too, and is stored at once (`writes_are_stored`). What the control cycle needs of the active set
is copied into the record after each write (`apply`).
"""

from collections.abc import Mapping

from ...kernel.contacts import Source
from ...kernel.faults import Cause
from ...kernel.words import SetPointSource
from ...model.rows import Object
from ..abort import Abort
from ..device import Device, Dictionary
from . import act_channel
from .act_channel import FIRST, RAM, SETS
from .hook import Hook

SELECTION, POLE_PAIRS = 414, 373
F_MIN, F_MAX, UP, DOWN = 418, 419, (420, 422), (421, 423)  # slopes: clockwise, anticlockwise
QUICK_STOP = (424, 425)
CONNECTION = 388  # and 6007h
SOURCE, INTERNAL, LINE = 412, 480, 282
NO_NODE_ID = 255  # of CiA 305
SOURCES = dict.fromkeys(range(45), Source.NOTHING) | {  # the factory's 44 too (9)
    0: Source.CONTACTS, 1: Source.CONTROLWORD_AND_CONTACTS, 2: Source.REMOTE_CONTACTS
}
# parameter -> fields of the record, value there by value of the parameter
CHOICES: dict[int, tuple[tuple[str, ...], Mapping[int, int]]] = {
    392: (  # transition 5: coast, DC brake, ramp, as option codes of 605Bh and 605Ch
        ("shutdown_option_code", "disable_operation_option_code"),
        {0: 0, 1: 3, 2: 1},
    ),
    SOURCE: (("command_source",), SOURCES),
    434: (
        ("vl_setpoint_source",),
        {1: SetPointSource.INTERNAL, 2: SetPointSource.BUS, 3: SetPointSource.SUM},
    ),
}
SINGLE = ("single_set", "act_node_id")  # hooks of parameters that exist once
# parameter -> field of the record, factor to its unit
TIMES = {632: ("dc_brake_time", 100), 638: ("stop_hold_time", 100)}  # 0.1 s -> ms (632 inferred)


def active_set(od: Dictionary) -> int:
    """The data set in force: parameter 414, or what the contacts choose: the first (inferred)."""
    chosen = int(od.slots[FIRST + SELECTION, RAM].get())
    return chosen if chosen in SETS else 1


def parameter(od: Dictionary, number: int, data_set: int | None = None) -> int:
    """RAM value of a parameter in a data set, the active one if not given."""
    index = FIRST + number
    chosen = data_set or active_set(od)
    place = (index, RAM + chosen) if (index, RAM + chosen) in od.slots else (index, RAM)
    return int(od.slots[place].get())


def apply(drive: Device) -> None:
    """Copy what the control cycle needs of the active data set into the record."""
    od, record = drive.objects, drive.axis.od
    for number, (fields, choice) in CHOICES.items():
        for field in fields:
            setattr(record, field, choice[parameter(od, number)])
    for number, (field, factor) in TIMES.items():
        setattr(record, field, parameter(od, number) * factor)
    pairs = max(parameter(od, POLE_PAIRS, 1), 1)  # always of data set 1
    per_minute = 0.6 / pairs  # 1/min a 0.01 Hz
    top = parameter(od, F_MAX)
    per_millihertz = 60 / pairs  # 1/1000 1/min
    record.vl_internal_velocity = round(parameter(od, INTERNAL) * 10 * per_millihertz)
    record.stop_velocity = round(parameter(od, 637) * top // 100 * per_millihertz)  # 0.1 %
    # 0.01 % (inferred: of the maximum frequency)
    record.vl_window = round(parameter(od, 549) * top // 1000 * per_millihertz)
    record.vl_velocity_min_max_amount[0] = round(parameter(od, F_MIN) * per_minute)
    record.vl_velocity_min_max_amount[1] = round(top * per_minute)
    for n, (numbers, field) in enumerate(
        ((UP, "vl_acceleration"), (DOWN, "vl_deceleration"), (QUICK_STOP, "vl_quick_stop"))
    ):
        clockwise, other = (parameter(od, number) for number in numbers)
        setattr(record, f"{field}_delta_speed", max(round(clockwise * per_minute), 1))
        setattr(record, f"{field}_delta_time", 1)
        # below 0: as clockwise (inferred)
        record.vl_anticlockwise[n] = max(round(other * per_minute * 1000), 0)
    drive.axis.parameters_changed = 1


def power_on(drive: Device) -> None:
    """The RAM begins as a copy of the EEPROM; 6048h and 6049h show the slopes there (8.5.6)."""
    od = drive.objects
    for (index, subindex), slot in od.slots.items():
        kept = slot.row.hook in SINGLE and subindex == 0
        if kept or (slot.row.hook == "data_set" and subindex in SETS):
            od.slots[index, subindex + RAM].put(slot.get())  # type: ignore[arg-type]
    for index, (clockwise, _) in ((0x6048, UP), (0x6049, DOWN)):
        pairs = max(parameter(od, POLE_PAIRS, 1), 1)
        od.slots[index, 1].put(max(round(parameter(od, clockwise, 1) * 0.6 / pairs), 1))
        od.slots[index, 2].put(1)
    apply(drive)


def _data_set(od: Dictionary, row: Object, value: int) -> Abort:
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
    apply(od.drive)
    return Abort.STORED


def _same(od: Dictionary, index: int, data_set: int) -> bool:
    base = RAM if data_set == RAM else 0
    return len({od.slots[index, base + n].get() for n in SETS}) == 1


def _data_set_now(od: Dictionary, row: Object) -> int | Abort:
    if row.subindex not in (0, RAM):
        return int(od.slots[row.index, row.subindex].get())
    if not _same(od, row.index, row.subindex):
        return Abort.INTERNAL_INCOMPATIBLE
    return int(od.slots[row.index, row.subindex + 1].get())


def _single(od: Dictionary, row: Object, value: int) -> Abort:
    for place in (0, RAM) if row.subindex == 0 else (RAM,):
        od.slots[row.index, place].put(value)
    apply(od.drive)
    return Abort.STORED


def _node_id(od: Dictionary, row: Object, value: int) -> Abort:
    """387: the inverter resets itself and adopts the address, 0 ends its communication (6).

    Data set 5 is but the copy in the RAM (inferred).
    """
    _single(od, row, value)
    if row.subindex == 0:
        drive = od.drive
        node_id = value or NO_NODE_ID
        bit_rate = drive.parameters.lss[1] if drive.parameters.lss else None
        if not (drive.parameters.save() and drive.parameters.keep_lss(node_id, bit_rate)):
            return Abort.HARDWARE
        drive.reset()
        drive.wanted_node_id = node_id
    return Abort.STORED


def _connection(od: Dictionary, row: Object, value: int) -> Abort:
    """6007h is the parameter 388 (8.3.1)."""
    for place in (0, RAM):
        od.slots[FIRST + CONNECTION, place].put(value)
    return Abort.STORED


def _set_frequency(
    od: Dictionary, number: int, value: int, low: int = 0, places: tuple[int, ...] = (1, 1 + RAM)
) -> Abort:
    """Write a parameter of data set 1, EEPROM and RAM, as far as its range allows."""
    row = od.slots[FIRST + number, 1].row
    value = round(min(max(value, row.minimum, low), row.maximum))
    for place in places:
        od.slots[FIRST + number, place].put(value)
    return Abort.NONE


def _slope(parameters: tuple[int, ...], other: int):
    """6048h, 6049h: delta speed over delta time becomes a slope in Hz/s of data set 1."""

    def write(od: Dictionary, row: Object, value: int) -> Abort:
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


def _amount(od: Dictionary, row: Object, value: int) -> Abort:
    """6046h: the least and the greatest speed become frequencies of data set 1.

    The least one is not saved and 0 after a reset (8.5.5): it goes to the RAM only.
    """
    pairs = max(parameter(od, POLE_PAIRS, 1), 1)
    number, places = (F_MIN, (1 + RAM,)) if row.subindex == 1 else (F_MAX, (1, 1 + RAM))
    _set_frequency(od, number, round(value * pairs / 60 * 100), places=places)
    od.slots[row.index, row.subindex].put(value)
    apply(od.drive)
    return Abort.STORED


def _amount_now(od: Dictionary, row: Object) -> int:
    if row.subindex == 1:
        return int(od.slots[row.index, 1].get())
    pairs = max(parameter(od, POLE_PAIRS, 1), 1)
    return round(parameter(od, F_MAX, 1) / 100 * 60 / pairs)


def _poles(od: Dictionary, row: Object, value: int) -> Abort:
    """604Dh: twice the pole pairs 373 of data set 1."""
    if value % 2:
        return Abort.INVALID_VALUE
    for place in (1, 1 + RAM):
        od.slots[FIRST + POLE_PAIRS, place].put(value // 2)
    apply(od.drive)
    return Abort.STORED


def _poles_now(od: Dictionary, row: Object) -> int:
    return 2 * parameter(od, POLE_PAIRS, 1)


def _only_velocity_mode(od: Dictionary, row: Object, value: int) -> Abort:
    """8.4.1: another mode than 2 is ignored."""
    return Abort.NONE if value == 2 else Abort.STORED


def _actual(od: Dictionary, row: Object) -> int:
    """Read-outs 228, 249, 250, 260, 270, 282, 283 (10.1)."""
    axis = od.drive.axis
    hertz = 100 * max(parameter(od, POLE_PAIRS, 1), 1) / 60  # 0.01 Hz a 1/min
    bus = round(int(axis.od.vl_target_velocity) * hertz)
    internal = parameter(od, INTERNAL)
    fault = int(axis.fault)
    values = {
        228: internal,
        249: active_set(od),
        250: int(axis.contacts),
        260: od.drive.model.fault_key(int(axis.fault_code[fault]), fault, int(axis.lost_node))
        if fault
        else 0,
        270: _warnings(axis),
        LINE: bus,
        283: internal + bus,  # whatever 434 chooses (9.4, 10.1)
    }
    return values[row.index - FIRST]


def _warnings(axis) -> int:
    """Parameter 270 (11.1): Ixt, heat sink and motor temperature are what the emulator has."""
    bits = {Cause.I2T: 0x01, Cause.DRIVE_TEMPERATURE: 0x08, Cause.MOTOR_TEMPERATURE: 0x80}
    return sum(bit for cause, bit in bits.items() if int(axis.warnings) >> cause & 1)


def _string(od: Dictionary, row: Object) -> Abort:
    """A string parameter cannot be read through 2nnnh (8.7)."""
    return Abort.INTERNAL_INCOMPATIBLE


HOOKS = {
    "data_set": Hook(_data_set, _data_set_now, power_on=power_on),
    "single_set": Hook(_single),
    "act_node_id": Hook(_node_id),
    "act_connection": Hook(_connection),
    "act_slope_up": Hook(_slope(UP, 3)),
    "act_slope_down": Hook(_slope(DOWN, 3)),
    "act_amount": Hook(_amount, _amount_now),
    "act_poles": Hook(_poles, _poles_now),
    "act_mode": Hook(_only_velocity_mode),
    "act_value": Hook(read=_actual),
    "act_string": Hook(read=_string),
    "act_channel": Hook(raw=act_channel.channel),
}
