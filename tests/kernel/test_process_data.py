"""PDO mapping at run time, and images as bytes."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servogym.drive.drive import Drive
from servogym.drive.objects.abort import Abort, SdoAbort


@pytest.fixture
def drive():
    return Drive()


def refused(drive, *arguments):
    with pytest.raises(SdoAbort) as error:
        drive.write(*arguments)
    return error.value.code


def test_default_mapping_is_controlword_and_statusword(drive):
    assert (drive.rpdo_size, drive.tpdo_size) == (2, 2)
    drive.cycle(0.0)
    assert drive.exchange(b"\x06\x00") == b"\x50\x02"
    drive.cycle(0.0)
    assert drive.collect() == b"\x31\x02"


def test_the_procedure_of_the_standard(drive):
    drive.write(0x1400, 1, 0x80000201)
    drive.write(0x1600, 0, 0)
    drive.write(0x1600, 1, 0x60400010)
    drive.write(0x1600, 2, 0x60FF0020)
    drive.write(0x1600, 0, 2)
    assert drive.rpdo_size == 0, "not valid yet"
    drive.write(0x1400, 1, 0x201)
    assert drive.rpdo_size == 6
    drive.latch(struct.pack("<Hi", 6, -5))
    assert drive.read("target_velocity") == -5


def test_each_refusal_has_its_abort_code(drive):
    drive.write(0x1400, 1, 0x80000201)
    assert refused(drive, 0x1600, 1, 0x607A0020) == Abort.UNSUPPORTED_ACCESS, "count is not 0"
    drive.write(0x1600, 0, 0)
    assert refused(drive, 0x1600, 1, 0x70000020) == Abort.NO_OBJECT
    assert refused(drive, 0x1600, 1, 0x607D0920) == Abort.NO_SUBINDEX
    assert refused(drive, 0x1600, 1, 0x60410010) == Abort.NOT_MAPPABLE, "statusword into an RPDO"
    assert refused(drive, 0x1600, 1, 0x607A0010) == Abort.NOT_MAPPABLE, "wrong number of bits"
    for n in range(3):
        drive.write(0x1600, n + 1, 0x607A0020)
    assert refused(drive, 0x1600, 0, 3) == Abort.PDO_LENGTH
    drive.write(0x1600, 0, 2)


def test_dummy_entries_take_their_bytes_and_go_nowhere(drive):
    drive.write(0x1400, 1, 0x80000201)
    drive.write(0x1600, 0, 0)
    drive.write(0x1600, 1, 0x00060010)
    drive.write(0x1600, 2, 0x60400010)
    drive.write(0x1600, 0, 2)
    drive.write(0x1400, 1, 0x201)
    before = drive.snapshot()
    drive.latch(b"\xff\xff\x00\x00")
    drive.axis.sync = drive.axis.sync_pulse = 0
    assert drive.snapshot() == before


def test_map_pdos_by_name_and_pack_and_unpack(drive):
    drive.map_pdos(
        [["controlword", "modes_of_operation", "target_position"], ["target_velocity"]],
        [["statusword", "position_actual_value"]],
    )
    image = drive.pack(controlword=6, target_position=-2, target_velocity=7)
    assert image == struct.pack("<Hbii", 6, 0, -2, 7)
    drive.cycle(0.0)
    assert drive.unpack(drive.exchange(image)) == {
        "statusword": 0x250, "position_actual_value": 0,
    }
    assert drive.read("target_position") == -2
    with pytest.raises(ValueError, match="velocity_offset: not mapped"):
        drive.pack(velocity_offset=1)
    with pytest.raises(ValueError, match="controlword = 70000"):
        drive.pack(controlword=70000)
    with pytest.raises(ValueError, match="11 bytes, 3 were given"):
        drive.latch(b"abc")
    with pytest.raises(ValueError, match="5 PDOs are wanted"):
        drive.map_pdos([["controlword"]] * 5)


@given(st.binary(min_size=11, max_size=11))
def test_an_image_is_the_bytes_of_the_objects(image):
    drive = Drive()
    drive.map_pdos(
        [["controlword", "modes_of_operation", "target_position"], ["target_velocity"]], []
    )
    drive.latch(image)
    word, mode, position, velocity = struct.unpack("<Hbii", image)
    assert drive.read("controlword") == word
    assert drive.read("modes_of_operation") == mode
    assert drive.read("target_position") == position
    assert drive.read("target_velocity") == velocity
    drive.cycle(0.0)


def test_the_reserved_identifiers_cannot_be_given_to_a_pdo(drive):
    drive.write(0x1400, 1, 0x80000201)
    for cob_id in (0x000, 0x080, 0x101, 0x581, 0x601, 0x701, 0x7FF):
        assert refused(drive, 0x1400, 1, cob_id) == Abort.INVALID_VALUE
    assert refused(drive, 0x1400, 1, 0x20000201) == Abort.INVALID_VALUE
    drive.write(0x1400, 1, 0x333)
