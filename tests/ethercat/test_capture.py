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
from servogym.drive.objects.abort import SdoAbort
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
    with pytest.raises(SdoAbort):
        slave.mailbox.download(0x1000, 0, bytes(4))
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
    with pytest.raises(ValueError, match=r"byte \d+: cut off"):
        list(read(tmp_path / "a.pcapng"))


def test_decoding_never_raises():
    from test_controller import broken_frames

    decoder = EtherCatDecoder("kollmorgen_akd")
    for n, frame in enumerate(broken_frames(9, 3000)):
        changed = bytearray(frame)
        if len(changed) > 6 and n % 2:
            changed[6] |= 2
        assert isinstance(decoder.decode(bytes(changed)), list)


# ------------------------------------------------------------------- what is not told, and what is


def told(*exchanges, managers=True):
    """Lines of the last exchange: (command, address, sent, back, working counter)."""
    decoder, lines = EtherCatDecoder("kollmorgen_akd"), []
    rows = [(Command.FPWR, 0x0800, struct.pack("<HHBBBB", start, 1024, control, 0, 1, 0), None, 1)
            for start, control in ((0x1800, 0x26),)]
    rows += [(Command.FPWR, 0x0808, struct.pack("<HHBBBB", 0x1C00, 1024, 0x22, 0, 1, 0), None, 1)]
    for command, address, sent, back, counter in [*(rows if managers else []), *exchanges]:
        out = Datagram(command, 0x1001, address, sent)
        decoder.decode(pack([out]))
        reply = out._replace(data=sent if back is None else back, wkc=counter)
        lines = decoder.decode(pack([reply], source=b"\x03\x01\x01\x01\x01\x01"))
    return lines


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0x11, "AL control (0120h) INIT + acknowledge"),
        (0x14, "AL control (0120h) SAFE_OPERATIONAL + acknowledge"),
        (0x28, "AL control (0120h) OPERATIONAL + identification requested"),
        (0x02, "AL control (0120h) PRE_OPERATIONAL"),
    ],
)
def test_bit_4_of_al_control_is_the_acknowledge(value, text):
    assert told((Command.FPWR, 0x0120, bytes([value, 0]), None, 1)) == [f"slave 1001h: {text}"]


def test_bit_4_of_al_status_is_the_error():
    back = bytes.fromhex("14000000 1B00")
    assert told((Command.FPRD, 0x0130, bytes(6), back, 1)) == [
        "slave 1001h: AL status (0130h) SAFE_OPERATIONAL + error bit, 001Bh WATCHDOG"
    ]


@pytest.mark.parametrize(
    ("sent", "lines"),
    [
        ("0001 08000000", []),  # read, as all masters do hundreds of times
        ("0001", []),
        ("0102 04000000", ["slave 1001h: EEPROM write word 0004h"]),
        ("0002 04000000", ["slave 1001h: EEPROM write word 0004h, not enabled"]),
        ("0004", ["slave 1001h: EEPROM reload"]),
        ("0007", ["slave 1001h: EEPROM command 7"]),
    ],
)
def test_a_command_to_the_eeprom_is_told_by_what_it_does(sent, lines):
    assert told((Command.FPWR, 0x0502, bytes.fromhex(sent), None, 1)) == lines


def test_an_eeprom_that_refuses_is_told():
    assert told((Command.FPRD, 0x0502, bytes(2), b"\x80\x60", 1)) == [
        "slave 1001h: EEPROM: refused", "slave 1001h: EEPROM: write not enabled"
    ]


def test_an_empty_mailbox_that_is_polled_tells_nothing_and_a_full_one_does():
    assert told((Command.FPRD, 0x1C00, bytes(1024), None, 0)) == []
    assert told((Command.FPWR, 0x1800, bytes(1024), None, 0)) == [
        "slave 1001h: its mailbox is still full"
    ]


def foreign(path, frames):
    log = Writer(path)
    for n, frame in enumerate(frames):
        log.write(frame, n)
    log.close()
    return str(path)


ARP = bytes.fromhex("ffffffffffff 020000000001 0806") + bytes(46)


def test_frames_of_other_protocols_are_counted_not_told(tmp_path, capsys):
    assert main(["decode", foreign(tmp_path / "a.pcapng", [ARP, FRAME, ARP])]) == 0
    said = capsys.readouterr()
    assert "EtherCAT" not in said.out
    assert said.err == "2 frames of other protocols were left out\n"


def test_a_capture_without_ethercat_is_told_in_one_line(tmp_path, capsys):
    assert main(["decode", foreign(tmp_path / "a.pcapng", [ARP] * 3504)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "none of its 3504 frames is an EtherCAT frame" in said.err


def test_a_master_whose_own_address_has_the_bit_of_returned_frames_is_understood(capture, tmp_path):
    """KickCAT sends from CADECADEDEFF, an address that is administered locally."""
    local = [p.frame[:6] + bytes.fromhex("cadecadedeff") + p.frame[12:] for p in read(capture)]
    lines = []
    for frames in ([packet.frame for packet in read(capture)], local):
        decoder = EtherCatDecoder()
        lines.append([line for frame in frames for line in decoder.decode(frame)])
    assert lines[0] == lines[1]
