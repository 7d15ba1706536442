"""Parameters that survive: 1010h, 1011h, and files that cannot be trusted."""

import json
import os

import pytest

from servogym.drive.drive import Drive
from servogym.drive.objects import store
from servogym.drive.objects.abort import Abort, SdoAbort

SAVE, LOAD = 0x65766173, 0x64616F6C


@pytest.fixture
def file(tmp_path):
    return tmp_path / "parameters.json"


def stored(file, **values):
    drive = Drive(parameter_file=file)
    for name, value in values.items():
        drive.write(name, value)
    drive.write("save_all_parameters", SAVE)
    return drive


def test_saved_parameters_are_there_after_power_on(file):
    stored(file, profile_velocity=4711, controlword=6)
    again = Drive(parameter_file=file)
    assert again.read("profile_velocity") == 4711
    assert again.read("controlword") == 0, "process data are not parameters"


def test_the_pdo_mapping_is_a_parameter(file):
    drive = Drive(parameter_file=file)
    drive.map_pdos([["controlword", "target_torque"]])
    drive.write("save_all_parameters", SAVE)
    assert Drive(parameter_file=file).rpdo_size == 4


def test_without_a_file_they_live_as_long_as_the_drive():
    drive = Drive()
    drive.write("profile_velocity", 4711)
    drive.write("save_all_parameters", SAVE)
    drive.write("profile_velocity", 1)
    drive.reset()
    assert drive.read("profile_velocity") == 4711


def test_load_brings_factory_defaults_at_the_next_power_on(file):
    drive = stored(file, profile_velocity=4711)
    drive.write("restore_all_default_parameters", LOAD)
    assert drive.read("profile_velocity") == 4711
    drive.reset()
    assert drive.read("profile_velocity") == drive.model.names["profile_velocity"].default


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: text[: len(text) // 2],
        lambda text: text.replace("4711", "4712"),
        lambda text: text.replace('"generic"', '"acme"'),
        lambda text: "[]",
        lambda text: "",
        lambda text: json.dumps({"model": "generic", "values": {"x": None}, "crc32": 0}),
    ],
)
def test_a_spoiled_file_is_named_and_ignored_as_a_whole(file, spoil):
    stored(file, profile_velocity=4711)
    file.write_text(spoil(file.read_text()))
    with pytest.warns(UserWarning, match=r"parameters.json is ignored.*1010h"):
        drive = Drive(parameter_file=file)
    assert drive.read("profile_velocity") == drive.model.names["profile_velocity"].default


def test_a_kill_while_saving_leaves_the_old_file(file, monkeypatch):
    stored(file, profile_velocity=4711)

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        store.save(file, "generic", {"6081:00": 1})
    assert Drive(parameter_file=file).read("profile_velocity") == 4711
    assert [path.name for path in file.parent.iterdir()] == ["parameters.json"]


def test_a_folder_that_cannot_be_written_is_a_hardware_abort(tmp_path):
    drive = Drive(parameter_file=tmp_path / "missing" / "p.json")
    with pytest.raises(SdoAbort) as error:
        drive.write("save_all_parameters", SAVE)
    assert error.value.code == Abort.HARDWARE
