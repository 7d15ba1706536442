"""`servogym replay`: a master's recorded frames are played into a model; differences are named."""

import csv
import shutil

import pytest

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.node import Node
from servogym.drive.canopen.replay import node_of, replay
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.replay import Replay, exchanges, slaves_of
from servogym.drive.model.model import load
from servogym.drive.objects.abort import SdoAbort
from servogym.drive.score import Verdict
from servogym.drive.wire.pcapng import Writer
from servogym.envs.plants.catalogue import axis_for, ethercat_line
from servogym.training.cli import main

READ = [(0x1000, 0), (0x1018, 1), (0x1018, 4), (0x605A, 0), (0x6065, 0), (0x6081, 0), (0x6083, 0),
        (0x6098, 0), (0x6041, 0), (0x6064, 0)]
PLANTED = {(0x605A, 0): "6", (0x6065, 0): "4711", (0x6083, 0): "4712", (0x1018, 1): "0xABC"}
MS = 1_000_000


class Recorded:
    """A wire that keeps what passes, a frame each ms."""

    def __init__(self, model, axis="none", slaves=1):
        segment, machines = ethercat_line([model] * slaves, axis)
        self.bus, self.frames, self.now = Bus(segment, machines, "real"), [], 0

    def exchange(self, frame, now=0):
        self.now += MS
        self.frames.append((self.now, frame))
        reply = self.bus.exchange(frame, self.now)
        if reply is not None:
            self.frames.append((self.now + 1000, reply))
        return reply


def session(model, axis="none", slaves=1):
    """A scan, SDO, OP, cycles; -> the frames."""
    wire = Recorded(model, axis, slaves)
    master = EtherCatMaster(wire)
    master.scan()
    master.slaves[0].read(0x0002, 2)
    master.to_preop()
    for index, subindex in READ:
        master.slaves[0].mailbox.upload(index, subindex)
    with pytest.raises(SdoAbort):
        master.slaves[0].mailbox.download(0x5FFF, 0, b"")
    master.synchronise()
    master.map()
    master.to_op()
    for n in range(100):
        for slave in master.slaves:
            slave.outputs[:2] = (6 if n < 30 else 7 if n < 60 else 15).to_bytes(2, "little")
        master.cycle()
    return wire.frames


def scored(frames, model, axis="none"):
    pairs = [*exchanges(frames)]
    segment, machines = ethercat_line([model] * slaves_of(pairs), axis)
    return Replay(Bus(segment, machines, "real"), model).run(pairs)


@pytest.fixture
def planted(tmp_path):
    """The generic drive with differences in objects, a register and the EEPROM."""
    folder = tmp_path / "planted"
    shutil.copytree(load("generic").folder, folder)
    path = folder / "objects.csv"
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        columns, rows = reader.fieldnames, [*reader]
    for row in rows:
        address = int(row["index"], 0), int(row["subindex"], 0)
        row["default"] = PLANTED.get(address, row["default"])
        if address == (0x605A, 0):
            row["min"], row["max"] = "", ""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
    toml = folder / "ethercat.toml"
    text = toml.read_text("utf-8").replace('0x0002 = "0200"', '0x0002 = "0500"')
    toml.write_text(text, "utf-8")
    return folder


@pytest.mark.parametrize("slaves", [1, 2])
@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd"])
def test_a_session_with_a_model_is_answered_by_it_again(model, slaves):
    score = scored(session(model, slaves=slaves), model)
    assert score.differences == {}
    assert score.total > 200


def test_each_planted_difference_is_named_and_none_is_invented(planted):
    score = scored(session(str(planted)), "generic")
    told = {difference.what.removeprefix("slave 1001h: ") for difference in
            score.differences.values()}
    objects = {what[:9] for what in told if what[5:6] == ":"}
    assert objects == {f"{i:04X}h:{s:02X}h" for i, s in PLANTED}
    # the identity stands in the EEPROM as well
    assert {what for what in told if what[5:6] != ":"} == {"build (0002h)", "EEPROM data (0508h)"}
    by_object = {difference.what[13:22]: difference for difference in score.differences.values()}
    difference = by_object["6083h:00h"]
    assert "68120000" in difference.recorded  # 4712
    assert difference.recorded != difference.model


def test_what_another_axis_measures_is_explained_by_physics_and_its_state_is_not():
    pairs = [*exchanges(session("generic"))]
    inputs = 26 + 7  # behind the headers and 7 bytes of outputs: statusword, position, mode
    for at, verdict in ((inputs + 2, Verdict.PHYSICS), (inputs, Verdict.DIFFERS)):
        measured = []
        for time, request, reply in pairs:
            other = bytearray(reply)
            if request[16] == 12:
                other[at] ^= 0x40
            measured.append((time, request, bytes(other)))
        segment, machines = ethercat_line(["generic"], "none")
        score = Replay(Bus(segment, machines, "real"), "generic").run(measured)
        assert score.counts[verdict] >= 100
        assert score.counts[Verdict.PHYSICS] + score.counts[Verdict.DIFFERS] <= 101
    assert all("6041h:00h statusword" in d.what for d in score.differences.values())


def test_a_drive_that_is_slower_is_explained_by_time():
    """States and mailboxes that come at a later poll; the frames are those of a quicker one."""
    frames = session("generic")
    pairs = [*exchanges(frames)]
    slow = []
    for time, request, reply in pairs:  # the drive was in its old state for one more poll
        if request[16] == 4 and request[20:22] == b"\x30\x01" and reply[26] == 2:
            before = bytearray(reply)
            before[26] = 1
            slow.append((time, request, bytes(before)))
        slow.append((time, request, reply))
    segment, machines = ethercat_line(["generic"], "none")
    score = Replay(Bus(segment, machines, "real"), "generic").run(slow)
    assert score.differences == {}
    assert score.counts[Verdict.TIME] >= len(slow) - len(pairs) > 0


def test_the_command_prints_how_many_and_what(tmp_path, planted, capsys):
    log = Writer(tmp_path / "run.pcapng")
    for n, (time, frame) in enumerate(session(str(planted))):
        marked = frame[:6] + bytes([frame[6] | 2 * (n % 2)]) + frame[7:]
        log.write(marked, time)
    log.close()
    assert main(["replay", str(tmp_path / "run.pcapng"), "--drive", "generic"]) == 0
    said = capsys.readouterr().out
    assert "answers are equal or explained" in said
    assert "6083h:00h" in said


def test_a_capture_without_ethercat_is_told(tmp_path, capsys):
    log = Writer(tmp_path / "run.pcapng")
    log.write(bytes(12) + b"\x08\x06" + bytes(46), 0)
    log.close()
    assert main(["replay", str(tmp_path / "run.pcapng"), "--drive", "generic"]) == 2
    assert "no EtherCAT frame with its reply" in capsys.readouterr().err


# ------------------------------------------------------------------------------------- CAN


def can_session(model):
    """Boot-up, SDO, heartbeat of a node, as a log has it."""
    machine = axis_for(str(model), 5)
    node, rows = Node(machine.drives["x"], 5), []
    requests = {
        10 * n: Frame(0x605, bytes([0x40]) + i.to_bytes(2, "little") + bytes([s, 0, 0, 0, 0]))
        for n, (i, s) in enumerate([*READ, (0x5FFF, 0)], 1)
    } | {200: Frame(0x605, bytes.fromhex("2B17100014000000")), 210: Frame(0, b"\1\5")}
    for tick in range(600):
        now = tick * 1000
        if tick in requests:
            node.receive(requests[tick], now)
            rows.append((now * 1e-6, requests[tick]))
        rows += [(now * 1e-6, frame) for frame in node.poll(now)]
        machine.step(round(1e-3 / machine.cycle_time))
    return rows


def test_a_can_log_of_a_model_is_answered_by_it_again():
    rows = can_session("generic")
    assert node_of(frame for _, frame in rows) == 5
    score = replay(axis_for("generic", 5), 5, rows)
    assert score.differences == {}
    assert score.counts[Verdict.EQUAL] >= len(READ) + 2


def test_planted_differences_in_a_can_log_are_named(planted):
    score = replay(axis_for("generic", 5), 5, can_session(planted))
    told = {difference.what[:9] for difference in score.differences.values()}
    assert told == {"1018h:01h", "605Ah:00h"}, "the others are commissioned for the axis"
