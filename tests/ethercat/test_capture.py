"""Captures: written, read back, and told by meaning."""

import struct

import pytest

from servogym.drive.drive import Drive
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.decode import EtherCatDecoder
from servogym.drive.ethercat.frame import Command, Datagram, pack
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.wire.pcapng import Writer, read
from servogym.training.cli import main

FRAME = pack([Datagram(Command.BRD, 0, 0, b"\0")])


class Recorded:
    """A wire that keeps what passes in a capture."""

    def __init__(self, bus, file):
        self.bus, self.log, self.time = bus, Writer(file), 0

    def exchange(self, frame, now=0):
        self.log.write(frame, self.time)
        reply = self.bus.exchange(frame)
        self.time += 1_000_000
        if reply is not None:
            self.log.write(reply, self.time)
        return reply


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    file = tmp_path_factory.mktemp("captures") / "run.pcapng"
    wire = Recorded(Bus(Segment([Slave(Drive("kollmorgen_akd"))])), file)
    master = EtherCatMaster(wire)
    master.scan()
    master.to_preop()
    (slave,) = master.slaves
    slave.assign([0x1724], [0x1B24])
    slave.mailbox.upload(0x1008)
    master.refused(slave, 0x1000, 0, bytes(4))
    master.map()
    master.to_op()
    drive = wire.bus.segment.stations[0].drive
    for command in (6, 7, 15):
        slave.outputs[:] = struct.pack("<iHh", 0, command, 0)
        for _ in range(4):
            drive.cycle(0.0)
            wire.bus.segment.publish(0)
            master.cycle()
    wire.log.close()
    return file


def test_a_capture_is_told_by_meaning(capture, capsys):
    assert main(["decode", str(capture)]) == 0
    lines = [line[14:] for line in capsys.readouterr().out.splitlines()]
    told = iter(lines)
    for wanted in (
        "slave 0 becomes slave 1001h",
        "vendor 0000006Ah, product 00414B44h, Kollmorgen AKD",
        "sync manager 0 at 1800h, 1024 bytes, control 26h",
        "AL control (0120h) PRE_OPERATIONAL",
        "AL status (0130h) PRE_OPERATIONAL",
        "write sync_manager_2_number_of_assigned_pdos = 1",
        "'AKD-P00606-NBCC-E000'",
        "refused: 06010002h attempt to write a read-only object",
        "FMMU 0 writes 8 bytes at 1100h as 00010000h",
        "AL status (0130h) SAFE_OPERATIONAL",
        "AL status (0130h) OPERATIONAL",
        "controlword 0006h",
        "→ READY_TO_SWITCH_ON",
        "controlword 000Fh",
        "→ OPERATION_ENABLED",
    ):
        for line in told:
            if wanted in line:
                break
        else:
            raise AssertionError(f"{wanted!r} is missing or out of order in\n" + "\n".join(lines))


def test_times_and_frames_come_back(tmp_path):
    with_times = [(FRAME, 1_700_000_000_123_456_789), (FRAME[:60], 1_700_000_000_123_456_999)]
    log = Writer(tmp_path / "a.pcapng", ("va", "vb"))
    for n, (frame, time) in enumerate(with_times):
        log.write(frame, time, n)
    log.close()
    assert [(p.frame, p.time, p.interface) for p in read(tmp_path / "a.pcapng")] == [
        (*row, n) for n, row in enumerate(with_times)
    ]


def test_the_older_format_is_read(tmp_path):
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    record = struct.pack("<IIII", 5, 250, len(FRAME), len(FRAME)) + FRAME
    (tmp_path / "a.pcap").write_bytes(head + record)
    (packet,) = read(tmp_path / "a.pcap")
    assert (packet.time, packet.frame) == (5_000_250_000, FRAME)


@pytest.mark.parametrize("content", [b"", b"no capture at all, this is", b"\x0a\x0d\x0d\x0a"])
def test_what_is_no_capture_is_refused_in_one_line(tmp_path, capsys, content):
    (tmp_path / "a.pcapng").write_bytes(content)
    assert main(["decode", str(tmp_path / "a.pcapng")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_capture_that_is_cut_off_says_where(tmp_path, capture):
    (tmp_path / "a.pcapng").write_bytes(capture.read_bytes()[:-7])
    with pytest.raises(ValueError, match="cut off at byte"):
        list(read(tmp_path / "a.pcapng"))


def test_decoding_never_raises():
    from test_controller import broken_frames

    decoder = EtherCatDecoder("kollmorgen_akd")
    for n, frame in enumerate(broken_frames(9, 3000)):
        changed = bytearray(frame)
        if len(changed) > 6 and n % 2:
            changed[6] |= 2
        assert isinstance(decoder.decode(bytes(changed)), list)
