"""SDO access: every row of the dictionary, exact abort codes, and nothing changed by a refusal."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import Shaft
from servogym.drive.drive import Drive
from servogym.drive.kernel.faults import Cause
from servogym.drive.kernel.record import OBJECTS
from servogym.drive.model.model import load, model_names
from servogym.drive.objects.abort import TEXT, Abort, SdoAbort
from servogym.drive.objects.hooks import act
from servogym.drive.objects.mapping import pdo_objects

GENERIC = load("generic")
ROWS = [*GENERIC.objects.values(), *pdo_objects(4, 4)]


def abort_of(drive, *arguments):
    before = drive.snapshot()
    with pytest.raises(SdoAbort) as error:
        drive.write(*arguments)
    assert drive.snapshot() == before
    return error.value.code


@pytest.fixture
def drive():
    return Drive()


def named(row):
    return f"{row.index:04X}h:{row.subindex:02X}h {row.name}"


def test_every_row_reads_its_default_with_its_length():
    objects, wrong = Drive().objects, {}
    for row in ROWS:
        data, abort = objects.read(row.index, row.subindex)
        if row.index == 0x1003 and row.subindex:
            right = abort == Abort.NO_DATA  # CiA 301: the history is empty
        elif not row.format:
            right = abort == Abort.NONE and data.decode() == row.default
        else:
            right = abort == Abort.NONE and len(data) == row.size
            if right and row.area in ("axis", "constant"):
                node_id = 1 if row.per_node else 0
                right = struct.unpack("<" + row.format, data)[0] == row.default + node_id
        if not right:
            wrong[named(row)] = data, abort
    assert not wrong


def refusals(row, good):
    """What a row refuses to be written, with the abort code of each."""
    if row.access in ("ro", "const"):
        return [(good, Abort.READ_ONLY)]
    wrong = [(good + b"\0", Abort.LENGTH_TOO_HIGH), (good[:-1], Abort.LENGTH_TOO_LOW)]
    low, high = (np.iinfo("<" + row.format).min, np.iinfo("<" + row.format).max)
    if row.maximum < high:
        wrong += [(struct.pack("<" + row.format, int(row.maximum) + 1), Abort.VALUE_TOO_HIGH)]
    if row.minimum > low:
        wrong += [(struct.pack("<" + row.format, int(row.minimum) - 1), Abort.VALUE_TOO_LOW)]
    return wrong


def test_every_row_keeps_its_access_length_and_range():
    drive, wrong = Drive(), {}
    before = drive.snapshot()
    for row in ROWS:
        good = drive.objects.read(row.index, row.subindex)[0]
        for data, code in refusals(row, good):
            abort = drive.objects.write(row.index, row.subindex, data)
            if abort != code or drive.snapshot() != before:
                wrong[named(row)] = data, code, abort
    assert not wrong


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ((0x6041, 0, 1), 0x06010002),
        ((0x7000, 0, 1), 0x06020000),
        ((0x607D, 9, 1), 0x06090011),
        ((0x605A, 0, 9), 0x06090031),
        ((0x605A, 0, -1), 0x06090032),
        ((0x6060, 0, 5), 0x06090030),
        ((0x6060, 0, -1), 0x06090030),
        ((0x6086, 0, 2), 0x06090030),
        ((0x6098, 0, 15), 0x06090030),
        ((0x607A, 0, 2**31), 0x06090031),
        ((0x1003, 0, 5), 0x06090030),
        ((0x1010, 1, 1), 0x08000020),
        ((0x1011, 1, 0x65766173), 0x08000020),
        ((0x1400, 1, 0x181), 0x08000022),
        ((0x1400, 2, 245), 0x06090030),
        ((0x1400, 2, 252), 0x06090030),
        ((0x1600, 0, 0), 0x06010000),
        ((0x1600, 1, 0x60410010), 0x06010000),
        ((0x1601, 1, 0x60410010), 0x06040041),
        ((0x1601, 0, 17), 0x06040042),
        ((0x1800, 3, 5), 0x08000022),
    ],
)
def test_exact_abort_codes(drive, arguments, code):
    assert abort_of(drive, *arguments) == code


def test_factors_change_only_while_the_drive_is_disabled():
    shaft = Shaft().enable()
    assert abort_of(shaft.drive, "feed", 5) == Abort.DEVICE_STATE
    shaft.control(0)
    shaft.write(feed=5)


def test_errors_say_the_next_step(drive):
    with pytest.raises(SdoAbort, match=r"0\.\.8"):
        drive.write("quick_stop_option_code", 9)
    with pytest.raises(SdoAbort, match="no object is called 'targetposition'"):
        drive.write("targetposition", 9)
    for value in ("x", None, float("nan"), float("inf"), 1.5):
        with pytest.raises(TypeError, match="target_position"):
            drive.write("target_position", value)
    assert all(abort in TEXT for abort in Abort if abort > 1)


# of the active data set of an inverter: `hooks.act.apply`
PARAMETERS = [field for field, _ in act.TIMES.values()]
PARAMETERS += [field for fields, _ in act.CHOICES.values() for field in fields]
PARAMETERS += ["vl_internal_velocity", "stop_velocity", "vl_window", "vl_velocity_min_max_amount"]
PARAMETERS += ["vl_anticlockwise"]
PARAMETERS += ["homing_speed_own"]  # of models with a homing.csv: tests/model/test_own_homing.py


def test_every_field_of_the_record_is_an_object_of_some_model():
    models = [load(name) for name in model_names()]
    rows = [row for model in models for row in model.objects.values()]
    offsets = {row.offset for row in rows if row.area == "axis"}
    from servogym.drive.kernel.record import OD

    for name, *_ in OBJECTS:
        kind, offset = OD.fields[name][:2]
        if name not in ("vendor", "reaction_code", *PARAMETERS):
            places = range(kind.shape[0]) if kind.shape else [0]
            if name == "fault_reaction":
                places = [cause for cause in Cause if 0 < cause <= Cause.RPDO_TIMEOUT]
            assert {offset + i * kind.base.itemsize for i in places} <= offsets, name


def test_history_is_newest_first_and_cleared_by_zero():
    shaft = Shaft()
    for cause in ("external", "overvoltage"):
        shaft.drive.inject(cause)
        shaft.step(2)
        shaft.drive.clear_injected()
        shaft.step(2)
        shaft.control(0)
        shaft.control(0x80)
    assert shaft.read("number_of_errors") == 2
    assert shaft.read("standard_error_field_1") == 0x3210
    assert shaft.read("standard_error_field_2") == 0x9000
    shaft.write(number_of_errors=0)
    with pytest.raises(SdoAbort, match="08000024h"):
        shaft.read("standard_error_field_1")


@given(st.data())
def test_any_bytes_to_any_object_are_accepted_or_aborted_and_then_nothing_changes(data):
    drive = Drive()
    row = data.draw(st.sampled_from(ROWS))
    payload = data.draw(st.binary(max_size=9))
    subindex = data.draw(st.just(row.subindex) | st.integers(0, 255))
    before = drive.snapshot()
    abort = drive.objects.write(row.index, subindex, payload)
    if abort:
        assert drive.snapshot() == before
    else:
        drive.cycle(0.0)
        assert drive.state.name in ("SWITCH_ON_DISABLED", "FAULT")
