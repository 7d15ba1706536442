"""Recordings of foreign masters with our AKD, as text: what each sent and what came back.

They were recorded by ``servogym ethercat --drive kollmorgen_akd --axis none --log`` on the wire and
are replayed in memory. A line is a frame from its EtherCAT type on, requests and replies by turns;
``(N)`` are N bytes of 0, zeros at the end are left out. An exchange that is the same as one of the
few before but for the index (a poll, the 10,000 FRMW of ethercrab) is there once.

    python -m golden.recordings NAME CAPTURE.pcapng   # a new one
    python -m golden.recordings NAME                  # the replies of today, to the same requests
"""

import re
import sys
from collections import deque
from pathlib import Path

from servogym.drive.drive import Drive
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.frame import Command, unpack
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.wire import pcapng

HERE = Path(__file__).parent
MASTERS = {
    "soem": "pysoem 1.1.13, tests/interop/pysoem_master.py",
    "ethercrab": "ethercrab 0.7.1, tests/interop/ethercrab",
    "kickcat": "KickCAT 2.5, tests/interop/kickcat_master.py",
}
ADDRESSES = bytes.fromhex("ffffffffffff 020000000000")
SHORTEST = 60
WRITES = Command.APWR, Command.FPWR, Command.BWR


def file_of(name):
    return HERE / f"recording_{name}.txt"


def read(name):
    """Pairs of a request and its reply."""
    lines = [
        line for line in file_of(name).read_text("utf-8").splitlines() if not line.startswith("#")
    ]
    frames = [
        bytes.fromhex(re.sub(r"\((\d+)\)", lambda found: "00" * int(found[1]), line))
        for line in lines
    ]
    return list(zip(frames[::2], frames[1::2], strict=True))


def replayed(requests):
    """What comes back of each."""
    bus = Bus(Segment([Slave(Drive("kollmorgen_akd", bus="ethercat"))]))
    for request in requests:
        length = int.from_bytes(request[2:4].ljust(2, b"\0"), "little") & 0x7FF
        reply = bus.exchange(ADDRESSES + request.ljust(max(length + 4, SHORTEST - 12), b"\0"))
        yield b"" if reply is None else reply[12:].rstrip(b"\0")


def write(name, pairs):
    lines = [f"# {MASTERS[name]}, from INIT to OP and cycles; see recordings.py"]
    for frame in (frame for pair in pairs for frame in pair):
        text = frame.rstrip(b"\0").hex(" ")
        text = re.sub(r"(00 ){5,}", lambda found: f"({len(found[0]) // 3}) ", text)
        lines.append(text.replace(" ", ""))
    file_of(name).write_text("\n".join(lines) + "\n", "utf-8")


def taken(capture):
    """The exchanges of a capture, without those that are told already."""
    frames = [packet.frame for packet in pcapng.read(capture)]
    told: deque = deque(maxlen=8)
    for request, reply in zip(frames[::2], frames[1::2], strict=True):
        rows = [[row._replace(index=0) for row in unpack(frame)] for frame in (request, reply)]
        if rows not in told or rows[0][0].command in WRITES:
            yield request[12:], reply[12:]
            told.append(rows)


if __name__ == "__main__":
    master, *captures = sys.argv[1:]
    if captures:
        write(master, taken(captures[0]))
    else:
        sent = [request for request, _ in read(master)]
        write(master, zip(sent, replayed(sent), strict=True))
