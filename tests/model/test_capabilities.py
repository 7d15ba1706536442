"""6502h and 60E3h tell a master what the drive can, whatever the base of its model could."""

import re
from pathlib import Path

import canopen
import pytest

from servogym.drive import Drive
from servogym.drive.canopen import eds
from servogym.drive.imports.eds import import_eds
from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load
from servogym.drive.model.rows import DATA_TYPES
from servogym.drive.objects.abort import SdoAbort
from servogym.training.cli import main

TWO_MODES = 'modes = ["pp", "hm"]\nhoming_methods = [17, -18, 35]\n'
LIST_OF_ONE = """\
index,subindex,name,object_type,data_type,access,pdo,unit,min,max,default,storable,section,note,field,when,hook
0x60E3,0x00,,,,,,,,,,,,,,,
0x60E3,0x01,,,,,,,,,,,,,,,
"""


def made(folder: Path, base: str, capabilities: str, objects: str = "", defaults: str = "") -> Path:
    folder.mkdir()
    text = f'based_on = "{base}"\n[capabilities]\n{capabilities}{defaults}'
    (folder / "drive.toml").write_text(text, encoding="utf-8")
    if objects:
        (folder / "objects.csv").write_text(objects, encoding="utf-8")
    return folder


def told(drive: Drive) -> tuple[list[int], list[int]]:
    """Modes and methods, as a master asks for them."""
    bits = drive.read(0x6502)
    methods = [drive.read(0x60E3, n + 1) for n in range(drive.read(0x60E3, 0))]
    return [n + 1 for n in range(32) if bits >> n & 1], methods


@pytest.mark.parametrize("base", ["generic", "kollmorgen_akd"])
def test_a_model_with_fewer_modes_and_methods_than_its_base_says_so(tmp_path, base):
    drive = Drive(made(tmp_path / "own", base, TWO_MODES))
    assert told(drive) == ([Mode.PROFILE_POSITION, Mode.HOMING], [17, -18, 35])
    assert (0x60E3, 4) not in drive.model.objects


def test_a_model_with_more_methods_than_rows_gets_rows(tmp_path):
    model = load(made(tmp_path / "own", "festo_cmmp_as", TWO_MODES, LIST_OF_ONE))
    assert [Drive(model).read(0x60E3, n) for n in range(4)] == [3, 17, -18, 35]
    assert model.objects[0x60E3, 3].name == "supported_homing_method_3"


@pytest.mark.parametrize("data_type", DATA_TYPES)
def test_an_object_of_the_list_can_have_any_type(tmp_path, data_type):
    sheet = tmp_path / "own.eds"
    eds.write("generic", sheet)
    text = sheet.read_text()
    for section, number in (("6502", "0x0007"), ("60E3sub0", "0x0005"), ("60E3sub1", "0x0002")):
        head, found, tail = text.partition(f"[{section}]\n")
        assert found
        assert f"DataType={number}" in tail.partition("[")[0]
        tail = tail.replace(f"DataType={number}", f"DataType={DATA_TYPES[data_type]}", 1)
        tail = re.sub("DefaultValue=.*", "DefaultValue=-2147483648", tail, count=1)
        text = f"{head}{found}{tail}"
    sheet.write_text(text)
    import_eds(sheet, tmp_path / "model")
    Drive(tmp_path / "model")


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [("modes_of_operation", 9, r"\[0, 1, 6\]"), ("homing_method", 1, r"\[-18, 0, 17, 35\]")],
)
def test_who_writes_another_one_is_told_those_there_are(tmp_path, name, value, says):
    drive = Drive(made(tmp_path / "own", "generic", TWO_MODES))
    with pytest.raises(SdoAbort, match=rf"\(06090030h\); {name} may be one of {says}"):
        drive.write(name, value)


def test_a_data_sheet_tells_the_same_and_comes_back_with_it(tmp_path):
    sheet = tmp_path / "own.eds"
    eds.write(load(made(tmp_path / "own", "generic", TWO_MODES)), sheet)
    assert canopen.import_od(str(sheet))[0x60E3][0].default == 3
    again = load(import_eds(sheet, tmp_path / "again").folder)
    assert again.modes == (Mode.PROFILE_POSITION, Mode.HOMING)
    assert sorted(again.homing_methods) == [-18, 17, 35]


def test_a_default_of_ones_own_and_the_bits_of_the_maker_stay(tmp_path):
    own = "[defaults]\nsupported_drive_modes = 0x20021\n"
    folder = made(tmp_path / "own", "generic", TWO_MODES, defaults=own)
    assert told(Drive(folder))[0] == [1, 6, 18]
    assert told(Drive(made(tmp_path / "next", str(folder), 'modes = ["pp"]\n')))[0] == [1, 6, 18]


def test_the_list_of_changes_does_not_say_twice_what_the_model_can(tmp_path, capsys):
    folder = made(tmp_path / "own", "generic", TWO_MODES)
    assert main(["drives", str(folder)]) == 0
    said = capsys.readouterr().out
    for row in ("pp hm", "17 -18 35"):
        assert row in said
    assert "6502h" not in said
    assert "60E3h" not in said
