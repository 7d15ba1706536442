"""Files that are none: every reader of ours refuses a pipe or a device, and waits for neither."""

import os
import threading
from pathlib import Path

import pytest

from servogym.drive.drive import Drive
from servogym.drive.ethercat.esi_reader import read_esi
from servogym.drive.imports.eds import import_eds
from servogym.drive.imports.ethercat import import_sii
from servogym.drive.model.files import content
from servogym.drive.model.model import load
from servogym.drive.wire import pcapng
from servogym.drive.wire.log import messages
from servogym.drive.wire.recording import _columns
from servogym.envs.course.exercise import load as load_lesson
from servogym.envs.engine import mjcf_reading as mjcf
from servogym.training.evaluate.suite import read as load_suite

INCLUDES = '<mujoco><include file="{}"/><worldbody/></mujoco>'
MESH = (
    '<mujoco><asset><mesh name="m" file="{}"/></asset>'
    '<worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>'
)


def in_model(file):
    def read(path):
        folder = path.parent / "mine"
        folder.mkdir()
        if file != "drive.toml":
            (folder / "drive.toml").write_text('based_on = "generic"\n')
        path.rename(folder / file)
        load(folder)

    return read


def in_mjcf(text):
    def read(path):
        robot = path.parent / "robot.xml"
        robot.write_text(text.format(path.name))
        mjcf.read(robot)

    return read


READERS = {
    "content": ("file", content),
    "parameter file": ("p.json", lambda path: Drive(parameter_file=path)),
    "drive.toml": ("x", in_model("drive.toml")),
    "objects.csv": ("x", in_model("objects.csv")),
    "faults.csv": ("x", in_model("faults.csv")),
    "EDS": ("drive.eds", lambda path: import_eds(path, path.parent / "mine")),
    "MJCF": ("robot.xml", mjcf.read),
    "MJCF, include": ("part.xml", in_mjcf(INCLUDES)),
    "MJCF, mesh": ("part.stl", in_mjcf(MESH)),
    "CAN log": ("run.log", lambda path: list(messages(path))),
    "recording": ("run.csv", _columns),
    "ESI": ("drive.xml", read_esi),
    "EEPROM": ("drive.bin", lambda path: import_sii(path, path.with_name("made"))),
    "capture": ("run.pcapng", lambda path: list(pcapng.read(path))),
    "lesson": ("one.toml", load_lesson),
    "suite": ("one.toml", lambda path: load_suite(str(path))),
}


@pytest.mark.filterwarnings("ignore:parameter file")
@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("reader", READERS)
def test_a_pipe_or_a_device_is_refused_at_once(tmp_path, reader, kind):
    name, read = READERS[reader]
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    said = []

    def attempt():
        try:
            read(path)
            said.append("taken")
        except Exception as error:
            said.append(error)

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(20)
    assert said, "it waits for a pipe, or reads a device to its end"
    if reader == "parameter file":
        assert said == ["taken"]  # with a warning, and factory defaults
        return
    assert isinstance(said[0], ValueError)
    assert "\n" not in str(said[0])
    if (reader, kind) != ("MJCF, include", "device") and (reader, kind) != ("MJCF, mesh", "device"):
        assert f"it is a {kind}" in str(said[0])


def test_a_file_that_grows_is_read_no_further(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_bytes(bytes(100))
    assert content(path, largest=100) == bytes(100)
    monkeypatch.setattr(os, "stat", lambda _: type("S", (), {"st_mode": 0o100000, "st_size": 3})())
    with pytest.raises(ValueError, match="more bytes than a file may have, 50"):
        content(path, largest=50)


def test_what_is_not_there_is_no_file_of_ours():
    with pytest.raises(FileNotFoundError):
        content(Path("nowhere"))
