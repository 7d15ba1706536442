"""A damaged model folder is named with its file, in one line, whatever is wrong in it."""

import random
import shutil
import warnings

import pytest

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.model.model import load, model_names

CELLS = (b"", b"-1", b"0x", b"1e5", b"99999999999", b"rw", b"{", b"{1..", b"{0..99999999999}",
         b"od[3]", b"@", b"factor", b"nan")
VALUES = (b" -1", b' "x"', b" []", b" {}", b" 0", b" 1e400", b" nan", b" true", b" 7777777")
BYTES = (b"[", b"\0", b"\xff", b'"', b",", b"\n", b"9" * 21)


def damaged(data, chance):
    """Bytes, lines, cells and values that are lost or others."""
    for _ in range(chance.randint(1, 3)):
        kind, at = chance.randrange(7), chance.randrange(len(data) + 1)
        lines = data.split(b"\n")
        n = chance.randrange(len(lines))
        if kind == 0:
            data = data[:at] + data[at + chance.choice((1, 10, 1000)) :]
        elif kind == 1:
            data = data[:at] + chance.choice(BYTES) + data[at:]
        elif kind == 2:
            data = data[:at] + bytes([chance.randrange(256)]) + data[at + 1 :]
        elif kind == 3:
            data = data[:at]
        else:
            cells = lines[n].split(b",")
            cells[chance.randrange(len(cells))] = chance.choice(CELLS)
            key, equals, _ = lines[n].partition(b"=")
            changed = {4: [], 5: [b",".join(cells)], 6: [key + equals + chance.choice(VALUES)]}
            data = b"\n".join([*lines[:n], *changed[kind], *lines[n + 1 :]])
    return data


def use(folder):
    """Make drives of a folder and let them work a little."""
    for bus in load(folder).buses:
        drive = Drive(folder, bus=bus)
        for _ in range(3):
            drive.cycle(0.0)
        if bus == "can":
            node = Node(drive)
            for time, frame in enumerate((Frame(0, b"\1\0"), Frame(0x80), Frame(0x201, bytes(8)))):
                node.receive(frame, time * 1000)
                node.poll(time * 1000)


def fuzz(tmp_path, seed, count):
    chance, refused = random.Random(seed), 0
    for n in range(count):
        folder = tmp_path / f"model_{n}"
        shutil.copytree(load(chance.choice(model_names())).folder, folder)
        files = sorted(path for path in folder.iterdir() if path.suffix in (".toml", ".csv"))
        file = chance.choice(files)
        file.write_bytes(damaged(file.read_bytes(), chance))
        reason = ""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                use(folder)
        except ValueError as error:
            reason = str(error)
        names = [folder.name, *(path.name for path in files)]
        assert not reason or any(name in reason for name in names), f"{file}: {reason}"
        refused += bool(reason)
        shutil.rmtree(folder)
    return refused


def test_damaged_folders_are_named(tmp_path):
    assert fuzz(tmp_path, 1, 40) > 20


@pytest.mark.slow
def test_400_damaged_folders_are_named(tmp_path):
    assert fuzz(tmp_path, 2, 400) > 200


@pytest.mark.parametrize(
    ("file", "line", "spoil"),
    [
        ("objects.csv", 3, lambda line: line[:5] + b"\xff" + line[6:]),
        ("objects.csv", 7, lambda line: b"0x" + line),
        ("pdo.csv", 2, lambda line: line.replace(b"rx", b"up")),
        ("faults.csv", 4, lambda line: line + b",more"),
    ],
)
def test_the_line_is_told(tmp_path, file, line, spoil):
    folder = tmp_path / "mine"
    shutil.copytree(load("generic").folder, folder)
    lines = (folder / file).read_bytes().split(b"\n")
    lines[line - 1] = spoil(lines[line - 1])
    (folder / file).write_bytes(b"\n".join(lines))
    with pytest.raises(ValueError, match=rf"{file}, line {line} \(mine\)"):
        load(folder)
