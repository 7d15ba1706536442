"""A CANopen node around one drive: NMT, SDO, PDO, SYNC, EMCY, heartbeat, guarding (CiA 301).

No input or output of its own: `receive` takes frames, `poll` gives them, and time (µs, an integer)
is an argument of both. Whoever owns the node moves the frames and lets the drive's cycles pass.
"""

import struct
from enum import IntEnum

from ..drive import Drive
from .frame import Base, Frame
from .pdo import Receiver, Transmitter
from .sdo import SdoServer

QUEUE = 1024  # frames; a node whose owner does not poll loses the oldest


class NmtState(IntEnum):
    """NMT states as heartbeat and guarding report them."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """NMT node control commands."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


_TARGET = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


class Node:
    """A drive on a CAN bus.

    Args:
        drive: the drive; its `node_id` is the node's.
    """

    def __init__(self, drive: Drive):
        self.drive = drive
        self.node_id = drive.node_id
        self._out: list[Frame] = []
        self._sdo = SdoServer(
            drive.objects, lambda data: self._send(Base.SDO_RESPONSE + self.node_id, data)
        )
        self._receiver = Receiver(drive)
        self._transmitters = [Transmitter(drive, n) for n in range(len(drive.tpdos))]
        self._boot()

    def _boot(self) -> None:
        """Reset: all services anew, boot-up message, PRE-OPERATIONAL."""
        self._sdo.reset()
        self._receiver.forget()
        self.state = NmtState.INITIALISING
        self._guard_toggle = 0
        self._guarded_at: int | None = None
        self._heartbeat_at: int | None = None
        self._heard: dict[int, int] = {}  # node-id -> time of its last heartbeat
        self._errors = int(self.drive.axis.error_events)
        self._emcy_at = -(1 << 62)
        self._error_free = True
        self.drive.axis.connection_lost = 0
        self._send(Base.ERROR_CONTROL + self.node_id, b"\0")
        self._enter(NmtState.PRE_OPERATIONAL)

    def _enter(self, state: NmtState) -> None:
        if state == NmtState.OPERATIONAL and self.state != state:
            for transmitter in self._transmitters:
                transmitter.start()
        if state != NmtState.OPERATIONAL:
            self._receiver.forget()
        if state == NmtState.STOPPED:
            self._sdo.reset()
        self.state = state

    def _send(self, identifier: int, data: bytes) -> None:
        self._out.append(Frame(identifier, data))
        if len(self._out) > QUEUE:
            del self._out[0]

    def _object(self, index: int, subindex: int = 0) -> int:
        """Value of a communication object, 0 where the model does not have it."""
        slot = self.drive.objects.slots.get((index, subindex))
        return int(slot.get()) if slot else 0

    # -------------------------------------------------------------- receive

    def receive(self, frame: Frame, time: int) -> None:
        """Take a frame at `time` (µs); what is not for this node, or senseless, is ignored."""
        if frame.extended or len(frame.data) > 8:
            return
        if frame.remote:
            self._remote(frame, time)
        elif frame.id == Base.NMT:
            self._nmt(frame.data)
        elif self.state == NmtState.STOPPED:
            self._hear(frame, time)
        elif frame.id == self._object(0x1005) & 0x7FF:
            self._sync(frame.data, time)
        elif frame.id == Base.SDO_REQUEST + self.node_id:
            if len(frame.data) == 8:
                self._sdo.request(frame.data, time)
        elif self.state == NmtState.OPERATIONAL and self._receiver.receive(frame):
            pass
        else:
            self._hear(frame, time)

    def _nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        if data[0] == NmtCommand.RESET_NODE:
            self.drive.reset()
            self._boot()
        elif data[0] == NmtCommand.RESET_COMMUNICATION:
            self.drive.reset_communication()
            self._boot()
        elif data[0] in _TARGET:
            self._enter(_TARGET[NmtCommand(data[0])])

    def _sync(self, data: bytes, time: int) -> None:
        if self.state != NmtState.OPERATIONAL or len(data) > 1:
            return
        self._receiver.sync()
        counter = data[0] if data else 0
        self._out += [f for t in self._transmitters if (f := t.sync(counter, time))]

    def _remote(self, frame: Frame, time: int) -> None:
        if frame.id == Base.ERROR_CONTROL + self.node_id:
            self._guarded_at = time
            self._send(frame.id, bytes([self._guard_toggle | self.state]))
            self._guard_toggle ^= 0x80
        elif self.state == NmtState.OPERATIONAL:
            self._out += [f for t in self._transmitters if (f := t.request(frame, time))]

    def _hear(self, frame: Frame, time: int) -> None:
        """Heartbeat of another node."""
        node = frame.id - Base.ERROR_CONTROL
        if 1 <= node <= 127 and len(frame.data) == 1:
            self._heard[node] = time
            self.drive.axis.connection_lost = 0

    # ----------------------------------------------------------------- poll

    def poll(self, time: int) -> list[Frame]:
        """Frames to send at `time` (µs), in their order."""
        self._sdo.poll(time)
        self._watch(time)
        self._emergency(time)
        self._heartbeat(time)
        if self.state == NmtState.OPERATIONAL:
            self._out += [f for t in self._transmitters if (f := t.poll(time))]
        frames, self._out = self._out, []
        return frames

    def _heartbeat(self, time: int) -> None:
        period = self._object(0x1017) * 1000
        if not period:
            self._heartbeat_at = None
        elif self._heartbeat_at is None or time - self._heartbeat_at >= period:
            self._heartbeat_at = time
            self._send(Base.ERROR_CONTROL + self.node_id, bytes([self.state]))

    def _watch(self, time: int) -> None:
        """Heartbeat consumer 1016h and life guarding 100Ch, 100Dh; what happens: 1029h, 6007h."""
        consumer = self._object(0x1016, 1)
        node, limit = consumer >> 16 & 0x7F, (consumer & 0xFFFF) * 1000
        lost = bool(limit) and node in self._heard and time - self._heard[node] > limit
        if lost:
            del self._heard[node]
        life = self._object(0x100C) * self._object(0x100D) * 1000
        if life and self._guarded_at is not None and time - self._guarded_at > life:
            self._guarded_at, lost = None, True
        if lost:
            self.drive.axis.connection_lost = 1
            if self.state == NmtState.OPERATIONAL and self._object(0x1029, 1) == 0:
                self._enter(NmtState.PRE_OPERATIONAL)

    def _emergency(self, time: int) -> None:
        """EMCY of a new fault or warning, and of the return to no error (1014h, 1015h)."""
        axis = self.drive.axis
        if self.state == NmtState.STOPPED or time - self._emcy_at < self._object(0x1015) * 100:
            return
        events, register = int(axis.error_events), int(axis.od.error_register)
        if events != self._errors:
            self._errors, self._error_free = events, False
            code = int(axis.od.error_code)
        elif register == 0 and not self._error_free:
            self._error_free, code = True, 0
        else:
            return
        self._emcy_at = time
        if not self._object(0x1014) & 0x8000_0000:
            self._send(self._object(0x1014) & 0x7FF, struct.pack("<HB5x", code, register))
