"""A segment of bare slave controllers, and short ways to send one datagram."""

import numpy as np

from servogym.drive.ethercat.controller.eeprom import checksum
from servogym.drive.ethercat.frame import Command, Datagram, logical, pack, unpack
from servogym.drive.ethercat.segment import Segment

FIRST_STATION = 0x1001


def bare_sii(alias=0, size=256):
    """A SII image with its configuration area and no more."""
    words = np.full(size, 0xFF, np.uint8)
    words[:16] = 0
    words[8:10] = alias & 0xFF, alias >> 8
    words[14] = checksum(words)
    return words.tobytes()


class Bare:
    """A station without services: nobody reads AL Control, no mailbox is taken."""

    drive = None

    def __init__(self, alias=0, esc=None):
        self.sii = bare_sii(alias)
        self.esc = esc or {}
        self.seen = []

    def attach(self, pdi, image):
        self.pdi, self.image = pdi, image

    def serve(self, events, now):
        self.seen.append(events)

    def power_on(self):
        self.seen.clear()

    def snapshot(self):
        return b""

    def restore(self, snapshot):
        pass


def bare(n=1, **arguments):
    return Segment([Bare() for _ in range(n)], **arguments)


def send(segment, *datagrams, now=0, port=0):
    """Datagrams as they come back; None where nothing does."""
    frame = segment.exchange(pack(datagrams), now, port)
    return None if frame is None else unpack(frame)


def one(segment, command, adp, ado, data, now=0):
    return send(segment, Datagram(command, adp, ado, bytes(data)), now=now)[0]


def fprd(segment, slave, address, size, now=0):
    return one(segment, Command.FPRD, FIRST_STATION + slave, address, bytes(size), now)


def fpwr(segment, slave, address, data, now=0):
    return one(segment, Command.FPWR, FIRST_STATION + slave, address, data, now)


def log(segment, command, address, data, now=0):
    return send(segment, logical(command, address, bytes(data)), now=now)[0]


def addressed(segment):
    """Give the slaves station addresses 1001h, 1002h, ..."""
    for i in range(len(segment)):
        one(segment, Command.APWR, -i & 0xFFFF, 0x0010, (FIRST_STATION + i).to_bytes(2, "little"))
    return segment


def sync_manager(segment, slave, n, start, length, control):
    row = start.to_bytes(2, "little") + length.to_bytes(2, "little") + bytes([control, 0, 1, 0])
    assert fpwr(segment, slave, 0x0800 + 8 * n, row).wkc == 1


def fmmu(segment, slave, n, address, length, physical, kind, bits=(0, 7), bit=0):
    row = address.to_bytes(4, "little") + length.to_bytes(2, "little") + bytes(bits)
    row += physical.to_bytes(2, "little") + bytes([bit, kind, 1, 0, 0, 0])
    assert fpwr(segment, slave, 0x0600 + 16 * n, row).wkc == 1
