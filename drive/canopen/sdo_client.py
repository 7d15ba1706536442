"""The SDO client: reads and writes objects of a node through any port (CiA 301, SDO).

Transfers are expedited or segmented, which every node supports. Frames and time pass through a
`FramePort`, which may be an emulated node in the same process or a real bus.

If a frame is lost, the transfer is aborted and repeated, `ATTEMPTS` times in all. A repeated
download writes the same value again.
"""

import struct
from collections.abc import Callable
from typing import TypeVar

from ..master.errors import Timeout
from ..objects.abort import Abort, SdoAbort
from .frame import Base, Frame
from .port import FramePort

T = TypeVar("T")
ATTEMPTS = 3  # of a transfer, if a frame is lost
LOST = (Abort.TOGGLE_BIT, Abort.TIME_OUT)  # abort codes of either side for a lost frame


class SdoClient:
    """Uploads and downloads of one node's objects.

    Args:
        port: port of the bus.
        node_id: node-id of the server, 1..127.
        timeout: time-out of one request (s).
        attempts: number of attempts before `Timeout` is raised, 1 or more.

    Raises:
        ValueError: node-id or attempts out of range.
    """

    def __init__(
        self, port: FramePort, node_id: int, timeout: float = 1.0, attempts: int = ATTEMPTS
    ):
        if not (isinstance(attempts, int) and attempts >= 1):
            raise ValueError(f"attempts = {attempts!r}: give a whole number, 1 or more")
        if not 1 <= node_id <= 127:
            raise ValueError(f"node_id = {node_id} is out of range 1..127")
        self._port = port
        self._node_id = node_id
        self._timeout = timeout
        self._attempts = attempts
        self.silence = 0.0  # s, spent on transfers that were repeated

    def upload(self, index: int, subindex: int = 0) -> bytes:
        """Read an object's bytes. Raises SdoAbort if refused, Timeout without an answer."""
        return self._repeated(lambda: self._upload(index, subindex))

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object's bytes. Raises SdoAbort if refused, Timeout without an answer."""
        self._repeated(lambda: self._download(index, subindex, data))

    def _repeated(self, transfer: Callable[[], T]) -> T:
        """Perform a transfer, and repeat it if a frame was lost.

        Raises the last `Timeout` if no attempt was answered.
        """
        for _ in range(self._attempts - 1):
            begin = self._port.now()
            try:
                return transfer()
            except Timeout:
                self.silence += self._port.now() - begin
            except SdoAbort as aborted:
                if aborted.code not in LOST:
                    raise
        return transfer()

    def _upload(self, index: int, subindex: int) -> bytes:
        head = struct.pack("<HB", index, subindex)
        answer = self._initiate(b"\x40" + head + bytes(4), 0x40)
        if answer[0] & 2:  # expedited; without the size bit all four bytes are data
            return answer[4 : 8 - (answer[0] >> 2 & 3 if answer[0] & 1 else 0)]
        data, toggle = b"", 0
        while True:
            answer = self._segment(bytes([0x60 | toggle]) + bytes(7), 0x00, toggle, head)
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            if answer[0] & 1:
                return data
            toggle ^= 0x10

    def _download(self, index: int, subindex: int, data: bytes) -> None:
        head = struct.pack("<HB", index, subindex)
        if 1 <= len(data) <= 4:
            command = 0x23 | 4 - len(data) << 2
            self._initiate(bytes([command]) + head + data.ljust(4, b"\0"), 0x60)
            return
        self._initiate(b"\x21" + head + struct.pack("<I", len(data)), 0x60)
        toggle = 0
        for at in range(0, max(len(data), 1), 7):
            part = data[at : at + 7]
            command = toggle | 7 - len(part) << 1 | (at + 7 >= len(data))
            self._segment(bytes([command]) + part.ljust(7, b"\0"), 0x20, toggle, head)
            toggle ^= 0x10

    def _initiate(self, request: bytes, specifier: int) -> bytes:
        """Start a transfer; late answers, which name another object, are ignored."""
        head = request[1:4]
        return self._ask(request, specifier, head, lambda answer: answer[1:4] == head)

    def _segment(self, request: bytes, specifier: int, toggle: int, head: bytes) -> bytes:
        answer = self._ask(request, specifier, head, lambda answer: True)
        if answer[0] & 0x10 != toggle:
            self._give_up(Abort.TOGGLE_BIT, head)
            raise SdoAbort(Abort.TOGGLE_BIT, *_address(head))
        return answer

    def _ask(
        self, request: bytes, specifier: int, head: bytes, ours: Callable[[bytes], bool]
    ) -> bytes:
        end = self._port.now() + self._timeout
        frames = [Frame(Base.SDO_REQUEST + self._node_id, request)]
        while True:
            answers = [
                frame.data
                for frame in self._port.exchange(frames)
                if frame.id == Base.SDO_RESPONSE + self._node_id and len(frame.data) == 8
            ]
            frames = []
            for answer in answers:
                if answer[0] == 0x80 and answer[1:4] == head:
                    raise SdoAbort(struct.unpack_from("<I", answer, 4)[0], *_address(head))
                if answer[0] & 0xE0 == specifier and ours(answer):
                    return answer
            if self._port.now() >= end:
                self._give_up(Abort.TIME_OUT, head)
                index, subindex = _address(head)
                raise Timeout(
                    f"node {self._node_id}, SDO request for {index:04X}h:{subindex:02X}h",
                    f"no answer within {self._timeout:g} s"
                    + f", {self._attempts} times" * (self._attempts > 1),
                    "check its node-id, the bit rate, and that NMT has not stopped it",
                )

    def _give_up(self, code: Abort, head: bytes) -> None:
        """Abort the transfer at the server, as CiA 301 requires."""
        data = b"\x80" + head + struct.pack("<I", code)
        self._port.exchange([Frame(Base.SDO_REQUEST + self._node_id, data)])


def _address(head: bytes) -> tuple[int, int]:
    index, subindex = struct.unpack("<HB", head)
    return index, subindex
