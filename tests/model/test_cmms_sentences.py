"""What the excerpt of the CMMS manual says, each test named by its section."""

import pytest

from servogym.drive.canopen.frame import parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.model.model import load

MODELS = ("festo_cmms", "festo_cmmd")
PRINTED = {(0x1401, 2), (0x6040, 0), (0x6041, 0), (0x6061, 0), (0x6093, 1)}
TITLES = {  # chapters of the contents with objects
    "3.3.2", "3.5.1", "3.5.2", "4.1", "4.2", "4.3", "4.4", "4.5", "4.6", "4.7", "4.8", "4.9",
    "4.10", "4.11", "4.12", "5.1", "5.1.3", "5.1.5", "6.1", "6.2", "6.3", "6.4", "6.5", "6.6",
}


@pytest.mark.parametrize("name", MODELS)
def test_3_2_1_12345678h_is_written_to_6093h_01_and_read_back(name):
    node = Node(Drive(name))
    node.poll(0)
    for request, answer in (
        ("601#2393600178563412", "581#6093600100000000"),
        ("601#4093600100000000", "581#4393600178563412"),
    ):
        node.receive(parse(request), 0)
        assert answer in [str(frame) for frame in node.poll(0)]


@pytest.mark.parametrize("name", MODELS)
def test_contents_each_object_has_a_title_or_says_what_it_is_inferred_from(name):
    used = set()
    for address, row in load(name).objects.items():
        if address in PRINTED:
            assert row.section == "3.2.1"
            assert "example" in row.note
            continue
        assert "inferred" in row.note, row.name
        used |= {row.section.split(" ")[0]} - {""}
    assert used == TITLES - {"5.1.3"}  # its one object is among the examples


@pytest.mark.parametrize("name", MODELS)
def test_contents_no_ethercat_no_encoder_emulation_no_analog_inputs(name):
    absent = {
        0x1100,
        0x1C00,
        0x1C12,
        0x1C13,
        0x201A,
        *range(0x2021, 0x2029),
        0x202F,
        0x2400,
        0x2401,
    }
    assert not absent & {index for index, _ in load(name).objects}
