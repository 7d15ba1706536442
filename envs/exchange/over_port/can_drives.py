"""Drives of an environment as nodes on a CAN bus."""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ....drive.canopen.frame import Base, Frame
from ....drive.canopen.node import NmtCommand
from ....drive.canopen.port import FramePort
from ....drive.canopen.remote import SYNC, CanOpenPort
from ....drive.master.errors import ServoError
from ....drive.model.model import DriveModel
from ....drive.objects.abort import SdoAbort
from .pace import Pace
from .side import WAITING_STEP, Limits, check_names

PDOS = 4  # of each direction with an identifier of their own (CiA 301, default connection set)
RPDO, TPDO = 0x200, 0x180  # identifiers of the first PDO, for node-id 0; the next are 100h apart
AT_ONCE, AT_SYNC = 255, 1  # transmission types of RPDOs and of TPDOs
OFF = 0x8000_0000  # bit of a COB-ID: this PDO does not exist
MASTER = 127  # node-id of this master
HEARTBEAT_PERIOD, HEARTBEAT_TIME_OUT = 0.02, 0.2  # s
HEARTBEAT = Frame(0x700 + MASTER, b"\x05")
LIFE_TIME_FACTOR = 4  # of node guarding: requests that may be missed
FIRST_FRAME = 2e-3  # s that an exchange waits for the first frame
SILENT = 2.0  # s without an answer, after which the clock runs on in lock-step as well
SYNC_INTERVAL = 4e-3  # s, the least between two SYNCs while a master waits


class _PacedBus:
    """A bus that adds the heartbeat of the master and limits the rate of SYNCs.

    Args:
        bus: the bus of the drives.
        real: whether time passes by itself; else each SYNC makes it pass.
    """

    def __init__(self, bus: FramePort, real: bool):
        self._bus, self._real = bus, real
        self._next_heartbeat = self._last_sync = 0.0
        self._syncs = 0
        self.silent = not real  # hold SYNCs back, so no time passes, until an episode begins
        self.answers: set[int] = set()  # identifiers of the frames that answer a SYNC
        self._owed: set[int] = set()  # those that have not answered the latest SYNC yet
        self._quiet = 0.0  # s since the last answer
        self._unanswered = 0.0  # s spent waiting in vain, which pass in lock-step as well
        self.guarded: list[int] = []  # node-ids whose state is requested (node guarding)

    def now(self) -> float:
        """Return the time (s); in lock-step that of the SYNCs.

        A drive acts on a command after a number of cycles, not of seconds. A master that waits for
        an answer that never arrives must still give up, so time runs on after `SILENT`.
        """
        if self._real:
            return self._bus.now()
        return self._syncs * WAITING_STEP + self._unanswered

    def wait(self, seconds: float = FIRST_FRAME) -> None:
        """Set how long an exchange waits for its first frame (s)."""
        if hasattr(self._bus, "patience"):
            self._bus.patience = seconds

    def sync_now(self) -> None:
        """Let the next SYNC pass, however recent the last one is."""
        self._last_sync = -math.inf

    def exchange(self, frames: Iterable[Frame]) -> Iterable[Frame]:
        """Send frames with what is due and return those that arrive."""
        now, sent = self.now(), [*frames]
        if now >= self._next_heartbeat or (not self._real and SYNC in sent):
            self._next_heartbeat = now + HEARTBEAT_PERIOD
            asked = [Frame(0x700 + node_id, b"", remote=True) for node_id in self.guarded]
            sent[:0] = [HEARTBEAT, *asked]
        # a waiting master exchanges as fast as the bus returns frames
        if self.silent or (self._real and now < self._last_sync + SYNC_INTERVAL):
            sent = [frame for frame in sent if frame != SYNC]
        if SYNC in sent:
            self._syncs += 1
            self._last_sync = now
            self._owed = set() if self._real else set(self.answers)
        received = self._exchanged(sent)
        while self._owed and self._quiet <= SILENT:
            received += self._exchanged([])
        return received

    def _exchanged(self, frames: Iterable[Frame]) -> list[Frame]:
        """Exchange once and record how long the bus has been quiet.

        While answers are owed, only these end the silence; else any frame does.
        """
        begin = self._bus.now()
        received = [*self._bus.exchange(frames)]
        passed = self._bus.now() - begin
        came = {frame.id for frame in received}
        heard = self._owed & came if self._owed else came
        self._owed -= came
        self._quiet = 0.0 if heard else self._quiet + passed
        if self._quiet > SILENT or self.silent:
            self._unanswered += passed
        return received


class CanDrives:
    """Nodes on a CAN bus on which this side produces the SYNC.

    Args:
        bus: the connection to it, such as `servogym.drive.wire.bus.CanPort`.
        nodes: node-id by the name of the drive in the task's machine.
        model: model of the drives.
        envelopes: guard limits by drive, all or some by name; the drive supplies the others.
        pace: the clock; real time if not given.
    """

    def __init__(
        self,
        bus: FramePort,
        nodes: Mapping[str, int],
        model: str | Path | DriveModel = "generic",
        *,
        envelopes: Limits | None = None,
        pace: Pace | None = None,
    ):
        self.envelopes, self.pace = dict(envelopes or {}), pace or Pace()
        self._bus = _PacedBus(bus, self.pace.real)
        self.port = CanOpenPort(self._bus, nodes, model)

    def trouble(self) -> str:
        """Name the nodes whose TPDOs wait for another SYNC than ours (1005h)."""
        said = []
        for axis, node in self.port.nodes.items():
            with suppress(ServoError, SdoAbort):
                awaited = int.from_bytes(node.sdo.upload(0x1005, 0), "little") & 0x7FF
                if awaited != Base.SYNC:
                    said.append(f"; {axis} waits for the SYNC {awaited:X}h (1005h): set it to "
                                f"{Base.SYNC:X}h")
        return "".join(said)

    def awake(self) -> None:
        """Send SYNCs from now on, and return nodes that have left OPERATIONAL to it."""
        self._bus.silent = False
        for node in self.port.nodes.values():
            node.nmt(NmtCommand.START)

    def connect(
        self, axes: Sequence[str], rpdos: Sequence[Sequence[str]], tpdos: Sequence[Sequence[str]]
    ) -> None:
        """See `DriveSide`. Raises ValueError for other drives, SdoAbort where one refuses."""
        check_names(axes, self.port.nodes)
        self._bus.answers = set()
        for axis in axes:
            node = self.port.nodes[axis]
            node.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
            for first, mapping, base, kind, lists in (
                (0x1400, 0x1600, RPDO, AT_ONCE, rpdos),
                (0x1800, 0x1A00, TPDO, AT_SYNC, tpdos),
            ):
                if len(lists) > PDOS:
                    raise ValueError(f"{len(lists)} PDOs are needed, {PDOS} have identifiers")
                for n in range(PDOS):
                    names = lists[n] if n < len(lists) else []
                    cob_id = base + 0x100 * n + node.node_id
                    self._map(node, first + n, mapping + n, cob_id, kind, names)
            node.use_pdos()
        self._bus.answers = {pdo.cob_id for pdo in self._tpdos()}

    def _tpdos(self) -> list[Any]:
        return [pdo for node in self.port.nodes.values() for pdo in node.tpdos]

    def _map(
        self, node: Any, communication: int, mapping: int, cob_id: int, kind: int,
        names: Sequence[str],
    ) -> None:
        try:
            _put(node, communication, 1, OFF | cob_id, 4)
        except SdoAbort:
            if names:
                raise
            return  # the drive has fewer PDOs, and the task does not need this one
        if names:
            _put(node, mapping, 0, 0, 1)
            model = next(iter(self.port.models.values()))
            for n, name in enumerate(names, 1):
                row = model.number(name)
                _put(node, mapping, n, row.index << 16 | row.subindex << 8 | 8 * row.size, 4)
            _put(node, mapping, 0, len(names), 1)
            _put(node, communication, 2, kind, 1)
            _put(node, communication, 1, cob_id, 4)

    def arm(self, on: bool) -> list[str]:
        """Set up a consumer of the master's heartbeat (1016h), or node guarding (100Ch, 100Dh).

        Object 6007h of the drive selects its reaction when these stop.
        """
        self._bus.guarded = []
        return [axis for axis, node in self.port.nodes.items() if not self._watches(node, on)]

    def _watches(self, node: Any, on: bool) -> bool:
        if _taken(node, 0x1016, 1, MASTER << 16 | round(1e3 * HEARTBEAT_TIME_OUT) if on else 0, 4):
            return True
        guard_time = round(1e3 * HEARTBEAT_TIME_OUT / LIFE_TIME_FACTOR) if on else 0
        factor = LIFE_TIME_FACTOR if on else 0
        if _taken(node, 0x100C, 0, guard_time, 2) and _taken(node, 0x100D, 0, factor, 1):
            self._bus.guarded += [node.node_id] if on else []
            return True
        return False

    def send(self) -> None:
        """See `DriveSide`."""
        self._bus.wait(0.0)
        self.port.exchange(sync=False)
        self._bus.wait()

    def sample(self, patience: float) -> bool:
        """See `DriveSide`."""
        pdos = self._tpdos()
        self._bus.wait(0.0)
        self.port.exchange(sync=False)  # late answers to the last step do not count for this one
        for pdo in pdos:
            pdo.heard = False
        end = self.port.now() + patience
        self._bus.wait(patience)
        self._bus.sync_now()
        self.port.exchange()
        while not all(pdo.heard for pdo in pdos) and (left := end - self.port.now()) > 0.0:
            self._bus.wait(left)
            self.port.exchange(sync=False)
        self._bus.wait()
        return all(pdo.heard for pdo in pdos)


def _put(node: Any, index: int, subindex: int, value: int, size: int) -> None:
    """Write a number of `size` bytes by SDO. Raises SdoAbort."""
    node.sdo.download(index, subindex, value.to_bytes(size, "little"))


def _taken(node: Any, index: int, subindex: int, value: int, size: int) -> bool:
    """Write a number by SDO; -> whether the drive accepts it and reads it back."""
    with suppress(SdoAbort):
        _put(node, index, subindex, value, size)
        return bool(node.sdo.upload(index, subindex)[:size] == value.to_bytes(size, "little"))
    return False
