"""The oscilloscope of the command line."""

import csv
import threading
import time
from itertools import pairwise
from pathlib import Path

import can
import numpy as np
import pytest
from golden import recordings

from servogym.drive.ethercat.decode import RETURNED
from servogym.drive.ethercat.frame import Command
from servogym.drive.wire import pcapng
from servogym.drive.wire.server import Server
from servogym.envs import linear_axis
from servogym.training.cli import main

GOLDEN = Path(__file__).parents[1] / "golden" / "generic.log"


def test_a_trigger_with_pre_trigger_catches_the_crossing(tmp_path):
    arguments = ["--channels", "6064h,axis.torque", "--trigger", "6064h:rising:20000",
                 "--before", "50", "--depth", "150", "--out", str(tmp_path)]
    assert main(["scope", "rigid", *arguments]) == 0
    with (tmp_path / "scope.csv").open(encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert head[1].startswith("position_actual_value")
    positions = [float(row[1]) for row in rows]
    assert len(positions) == 150
    assert positions[49] < 20_000 <= positions[50]
    assert (tmp_path / "scope.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--channels", "9999h"], "has no such object"),
        (["--channels", "nonsense"], "there is no channel 'nonsense'"),
        (["--trigger", "6064h"], "use CHANNEL:EDGE:LEVEL"),
        (["--trigger", "6064h:rising:1e9"], "the trigger did not occur"),
    ],
)
def test_wrong_options_of_the_scope_are_one_line(arguments, text, refused, tmp_path):
    assert text in refused(["scope", "rigid", "--out", str(tmp_path), *arguments])


def columns(folder):
    with (folder / "scope.csv").open(encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    return [name.partition(" (")[0] for name in head], [[float(x) for x in row] for row in rows]


def test_a_log_of_candump_is_shown_as_its_frames_have_it(tmp_path):
    frames = [line.split() for line in GOLDEN.read_text("utf-8").splitlines()]
    told = [(float(time.strip("()")), int.from_bytes(bytes.fromhex(frame[4:8]), "little"))
            for time, _, frame, _ in frames if frame.startswith("181#")]
    begin = float(frames[0][0].strip("()"))
    assert main(["scope", str(GOLDEN), "--channels", "statusword", "--out", str(tmp_path)]) == 0
    names, rows = columns(tmp_path)
    assert names == ["time", "statusword"]
    seen = {(round(time, 6), word) for time, word in rows}
    assert {(round(time - begin, 6), word) for time, word in told} <= seen
    assert len(told) > 10


def test_a_trigger_finds_the_fault_reset_in_a_log_and_a_recording_is_a_log(tmp_path):
    """Bit 7 of the controlword resets the fault, bit 3 of the statusword (CiA 402-2)."""
    whole, again = tmp_path / "whole", tmp_path / "again"
    assert main(["scope", str(GOLDEN), "--channels", "6041h,6040h", "--out", str(whole)]) == 0
    trigger = ["--trigger", "6040h:rising:128", "--before", "3", "--depth", "9"]
    for log, out in ((GOLDEN, tmp_path / "first"), (whole / "scope.csv", again)):
        named = (
            [text.replace("6040h", "controlword") for text in trigger] if out == again else trigger
        )
        assert main(["scope", str(log), "--channels", "statusword,controlword", *named,
                     "--out", str(out)]) == 0
    names, rows = columns(again)
    assert names == ["time", "statusword", "controlword"]
    assert len(rows) == 9
    assert [row[2] for row in rows[:4]] == [0x0F, 0x0F, 0x0F, 0x80]
    assert int(rows[3][1]) & 8
    first = columns(tmp_path / "first")[1]
    np.testing.assert_array_equal(np.array(rows), np.array(first))


def test_a_capture_of_ethercat_is_shown_by_the_names_of_the_mapped_objects(tmp_path):
    """The recording, and then its exchange of process data again with these values in the reply.

    The master has mapped six bytes of outputs, then 6063h and 6041h.
    """
    told = [(0, 0x0250), (-5, 0x0231), (70_000, 0x0233), (1 << 20, 0x0237), (-(1 << 31), 0x0218)]
    pairs = recordings.read("soem")
    request, reply = next((q, r) for q, r in pairs if len(r) == 27 and q[4] == Command.LRW)
    for position, word in told:
        values = position.to_bytes(4, "little", signed=True) + word.to_bytes(2, "little")
        pairs.append((request, reply[:-7] + values + reply[-1:]))
    capture = tmp_path / "soem.pcapng"
    writer = pcapng.Writer(capture)
    for n, frame in enumerate(part for pair in pairs for part in pair):
        length = int.from_bytes(frame[2:4].ljust(2, b"\0"), "little") & 0x7FF
        passed = 2 * (n % 2)  # a slave sets this bit of the source address
        head = bytes(RETURNED) + bytes([passed]) + bytes(11 - RETURNED)
        writer.write(head + frame.ljust(length + 4, b"\0"), n * 1_000_000)
    writer.close()
    channels = "position_actual_internal_value,statusword"
    assert main(["scope", str(capture), "--channels", channels, "--out", str(tmp_path)]) == 0
    names, rows = columns(tmp_path)
    assert names == ["time", "position_actual_internal_value", "statusword"]
    assert [(row[1], row[2]) for row in rows[-len(told) :]] == told
    steps = [later[0] - row[0] for row, later in pairwise(rows[-len(told) :])]
    assert steps == pytest.approx([2e-3] * 4)  # a request and a reply, a millisecond each


@pytest.fixture
def node():
    """A node on a virtual bus, in real time."""
    channel = "scope"
    machine = linear_axis("generic")
    server = Server(can.Bus(interface="virtual", channel=channel), [machine])
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server, ["-i", "virtual", "-c", channel]
    finally:
        server.stop()
        thread.join()
        server.close()


def test_a_running_node_is_polled_and_left_alone(node, tmp_path):
    server, bus = node
    (drive,) = server.machines[0].drives.values()
    before = drive.read("controlword"), server.nodes[0].state

    def fault_while_it_looks():
        while server.statistics.received < 120:  # the channels were found, and ten polls and more
            time.sleep(0.001)
        drive.inject("overvoltage")

    threading.Thread(target=fault_while_it_looks, daemon=True).start()
    assert main(["scope", "bus", *bus, "--rate", "100", "--trigger", "6041h:change",
                 "--before", "5", "--depth", "20", "--duration", "60",
                 "--out", str(tmp_path)]) == 0
    names, rows = columns(tmp_path)
    word = names.index("statusword")
    assert len(rows) == 20
    assert not any(int(row[word]) & 8 for row in rows[:5])
    assert all(int(row[word]) & 8 for row in rows[6:])
    assert all(later[0] > row[0] for row, later in pairwise(rows))
    assert (drive.read("controlword"), server.nodes[0].state) == before
    assert (tmp_path / "scope.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--channels", "6064h,9999h"], "9999h"),
        (["--channels", "axis.torque"], "on a machine alone"),
        (["--node-id", "9", "--duration", "0.1"], "no answer within"),
        (["--rate", "0"], "--rate: 0 is out of range above 0"),
        (
            ["--trigger", "6041h:change", "--duration", "0.1"],
            "the trigger did not occur within 0.1 s",
        ),
    ],
)
def test_what_a_node_does_not_have_is_one_line(node, arguments, text, refused, tmp_path):
    assert text in refused(["scope", "bus", *node[1], "--out", str(tmp_path), *arguments])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["missing.log"], "no such file"),
        ([str(GOLDEN), "--channels", "status"], "did you mean statusword"),
        ([str(GOLDEN), "--node-id", "7"], "no drive 7 in it"),
        ([str(GOLDEN), "--trigger", "statusword:above:70000"], "the trigger did not occur in"),
    ],
)
def test_what_a_log_does_not_have_is_one_line(arguments, text, refused, tmp_path):
    assert text in refused(["scope", *arguments, "--out", str(tmp_path)])
