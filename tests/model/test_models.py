"""Every drive model and every row of it, as a master meets them."""

import random
import re
import struct

import numpy as np
import pytest

from conftest import Shaft
from servogym.drive.drive import Drive
from servogym.drive.kernel.faults import Cause
from servogym.drive.kernel.process_data import INVALID
from servogym.drive.model.model import load, model_names
from servogym.drive.objects.abort import Abort
from servogym.drive.objects.mapping import all_objects

MODELS = model_names()
ACTING = {"save", "load", "set_position", "error_reaction", "undervoltage_error", "i2t_error"}


@pytest.fixture(params=MODELS)
def drive(request):
    drive = Drive(request.param)
    drive.cycle(0.0)
    return drive


def test_every_object_is_read_with_its_type_or_refused_as_write_only(drive):
    for (index, subindex), slot in drive.objects.slots.items():
        data, abort = drive.objects.read(index, subindex)
        if slot.row.access == "wo":
            assert abort is Abort.WRITE_ONLY
        elif slot.row.hook == "act_string":
            assert abort is Abort.INTERNAL_INCOMPATIBLE, "a string parameter"
        elif index == 0x1003 and subindex and not drive.model.quirk("empty_history_reads_0"):
            assert abort is Abort.NO_DATA
        else:
            assert abort is Abort.NONE
            assert len(data) == slot.row.size or not slot.row.format


def test_what_is_read_only_refuses_and_stays(drive):
    for (index, subindex), slot in drive.objects.slots.items():
        if slot.row.access in ("ro", "const") and slot.row.format:
            before = slot.get()
            assert drive.objects.write(index, subindex, bytes(slot.row.size)) is Abort.READ_ONLY
            assert slot.get() == before, slot.row.name


def test_what_may_be_written_takes_its_range_and_nothing_else(drive):
    for slot in drive.objects.slots.values():
        row = slot.row
        skipped = row.hook in ACTING or row.area != "axis"
        if row.access not in ("rw", "wo") or skipped:
            continue
        code = struct.Struct("<" + row.format)
        before = slot.get()
        for value in row.allowed or (row.minimum, row.maximum):
            abort = drive.objects.write(row.index, row.subindex, code.pack(int(value)))
            assert abort is Abort.NONE or slot.hook, (row.name, value, abort)
        for value, refusal in (
            (row.minimum - 1, Abort.VALUE_TOO_LOW),
            (row.maximum + 1, Abort.VALUE_TOO_HIGH),
        ):
            try:
                data = code.pack(int(value))
            except struct.error:
                continue  # no such value of this type
            assert drive.objects.write(row.index, row.subindex, data) is refusal, row.name
        too_long = bytes(row.size + 1)
        assert drive.objects.write(row.index, row.subindex, too_long) is Abort.LENGTH_TOO_HIGH
        slot.put(before)


def test_units_sections_and_names_are_there(drive):
    rows = all_objects(drive.model)
    assert len({row.name for row in rows}) == len(rows)
    inferred = [row for row in rows if not row.section and "inferred" not in row.note]
    assert not inferred
    for name, quirk in drive.model.quirks.items():
        assert quirk.source, name


@pytest.mark.parametrize("name", MODELS)
def test_every_pdo_starts_with_the_mapping_and_identifier_of_the_model(name):
    drive = Drive(name, node_id=9)
    for pdos, mappings in ((drive.rpdos, drive.model.rpdos), (drive.tpdos, drive.model.tpdos)):
        for pdo, mapping in zip(pdos, mappings, strict=True):
            base, _, node = mapping.cob_id.partition("+")
            assert pdo.cob_id == int(base, 0) + (9 if node else 0)
            if drive.model.bus == "can":
                assert pdo.valid == (not int(base, 0) & INVALID)
            assert pdo.transmission_type == mapping.transmission_type
            words = [i << 16 | s << 8 | bits for i, s, bits in mapping.entries]
            assert pdo.mapping[: pdo.count].tolist() == words


@pytest.mark.parametrize("name", MODELS)
def test_every_fault_the_manual_numbers_can_be_injected(name):
    drive = Drive(load(name))
    new = drive.snapshot()
    for fault in {f.name: f for f in reversed(drive.model.faults) if f.name}.values():
        drive.restore(new)
        drive.inject(fault.name)
        for _ in range(3):
            drive.cycle(0.0)
        state = drive.state.name
        if fault.reaction.name in ("IGNORE", "WARNING"):
            assert state != "FAULT", fault
            assert bool(drive.axis.od.statusword & 0x80) == (fault.reaction.name == "WARNING")
        else:
            assert state == "FAULT", fault
            assert drive.read("error_code") == fault.code
            assert f"{fault.code:04X}h" in drive.fault


@pytest.mark.parametrize("name", MODELS)
def test_causes_of_a_model_have_one_code_each(name):
    model = load(name)
    causes = [fault.cause for fault in model.faults if fault.cause]
    assert len(causes) == len(set(causes))
    assert Cause.ENCODER_LOSS in causes


@pytest.mark.parametrize("name", MODELS)
def test_a_snapshot_continues_bit_by_bit(name):
    shaft, other = Shaft(name), Drive(name)
    for word in (6, 7, 15):
        shaft.control(word)
    other.restore(shaft.drive.snapshot())
    for _ in range(20):
        assert other.cycle(0.1, 0.2) == shaft.drive.cycle(0.1, 0.2)
    assert other.snapshot() == shaft.drive.snapshot()
    assert np.isfinite(shaft.torque)


@pytest.mark.parametrize("name", MODELS)
def test_powering_off_and_on_quickly_is_powering_off_and_on(name):
    """`reset` copies a remembered record instead of filling it anew; nothing tells them apart."""
    chance = random.Random(3)
    one, other = Drive(name), Drive(name)
    other._powered_on = (0, b""), np.empty(0)  # forgets what it remembers
    writable = [slot for slot in one.objects.slots.values() if slot.row.access == "rw"]
    for slot in chance.sample(writable, len(writable) // 2):
        if slot.row.format in ("", "f") or slot.row.index in (0x1010, 0x1011):
            continue
        low, high = int(slot.row.minimum), int(slot.row.maximum)
        value = chance.choice((low, high, chance.randint(low, high)))
        for drive in (one, other):
            drive.objects.store(drive.objects.slots[slot.row.index, slot.row.subindex], value)
    for drive in (one, other):
        drive.inject(drive.injectable[-1])
        drive.cycle(0.1)
        drive.reset(keep_parameters=True)
    assert one.snapshot() == other.snapshot()


JUDGED = {"position_control_v_max", "limit_switch_deceleration"}  # printed in other units


@pytest.mark.parametrize("name", MODELS)
def test_a_printed_range_that_the_columns_leave_out_is_in_a_hook_or_beyond_the_type(name):
    for row in load(name).objects.values():
        found = re.findall(r"range (?:printed )?(-?\d+)\.\.(\d+)\b", row.note)
        for low, high in found if row.area == "axis" else ():  # PDOs: `mapping.RULES_OF_RANGES`
            whole = np.iinfo("<" + row.format)
            ends = max(int(low), whole.min), min(int(high), whole.max)
            if "of the type is used" in row.note and int(low) < whole.min:
                ends = whole.min, ends[1]
            assert row.hook in JUDGED or (row.minimum, row.maximum) == ends, row.name
