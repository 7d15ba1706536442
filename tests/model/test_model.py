"""Drive models: folders that are loaded, or refused with file, line and reason."""

import pickle
import shutil
from dataclasses import replace

import pytest

from servogym.drive.drive import Drive
from servogym.drive.kernel.faults import Cause
from servogym.drive.kernel.homing import NUMBERS
from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load, model_names
from servogym.envs import linear_axis


@pytest.fixture
def folder(tmp_path):
    copy = tmp_path / "mine"
    shutil.copytree(load("generic").folder, copy)
    return copy


def change(folder, file, old, new):
    path = folder / file
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return folder


def test_generic_has_all_modes_and_all_homing_methods():
    generic = load("generic")
    assert "generic" in model_names()
    assert set(generic.modes) == set(Mode) - {Mode.NONE}
    assert set(generic.homing_methods) == set(NUMBERS)
    causes = [fault.cause for fault in generic.faults]
    assert len(causes) == len(set(causes)) == 14
    assert Cause.NONE not in causes


def test_6502h_and_60e3h_say_what_the_model_can():
    drive = Drive()
    modes = drive.read("supported_drive_modes")
    assert [m for m in Mode if m and modes >> (m - 1) & 1] == sorted(drive.model.modes)
    count = drive.read(0x60E3, 0)
    methods = [drive.read(0x60E3, n + 1) for n in range(count)]
    assert sorted(methods) == sorted(drive.model.homing_methods)


def test_a_model_is_loaded_once_and_travels_by_name():
    assert load("generic") is load("generic")
    assert pickle.loads(pickle.dumps(load("generic"))) is load("generic")


def test_an_unknown_model_names_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown drive model 'acme': choose one of .*generic"):
        Drive("acme")


def test_a_folder_of_ones_own_is_a_model_without_any_python(folder):
    change(folder, "drive.toml", "position = 500", "position = 1000")
    change(
        folder,
        "objects.csv",
        "0x67FF,",
        "0x5000,0x00,my_parameter,VAR,INTEGER32,rw,,mm,-5,5,3,yes,mine,,,,\n0x67FF,",
    )
    drive = Drive(folder)
    assert drive.model.name == "mine"
    assert drive.axis.velocity_cycles == 4
    assert drive.read(0x5000) == 3
    drive.write("my_parameter", -5)
    drive.cycle(0.0)
    assert drive.read("my_parameter") == -5


def test_what_a_model_does_not_have_behaves_as_the_standard_says(folder):
    path = folder / "objects.csv"
    rows = path.read_text(encoding="utf-8").splitlines(keepends=True)
    gone = ("0x2020,", "0x60C2,", "0x605D,")
    path.write_text("".join(row for row in rows if not row.startswith(gone)), encoding="utf-8")
    change(folder, "faults.csv", "FOLLOWING_ERROR,OPTION_CODE", "FOLLOWING_ERROR,WARNING")
    axis = Drive(folder).axis
    assert axis.od.fault_reaction[Cause.FOLLOWING_ERROR] == 1, "from faults.csv"
    assert axis.od.halt_option_code == 1
    assert axis.od.interpolation_time_units == 1


COLUMNS = "index,subindex,name,object_type,data_type,access,pdo,unit,min,max,default,storable,"
COLUMNS += "section,note,field,when,hook\n"
ONE_MORE = "0x5000,0x00,my_parameter,VAR,INTEGER32,rw,,mm,-5,5,3,yes,mine,,,,\n"


@pytest.fixture
def based(tmp_path):
    """Makes a folder of one's own: lines of its drive.toml, rows of its objects.csv."""

    def make(rows="", toml='based_on = "generic"\n', name="mine"):
        own = tmp_path / name
        own.mkdir()
        (own / "drive.toml").write_text(toml, encoding="utf-8")
        if rows:
            (own / "objects.csv").write_text(COLUMNS + rows, encoding="utf-8")
        return own

    return make


@pytest.mark.parametrize("base", model_names())
def test_one_row_adds_an_object_to_a_model_and_leaves_all_others(based, base):
    own, generic = load(based(ONE_MORE, f'based_on = "{base}"\n')), load(base)
    assert own.objects[0x5000, 0].default == 3
    same = {a: replace(row, where="") for a, row in own.objects.items() if a != (0x5000, 0)}
    assert same == {a: replace(row, where="") for a, row in generic.objects.items()}
    assert (own.rpdos, own.tpdos, own.faults) == (generic.rpdos, generic.tpdos, generic.faults)
    assert Drive(own).read(0x5000) == 3


def test_commissioning_fits_itself_to_a_range_of_the_drive(based):
    own = based("0x607F,0x00,,,,,,,,1000000,1000000,,,,,,\n")
    assert linear_axis(own).drives["x"].read("max_profile_velocity") == 1000000


def test_a_default_of_the_toml_goes_before_that_of_the_csv(based):
    toml = 'based_on = "generic"\n[defaults]\nmy_parameter = 4\n'
    assert Drive(based(ONE_MORE, toml)).read(0x5000) == 4


def test_a_row_without_data_type_says_only_what_differs_from_the_base(based):
    rows = "0x6081,0x00,,,,,-,,,,7,,my manual,mine,,,\n"
    changed = load(based(rows)).objects[0x6081, 0]
    standard = load("generic").objects[0x6081, 0]
    assert standard.pdo == "rx"
    assert changed == replace(
        standard, pdo="", default=7, section="my manual", note="mine", where=changed.where
    )
    assert changed.where == "objects.csv, line 2 (mine)"


def test_a_whole_row_takes_the_place_of_the_bases(based):
    own = load(based(ONE_MORE.replace("0x5000", "0x6081")))
    assert own.objects[0x6081, 0].name == "my_parameter"
    assert [*own.objects] == [*load("generic").objects]


def test_rows_refer_to_the_model_that_objects_of_names(based):
    generic = load("generic").folder
    toml = 'objects_of = "metronix_ars2000"\n' + (generic / "drive.toml").read_text("utf-8")
    own = based("0x6510,0x11,switch,,,,,,,,,,mine,,,,\n", toml)
    (own / "pdo.csv").write_text("direction,number\n")
    shutil.copy(generic / "faults.csv", own)
    (row,) = load(own).objects.values()
    other = load("metronix_ars2000").objects[0x6510, 0x11]
    assert (row.name, row.section) == ("switch", "mine")
    assert (row.offset, row.data_type, row.allowed) == (
        other.offset,
        other.data_type,
        other.allowed,
    )


def test_models_stand_on_one_another_by_relative_path(based, tmp_path):
    based(ONE_MORE, name="first")
    toml = 'based_on = "../first"\nwithout = ["6081h"]\n'
    second = load(based(ONE_MORE.replace("0x5000", "0x5001").replace("my", "own"), toml))
    assert {(0x5000, 0), (0x5001, 0)} <= second.objects.keys()
    assert second.objects.keys() == (
        load("generic").objects.keys() | {(0x5000, 0), (0x5001, 0)}
    ) - {(0x6081, 0)}
    assert second.objects[0x5000, 0].offset != second.objects[0x5001, 0].offset


@pytest.mark.parametrize(
    ("rows", "toml", "message"),
    [
        (ONE_MORE.replace("INTEGER32", ""), 'based_on = "generic"', "line 2 .* no data_type"),
        (ONE_MORE * 2, 'based_on = "generic"', "5000h:00h occurs twice"),
        (ONE_MORE.replace("my_parameter", "controlword"), 'based_on = "generic"', "occurs twice"),
        ("", 'based_on = "generic"\nwithout = ["5000h"]', "without: the base has no .*5000h"),
        ("", 'based_on = "../mine"', "leads back to 'mine'"),
        ("", 'based_on = "acme"', "unknown drive model 'acme'"),
        ("", "title = 'alone'", "no objects.csv: write it, or say based_on"),
    ],
)
def test_a_wrong_base_or_reference_is_refused_with_its_reason(based, rows, toml, message):
    with pytest.raises(ValueError, match=message):
        load(based(rows, toml))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("objects.csv", "UNSIGNED16", "UNSIGNED17", r"objects.csv, line \d+ \(mine\): data_type"),
        ("objects.csv", "0x605A,0x00", "0x6040,0x00", "6040h:00h occurs twice"),
        ("objects.csv", "0,8,2,yes", "0,8,9,yes", r"default 9 is out of range \[0, 8\]"),
        ("objects.csv", ",controlword,,", ",control_word,,", "no field od.control_word"),
        ("objects.csv", ",controlword,,", ",statusword[0],,", "has the shape"),
        ("objects.csv", "UNSIGNED16,rw,rx,,,,0,,CiA", "REAL32,rw,rx,,,,0,,CiA", "16, not REAL32"),
        ("objects.csv", ",rw,rx,", ",rx,rx,", "access 'rx' is unknown"),
        ("objects.csv", "controlword,,\n", "controlword,asleep,\n", "when 'asleep' is unknown"),
        ("objects.csv", "controlword,,\n", "controlword,,magic\n", "hook 'magic' is unknown"),
        ("objects.csv", ",controlword,,", ",@6041:00,,", "not an earlier row"),
        ("pdo.csv", "rx,1,", "both,1,", "neither rx nor tx"),
        ("pdo.csv", "0x6040,0x00,16", "0x6040,0x00,8", "cannot be mapped"),
        ("pdo.csv", "rx,2,", "rx,7,", "gap"),
        ("faults.csv", "ENCODER_LOSS", "NOSE", "cause 'NOSE'"),
        ("drive.toml", '"pp"', '"pq"', "unknown modes 'pq'"),
        ("drive.toml", "position = 500", "position = 510", "whole multiple"),
        ("drive.toml", "velocity = 250", "velocity = -1", "cycle_time_us.velocity"),
        ("drive.toml", "1, 2, 3", "1, 2, 31", "unknown homing_methods 31"),
        ("drive.toml", "title =", "title", "drive.toml"),
        ("drive.toml", "[quirks]", "[quirks]\nodd = 1\n", "quirks.odd is unknown"),
        ("drive.toml", "[quirks]", "[fixed]\nodd = 1\n", "fixed.odd is unknown"),
    ],
)
def test_a_wrong_row_is_refused_with_file_and_reason(folder, file, old, new, message):
    change(folder, file, old, new)
    with pytest.raises(ValueError, match=message):
        Drive(folder)


def test_a_pdo_over_64_bits_is_refused(folder):
    path = folder / "pdo.csv"
    row = "rx,1,0x00000200+node_id,255,0,{},0x607A,0x00,32,,x\n"
    path.write_text(path.read_text() + row.format(2) + row.format(3))
    with pytest.raises(ValueError, match=r"pdo.csv, line \d+ .* longer than 64 bits"):
        load(folder)
