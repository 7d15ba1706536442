"""`ethercat.toml`: what cannot be right is refused with file and key."""

import random
import shutil
import tomllib

import pytest

from servogym.drive.drive import Drive
from servogym.drive.ethercat.slave import Slave
from servogym.drive.model.model import load


@pytest.fixture
def folder(tmp_path):
    """A copy of the generic drive."""
    target = tmp_path / "mine"
    shutil.copytree(load("generic").folder, target)
    return target


def changed(folder, old, new):
    path = folder / "ethercat.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


WRONG = [
    ('name = "Generic CiA 402 drive"', "name = 5", "name = 5 is not of type str"),
    ('order = "generic"', 'colour = "red"', "colour is unknown"),
    ("shortest = 34", "shortest = 16", r"shortest = 16 is not in 17\.\.256"),
    ("shortest = 34", "shortest = -1", "whole number of 0 or more"),
    ("shortest = 34", "least = 34", "mailbox.least is unknown"),
    ('["CoE", "FoE"]', '["CoE", "FTP"]', "protocol 'FTP' is unknown"),
    ("[0x1000, 256, 0x1400, 256]", "[0x1000, 256, 0x1080, 256]", "mailbox in overlaps with mail"),
    ("[0x1000, 256, 0x1400, 256]", "[0x0F00, 256, 0x1400, 256]", "outside the memory"),
    ("[0x1000, 256, 0x1400, 256]", "[0x1000, 256]", "not a list of 4 numbers"),
    ("start = [0x1800, 0x1C00]", "start = [0x1400, 0x1C00]", "outputs overlaps with mailbox in"),
    ("size = 4096", "size = 1000", "not a multiple of 128"),
    ('0x0000 = "11"', '0x0000 = "1"', "are not bytes"),
    ('0x0000 = "11"', '0x1000 = "11"', "is not a register"),
    ('0x0000 = "11"', 'first = "11"', "registers: invalid literal"),
    ("cycle_factor0 = 1", "cycle_factor9 = 1", "dc.modes"),
    ('name = "DC", assign_activate = 0x0300', 'name = "DC", assign_activate = "x"', "dc.modes"),
    ("error_settings = true", 'error_settings = "yes"', "is not of type bool"),
    ("[sii]", "[sii", "ethercat.toml"),
    ('"1005h", "1006h"', '5, "1006h"', "without: 5 is not of type str"),
    ("[sii]", "[pdo]\nmappable = [4]\n[sii]", "pdo.mappable = .4. is not a list of 2 numbers"),
    ("[sii]", "[pdo]\nexcludes = { first = [1] }\n[sii]", "pdo.excludes: invalid literal"),
    ("[sii]", "[pdo]\nexcludes = { 0x1600 = 5 }\n[sii]", "pdo.excludes: 5 is not a list of PDOs"),
]


@pytest.mark.parametrize(("old", "new", "reason"), WRONG)
def test_what_cannot_be_right_is_refused_with_the_file_and_the_reason(folder, old, new, reason):
    changed(folder, old, new)
    with pytest.raises(ValueError, match=reason) as error:
        load(folder, "ethercat")
    assert "ethercat.toml" in str(error.value)
    load(folder, "can")


def test_a_model_for_ethercat_without_its_file_is_refused(folder):
    (folder / "ethercat.toml").unlink()
    with pytest.raises(ValueError, match=r"ethercat\.toml"):
        load(folder, "ethercat")


def test_a_model_on_top_of_another_has_its_ethercat_face(tmp_path):
    (tmp_path / "drive.toml").write_text('based_on = "generic"\ntitle = "Mine"\n')
    drive = Drive(tmp_path, bus="ethercat")
    assert drive.model.buses == ("can", "ethercat")
    assert Slave(drive).sii


def test_an_alias_out_of_range_is_refused():
    with pytest.raises(ValueError, match=r"alias = 65536 is not a whole number in 0..65535"):
        Slave(Drive("generic", bus="ethercat"), alias=65536)


def test_damaged_files_are_read_or_refused_in_words(folder):
    path = folder / "ethercat.toml"
    text = path.read_text(encoding="utf-8")
    generator = random.Random(17)
    refusals = []
    for n in range(60):
        at = generator.randrange(len(text))
        path.write_text(
            text[:at] + generator.choice('0x"[]{}=,9-\n ') + text[at + generator.randrange(3) :],
            encoding="utf-8",
        )
        try:
            other = folder.with_name(f"mine_{n}")  # models are kept by their folder
            shutil.copytree(folder, other)
            Slave(Drive(other, bus="ethercat"))
        except ValueError as error:
            refusals.append(str(error))
        finally:
            shutil.rmtree(other, ignore_errors=True)
    assert len(refusals) > 20
    assert all(refusals)


def test_every_file_is_toml_with_its_tables():
    for name in ("generic", "festo_cmmp_as", "kollmorgen_akd"):
        text = (load(name).folder / "ethercat.toml").read_text(encoding="utf-8")
        assert {"mailbox", "process_data", "sii", "registers", "dc"} <= set(tomllib.loads(text))
