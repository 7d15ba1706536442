"""Where mapped objects lie, and numbers of a drive that is not of the model given."""

import pytest

from servogym.drive.model.model import load
from servogym.drive.model.pdo import mapping_entry, places


def test_objects_lie_behind_one_another_and_what_is_unknown_takes_its_room():
    """CiA 301, 7.5.2.36: index, sub-index and length of an entry; 0005h is a dummy of 8 bits."""
    words = (0x6040_0010, 0x0005_0008, 0x2FFF_0120, 0x607A_0020)
    found, size = places(load("generic").objects, map(mapping_entry, words))
    assert found == {"controlword": 0, "target_position": 7}
    assert size == 11


@pytest.mark.parametrize("word", [0x6040_0020, 0x607A_0010, 0x607A_0008])
def test_a_mapping_of_another_length_has_no_place(word):
    assert places(load("generic").objects, [mapping_entry(word)])[0] == {}


def test_a_mapping_off_the_bytes_has_no_place():
    assert places(load("generic").objects, [(1, 0, 1), (0x6040, 0, 16)]) == ({}, 3)


def test_a_number_with_too_few_bytes_is_refused_by_name():
    row = load("generic").number("target_position")
    with pytest.raises(ValueError, match="target_position came with 2 bytes, an INTEGER32 has 4"):
        row.unpack(b"\1\0")
    assert row.unpack(b"\xff\xff\xff\xff") == -1


@pytest.mark.parametrize(
    ("name", "value", "fits"),
    [("controlword", 65535, True), ("controlword", 65536, False), ("controlword", -1, False),
     ("controlword", 1.5, False), ("controlword", "15", False), ("target_position", 2**31, False)],
)
def test_a_number_that_its_type_does_not_hold_is_refused(name, value, fits):
    row = load("generic").number(name)
    if fits:
        assert row.unpack(row.pack(value)) == value
    else:
        with pytest.raises(ValueError, match=f"{name} = .* is not of type {row.data_type}"):
            row.pack(value)
