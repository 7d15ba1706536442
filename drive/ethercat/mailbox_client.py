"""The master's side of a mailbox: telegrams and SDO transfers of one slave (ETG.1000.6, 5.6).

Emergencies are kept in a list. Lost frames are sent again; lost answers are requested again by the
repeat request of sync manager 1.
"""

import struct
from typing import Protocol

from ..model.given import octets, whole
from ..objects.abort import Abort, SdoAbort
from .coe_header import Service, header
from .controller.registers import FULL, REPEAT, R
from .frame import Command, Datagram
from .mailbox import HEADER, Kind, pack

POLLS = 200  # reads of the mailbox before a transfer is given up


class MailboxError(ValueError):
    """The slave has answered a telegram with a mailbox error."""

    def __init__(self, detail: int, station: int):
        super().__init__(f"mailbox error {detail} of slave {station:04X}h")
        self.detail = detail


class Sender(Protocol):
    """Sends datagrams, and repeats lost frames."""

    def send(self, *datagrams: Datagram) -> list[Datagram]:
        """Send datagrams; -> the datagrams that return. Raises TimeoutError."""


class MailboxClient:
    """The mailbox of the slave at a station address.

    Args:
        sender: sends datagrams to the segment.
        station: station address.
        out: start and length of sync manager 0.
        into: start and length of sync manager 1.
        polls: number of reads of the mailbox before giving up.
    """

    def __init__(
        self, sender: Sender, station: int, out: tuple[int, int], into: tuple[int, int],
        polls: int = POLLS,
    ):
        self._sender = sender
        self._station = station
        self._out, self._in, self._polls = out, into, polls
        self._counter = 0
        self.emergencies: list[bytes] = []

    def _read(self, address: int, size: int) -> Datagram:
        return self._sender.send(Datagram(Command.FPRD, self._station, address, bytes(size)))[0]

    # ------------------------------------------------------------- telegrams

    def ask(self, kind: int, body: bytes) -> bytes:
        """Send a telegram and wait for its answer; -> the body.

        Raises:
            TimeoutError: the mailbox stays full or empty.
            MailboxError: the slave answers with a mailbox error.
        """
        self.tell(kind, body)
        return self.next(kind)

    def tell(self, kind: int, body: bytes) -> None:
        """Send a telegram. Raises TimeoutError if the mailbox stays full."""
        self._counter = self._counter % 7 + 1
        telegram = pack(kind, body, self._counter).ljust(self._out[1], b"\0")
        for _ in range(self._polls):
            request = Datagram(Command.FPWR, self._station, self._out[0], telegram)
            if self._sender.send(request)[0].wkc:
                return
            self._take()  # it is full because an answer waits
        raise TimeoutError(f"slave {self._station:04X}h does not empty its mailbox")

    def next(self, kind: int) -> bytes:
        """Return the next telegram of a type; errors as for `ask`."""
        for poll in range(self._polls):
            found = self._take()
            if found is not None and found[0] == kind:
                return found[1]
            if found is not None and found[0] == Kind.ERROR:
                raise MailboxError(int.from_bytes(found[1][2:4], "little"), self._station)
            if poll == self._polls // 2:
                self._ask_again()
        raise TimeoutError(f"slave {self._station:04X}h does not answer in its mailbox")

    def waiting(self) -> bytes:
        """Return the body of a waiting telegram; empty if there is none."""
        found = self._take()
        return b"" if found is None else found[1]

    def _take(self) -> tuple[int, bytes] | None:
        """Read sync manager 1 and set emergencies aside."""
        if not self._read(R.SYNC_MANAGER + 8 + 5, 1).data[0] & FULL:
            return None
        reply = self._read(self._in[0], self._in[1])
        if not reply.wkc:
            return None
        length, _, _, kind = HEADER.unpack_from(reply.data)
        body = reply.data[HEADER.size : HEADER.size + length]
        if kind & 15 == Kind.COE and len(body) > 1 and body[1] >> 4 == Service.EMERGENCY:
            self.emergencies.append(body[2:10])
            return None
        return kind & 15, body

    def _ask_again(self) -> None:
        """Toggle the repeat request, because a reply may have been lost."""
        at = R.SYNC_MANAGER + 8 + 6
        activate = self._read(at, 1).data[0] ^ REPEAT
        self._sender.send(Datagram(Command.FPWR, self._station, at, bytes([activate])))

    # ------------------------------------------------------------------- SDO

    def _sdo(self, body: bytes, index: int, subindex: int) -> bytes:
        """Send a CoE telegram; -> the answer without its header. Raises SdoAbort."""
        answer = self.ask(Kind.COE, header(Service.SDO_REQUEST) + body)[2:]
        if len(answer) < 8:
            raise SdoAbort(Abort.GENERAL, index, subindex, "the answer is too short")
        if answer[0] >> 5 == 4:
            (code,) = struct.unpack_from("<I", answer, 4)
            raise SdoAbort(code, index, subindex)
        return answer

    def upload(self, index: int, subindex: int = 0, *, complete: bool = False) -> bytes:
        """Read the bytes of an object.

        Raises:
            SdoAbort: the drive refuses. ValueError: index or sub-index out of range.
        """
        _check(index, subindex)
        body = struct.pack("<BHB4x", 0x50 if complete else 0x40, index, subindex)
        answer = self._sdo(body, index, subindex)
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        (size,) = struct.unpack_from("<I", answer, 4)
        data, toggle = answer[8 : 8 + size], 0
        while len(data) < size:
            answer = self._sdo(struct.pack("<B7x", 0x60 | toggle), index, subindex)
            if answer[0] & 0x10 != toggle:
                raise SdoAbort(Abort.TOGGLE_BIT, index, subindex)
            part = answer[1:]
            data += part[: 7 - (answer[0] >> 1 & 7)] if len(part) == 7 else part
            toggle ^= 0x10
        return data

    def download(self, index: int, subindex: int, data: bytes, *, complete: bool = False) -> None:
        """Write an object.

        Raises:
            SdoAbort: the drive refuses. ValueError: index or sub-index out of range, not bytes.
        """
        _check(index, subindex)
        data = bytes(octets("data", data))
        if len(data) <= 4 and not complete:
            command = 0x23 | (4 - len(data)) << 2
            self._sdo(struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0"),
                      index, subindex)
            return
        room = self._out[1] - HEADER.size - 10
        head = struct.pack("<BHBI", 0x31 if complete else 0x21, index, subindex, len(data))
        self._sdo(head + data[:room], index, subindex)
        at, toggle = room, 0
        while at < len(data):
            part = data[at : at + self._out[1] - HEADER.size - 3]
            at += len(part)
            unused = max(7 - len(part), 0)
            command = toggle | unused << 1 | (at >= len(data))
            self._sdo(bytes([command]) + part.ljust(7, b"\0"), index, subindex)
            toggle ^= 0x10


def _check(index: int, subindex: int) -> None:
    """Raise ValueError if index or sub-index is out of range."""
    whole("index", index, 0, 0xFFFF)
    whole("subindex", subindex, 0, 0xFF)
