"""Ethernet ports for EtherCAT: raw sockets bound to an interface, and UDP port 88A4h.

A port reads a frame into the segment's own buffer and sends it from there.
"""

import errno
import os
import shutil
import socket
import struct
import sys
import time
from pathlib import Path

from ..ethercat.frame import ETHERTYPE, UDP_PORT

AWAKE = 60_000  # ns of polling after a frame, because a sleeping core takes 20 to 50 µs to wake
HEADER = bytes.fromhex("ffffffffffff 010101010101 88a4")  # precedes the payload of UDP
WAIT = struct.pack("ll", 0, 1000)  # time-out of a read (SO_RCVTIMEO: s, µs)


def _wait(port: socket.socket) -> None:
    """Let `recv_into` wait in the kernel, which takes one system call less than `settimeout`."""
    port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, WAIT)


class RawPort:
    """A network interface for Ethernet frames of type 88A4h (Linux).

    Args:
        interface: name, such as ``eth0``.
        otherwise: see `raw_socket`.

    Raises:
        ValueError: the interface does not exist, is not permitted or is served already, or the
            system has no raw sockets; the message states the remedy.
    """

    def __init__(self, interface: str, otherwise: str = ""):
        self.socket = raw_socket(interface, otherwise=otherwise)
        self._lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:  # abstract: of this network namespace, and gone with the process
            self._lock.bind(f"\0servogym ethercat {interface}")
        except OSError:
            self.close()
            raise ValueError(
                f"interface {interface} is served already: is another `servogym ethercat` running?"
            ) from None
        _wait(self.socket)
        self.name, self._awake = interface, 0

    def receive(self, buffer: memoryview) -> int:
        """Read a frame; -> its length, 0 if none has arrived."""
        try:
            length = self._look(buffer) or self.socket.recv_into(buffer)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise ValueError(_why(self.name, error)) from None
        self._awake = time.perf_counter_ns() + AWAKE
        return length

    def _look(self, buffer: memoryview) -> int:
        """Poll for the next frame without sleeping, for `AWAKE` after the last one."""
        while time.perf_counter_ns() < self._awake:
            try:
                return self.socket.recv_into(buffer, 0, socket.MSG_DONTWAIT)
            except BlockingIOError:
                os.sched_yield()  # the sender may need the core
        return 0

    def send(self, frame: memoryview) -> None:
        """Send a frame; it is lost, as on a cable, if the interface's queue is full."""
        try:
            self.socket.send(frame)
        except OSError as error:
            if error.errno not in (errno.ENOBUFS, errno.EAGAIN):
                raise ValueError(_why(self.name, error)) from None

    def close(self) -> None:
        """Release the interface."""
        self.socket.close()
        self._lock.close()


class UdpPort:
    """UDP port 88A4h: EtherCAT without raw sockets (ETG.1000.4, annex).

    Args:
        address: address to listen on.

    Raises:
        ValueError: the address cannot be used.
    """

    def __init__(self, address: str = "127.0.0.1"):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.bind((address, UDP_PORT))
        except OSError as error:
            self.socket.close()
            raise ValueError(f"--udp {address}: port {UDP_PORT}: {error.strerror}; is another "
                             "`servogym ethercat` running?") from None
        _wait(self.socket)
        self.name = f"udp {address}:{self.socket.getsockname()[1]}"
        self._from: tuple[str, int] = "", 0

    def receive(self, buffer: memoryview) -> int:
        """Read a frame and prepend an Ethernet header; -> its length, 0 if none has arrived."""
        try:
            length, self._from = self.socket.recvfrom_into(buffer[len(HEADER) :])
        except BlockingIOError:
            return 0
        buffer[: len(HEADER)] = HEADER
        return length + len(HEADER)

    def send(self, frame: memoryview) -> None:
        """Send a frame to the last sender."""
        self.socket.sendto(frame[len(HEADER) :], self._from)

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


def raw_socket(interface: str, kind: int = ETHERTYPE, otherwise: str = "") -> socket.socket:
    """Open a raw socket at a network interface for frames of a type (Linux).

    Args:
        interface: name, such as ``eth0``.
        kind: EtherType.
        otherwise: what the caller can do without raw sockets, added to the remedies.

    Raises:
        ValueError: no raw sockets, no permission for them or no such interface; with the remedy.
    """
    if not hasattr(socket, "AF_PACKET"):
        raise ValueError(f"{sys.platform} has no raw sockets")
    try:
        opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(kind))
    except PermissionError:
        remedies = [
            f"sudo setcap cap_net_raw+ep {Path(sys.executable).resolve()}", "run it with sudo",
        ]
        if otherwise:
            remedies.append(otherwise)
        if shutil.which("unshare"):
            remedies.append("try it without a network: unshare -Urn")
        raise ValueError(
            f"interface {interface}: raw sockets need the capability CAP_NET_RAW: "
            f"{', or '.join(remedies)}"
        ) from None
    try:
        opened.bind((interface, kind))
    except OSError as error:
        opened.close()
        raise ValueError(_why(interface, error)) from None
    return opened


def _why(interface: str, error: OSError) -> str:
    if error.errno == errno.ENODEV:
        known = ", ".join(name for _, name in socket.if_nameindex())
        return f"interface {interface} does not exist: choose one of {known}"
    if error.errno == errno.ENETDOWN:
        return f"interface {interface} is down: sudo ip link set {interface} up"
    return f"interface {interface}: {error.strerror}"
