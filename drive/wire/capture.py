"""A capture of the frames at a network interface, while another program sends and receives them."""

import socket
import threading
import time
from pathlib import Path

from ..ethercat.frame import ETHERTYPE
from .ethernet import raw_socket
from .pcapng import Writer

ALL = 0x0003  # ETH_P_ALL: what goes out is seen by no other kind of socket
FRAME = 2048  # bytes
WAIT = 0.2  # s, between two looks whether it is to end
STAMPS = 35  # SO_TIMESTAMPNS


class Capture:
    """All EtherCAT frames at an interface, in both directions (Linux).

    Args:
        interface: name, such as ``eth0``.
        file: the capture, .pcapng.

    Raises:
        ValueError: no such interface, or no right to raw sockets, with the remedy.
    """

    def __init__(self, interface: str, file: str | Path):
        self._socket = raw_socket(interface, ALL)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, STAMPS, 1)
            self._socket.settimeout(WAIT)
            self._writer = Writer(file, (interface,))
        except BaseException:
            self._socket.close()
            raise
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="capture", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                frame, ancillary, *_ = self._socket.recvmsg(FRAME, 64)
            except TimeoutError:
                self._writer.flush()
                continue
            except OSError:
                return
            if frame[12:14] == ETHERTYPE.to_bytes(2, "big"):
                self._writer.write(frame, _stamp(ancillary))

    def close(self) -> None:
        """Finish the file."""
        self._ended.set()
        self._thread.join(2 * WAIT)
        self._socket.close()
        self._writer.close()


def _stamp(ancillary: list[tuple[int, int, bytes]]) -> int:
    """The time at which the kernel received a frame (ns)."""
    for level, kind, data in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, STAMPS):
            seconds, ns = (int.from_bytes(data[i : i + 8], "little") for i in (0, 8))
            return seconds * 1_000_000_000 + ns
    return time.time_ns()
