"""A small EtherCAT master: scan, mapping, states, SDO, process data, distributed clocks.

>>> master = EtherCatMaster(bus)
>>> for slave in master.scan():
...     print(slave.description.name)
>>> master.to_op()
>>> master.cycle()

It sends frames to anything with `exchange`: a `Bus`, a bare `Segment`, or one with faults. Without
an answer it raises TimeoutError, for a refused state RuntimeError with the slave's code.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

from ..model.given import whole
from . import clocks, sii
from .al import ACKNOWLEDGE, ERROR, AlState, AlStatusCode
from .controller.registers import R
from .description import Description
from .frame import MOST, Command, Datagram, logical, pack, unpack
from .mailbox_client import MailboxClient
from .port import ASSIGNMENTS, SlaveSide

FIRST_STATION = 0x1001
LOGICAL_START = 0x10000
RETRIES = 3
POLLS = 1000
COE = 4  # bit of word 1Ch of the SII


class Wire(Protocol):
    """The connection to a segment."""

    def exchange(self, frame: bytes, now: int = 0) -> bytes | None:
        """Send a frame; -> the frame that returns, None if it is lost."""


class RemoteSlave(SlaveSide):
    """A slave that the master has found."""

    def __init__(self, master: "EtherCatMaster", position: int, station: int | None = None):
        self.position = position
        self.station = FIRST_STATION + position if station is None else station
        self._master = master
        self.description: Description = sii.unpack(self.read_sii())
        mailbox = self.description.mailbox
        self.mailbox = MailboxClient(
            master, self.station, (mailbox.out_start, mailbox.out_length),
            (mailbox.in_start, mailbox.in_length),
        )
        self.outputs = bytearray()
        self.inputs = b""

    def read(self, address: int, size: int) -> bytes:
        """Read registers. Raises TimeoutError if the slave does not answer."""
        reply = self._master.send(Datagram(Command.FPRD, self.station, address, bytes(size)))[0]
        if not reply.wkc:
            raise TimeoutError(f"slave {self.position} does not answer at {address:04X}h")
        return reply.data

    def number(self, address: int, size: int) -> int:
        """Read a register as a number."""
        return int.from_bytes(self.read(address, size), "little")

    def write(self, address: int, data: bytes) -> bool:
        """Write registers; -> whether they were written."""
        row = Datagram(Command.FPWR, self.station, address, data)
        return self._master.send(row)[0].wkc == 1

    # -------------------------------------------------------------------- SII

    def read_words(self, word: int) -> bytes:
        """Read 4 or 8 bytes of the EEPROM."""
        self.write(R.EEPROM_ADDRESS, word.to_bytes(4, "little"))
        self.write(R.EEPROM_CONTROL, b"\0\1")
        status = self._eeprom_ready()
        return self.read(R.EEPROM_DATA, 8 if status & 0x40 else 4)

    def _eeprom_ready(self) -> int:
        for _ in range(POLLS):
            status = self.number(R.EEPROM_CONTROL, 2)
            if not status & 0x8000:
                return status
        raise TimeoutError(f"slave {self.position}: its EEPROM stays busy")

    # --------------------------------------------------------------- AL states

    @property
    def state(self) -> AlState:
        """State without the error bit."""
        return AlState(self.number(R.AL_STATUS, 2) & 0x0F)

    def request(self, state: AlState, *, acknowledge: bool = False) -> None:
        """Request a state and wait for it.

        Raises:
            RuntimeError: the slave refuses; the message has its AL status code.
        """
        self.write(R.AL_CONTROL, bytes([state | (ACKNOWLEDGE if acknowledge else 0), 0]))
        status = 0
        for _ in range(POLLS):
            status = self.number(R.AL_STATUS, 2)
            if status & ERROR or status & 0x0F == state:
                break
        if status & ERROR or status & 0x0F != state:
            code = self.number(R.AL_STATUS_CODE, 2)
            known = AlStatusCode(code).name if code in set(AlStatusCode) else "unknown"
            raise RuntimeError(
                f"slave {self.position} ({self.description.name}) does not go to {state.name}: "
                f"AL status {status:02X}h, code {code:04X}h {known}"
            )

    def recover(self) -> None:
        """Acknowledge an error by a request of the present state."""
        self.request(self.state, acknowledge=True)

    # ------------------------------------------------------------ configuration

    def sync_manager(self, n: int, start: int, length: int, control: int) -> None:
        """Configure and enable a sync manager, or disable it if the length is 0."""
        at = R.SYNC_MANAGER + 8 * n
        self.write(at + 6, b"\0")
        row = start.to_bytes(2, "little") + length.to_bytes(2, "little")
        self.write(at, row + bytes([control, 0, int(length > 0), 0]))

    def fmmu(self, n: int, address: int, length: int, physical: int, kind: int) -> None:
        """Map whole bytes; `kind` is 1 to read, 2 to write."""
        row = address.to_bytes(4, "little") + length.to_bytes(2, "little") + b"\0\7"
        row += physical.to_bytes(2, "little") + bytes([0, kind, int(length > 0), 0, 0, 0])
        self.write(R.FMMU + 16 * n, row)

    def open_mailbox(self) -> None:
        """Configure sync managers 0 and 1 as stated in the SII."""
        managers, box = self.description.sync_managers, self.description.mailbox
        self.sync_manager(0, box.out_start, box.out_length, managers[0].control)
        self.sync_manager(1, box.in_start, box.in_length, managers[1].control)

    def size(self, manager: int) -> int:
        """Size of sync manager 2 or 3 (bytes) by the assigned PDOs; without CoE, by the SII."""
        if self.description.protocols & COE:
            pdos = self.array(ASSIGNMENTS[manager - 2])
            bits = sum(word & 0xFF for pdo in pdos for word in self.array(pdo))
        else:
            bits = sum(e.bits for p in self.description.assigned(manager) for e in p.entries)
        return (bits + 7) // 8


class EtherCatMaster:
    """Commands the slaves of a segment.

    Args:
        wire: the connection to the segment.
        most: largest process data in one frame (bytes); larger ones are split over several.
    """

    def __init__(self, wire: Wire, most: int = MOST):
        self.wire = wire
        whole("most", most, 1, MOST, "byte")
        self.slaves: list[RemoteSlave] = []
        self.wrong = 0  # frames of process data that were lost or had a wrong working counter
        self._most = most
        self._index = 0
        self._groups: list[tuple[int, int, list[RemoteSlave]]] = []  # address, bytes, slaves
        self._reference: RemoteSlave | None = None

    # ----------------------------------------------------------------- frames

    def send(self, *datagrams: Datagram) -> list[Datagram]:
        """Send datagrams, up to `RETRIES` times; -> the datagrams that return.

        Raises:
            TimeoutError: no reply.
        """
        for _ in range(RETRIES):
            replies = self._once(datagrams)
            if replies is not None:
                return replies
        raise TimeoutError(f"{datagrams[0]}: no reply to {RETRIES} frames; is the cable broken?")

    def _once(self, datagrams: Iterable[Datagram]) -> list[Datagram] | None:
        self._index = (self._index + 1) & 0xFF
        frame = pack([row._replace(index=self._index) for row in datagrams])
        reply = self.wire.exchange(frame)
        if reply is None:
            return None
        rows = unpack(reply)
        return rows if rows[0].index == self._index else None

    # ------------------------------------------------------------------- scan

    def scan(self) -> list[RemoteSlave]:
        """Find the slaves, assign station addresses, read their EEPROMs; they are in INIT."""
        count = self.send(Datagram(Command.BRD, 0, R.TYPE, b"\0"))[0].wkc
        self.send(Datagram(Command.BWR, 0, R.AL_CONTROL, bytes([AlState.INIT | ACKNOWLEDGE, 0])))
        for address, size in ((R.FMMU, 256), (R.SYNC_MANAGER, 128), (R.ACTIVATION, 1)):
            self.send(Datagram(Command.BWR, 0, address, bytes(size)))
        for i in range(count):
            station = (FIRST_STATION + i).to_bytes(2, "little")
            self.send(Datagram(Command.APWR, -i & 0xFFFF, R.STATION_ADDRESS, station))
        self._groups, self._reference = [], None
        self.slaves = [RemoteSlave(self, i) for i in range(count)]
        return self.slaves

    def to(self, state: AlState) -> None:
        """Bring all slaves to a state by one transition."""
        for slave in self.slaves:
            slave.request(state)

    def recover(self) -> None:
        """Bring slaves back to OPERATIONAL after a watchdog error."""
        fallen = [slave for slave in self.slaves if slave.state != AlState.OPERATIONAL]
        if not fallen:
            return
        for slave in fallen:
            slave.write(R.AL_CONTROL, bytes([AlState.SAFE_OPERATIONAL | ACKNOWLEDGE, 0]))
        self.cycle()
        for slave in fallen:
            slave.request(AlState.OPERATIONAL)

    def to_preop(self) -> None:
        """Open the mailboxes and bring all slaves to PRE_OPERATIONAL."""
        for slave in self.slaves:
            slave.open_mailbox()
            slave.request(AlState.PRE_OPERATIONAL)

    # ------------------------------------------------------------ process data

    def map(self) -> None:
        """Set sync managers 2 and 3 and FMMUs for the assigned PDOs, in PRE_OPERATIONAL."""
        sizes = {slave: (slave.size(2), slave.size(3)) for slave in self.slaves}
        self._groups = []
        for slave in self.slaves:
            need = sum(sizes[slave])
            if not self._groups or self._groups[-1][1] + need > self._most:
                begin = self._groups[-1][0] + self._groups[-1][1] if self._groups else LOGICAL_START
                self._groups.append((begin, 0, []))
            begin, used, slaves = self._groups[-1]
            self._groups[-1] = begin, used + need, [*slaves, slave]
        for begin, _, slaves in self._groups:
            at = begin
            for number, manager, kind in ((0, 2, 2), (1, 3, 1)):
                for slave in slaves:
                    size = sizes[slave][manager - 2]
                    row = slave.description.sync_managers[manager]
                    slave.sync_manager(manager, row.start, size, row.control)
                    slave.fmmu(number, at, size, row.start, kind)
                    at += size
        for slave in self.slaves:
            slave.outputs, slave.inputs = bytearray(sizes[slave][0]), bytes(sizes[slave][1])

    @property
    def frames(self) -> int:
        """Number of frames in a cycle."""
        return len(self._groups)

    def cycle(self) -> bool:
        """Exchange process data once; -> whether every working counter was right.

        After `synchronise`, the first frame also distributes the reference clock's time.
        """
        right = True
        for number, (begin, size, slaves) in enumerate(self._groups):
            outputs = b"".join(bytes(slave.outputs) for slave in slaves)
            rows = [logical(Command.LRW, begin, outputs.ljust(size, b"\0"))]
            if self._reference and number == 0:
                station = self._reference.station
                rows.append(Datagram(Command.FRMW, station, R.SYSTEM_TIME, bytes(8)))
            expected = sum(2 * bool(s.outputs) + bool(s.inputs) for s in slaves)
            right &= self._inputs(rows, expected, slaves)
        return right

    def send_process_data(self) -> None:
        """Exchange process data, because this wire answers at once."""
        self.cycle()

    def look(self) -> bool:
        """Read the inputs only (LRD); -> whether every working counter was right."""
        right = True
        for begin, size, slaves in self._groups:
            rows = [logical(Command.LRD, begin, bytes(size))]
            right &= self._inputs(rows, sum(bool(s.inputs) for s in slaves), slaves)
        return right

    def _inputs(
        self, rows: Sequence[Datagram], expected: int, slaves: Sequence[RemoteSlave]
    ) -> bool:
        """Send a frame and store the inputs of a group; -> whether its counter was right."""
        replies = self._once(rows)
        if replies is None or replies[0].wkc != expected:
            self.wrong += 1
            return False
        at = sum(len(slave.outputs) for slave in slaves)
        for slave in slaves:
            slave.inputs = replies[0].data[at : at + len(slave.inputs)]
            at += len(slave.inputs)
        return True

    def state(self) -> tuple[Any, ...]:
        """Return the state on which process data depend once mapped, for `become`."""
        images = [(bytes(slave.outputs), slave.inputs) for slave in self.slaves]
        return self._index, self.wrong, images

    def become(self, state: tuple[Any, ...]) -> None:
        """Continue from a `state` of the same slaves with the same mapping."""
        self._index, self.wrong, images = state
        for slave, (outputs, inputs) in zip(self.slaves, images, strict=True):
            slave.outputs, slave.inputs = bytearray(outputs), inputs

    def to_op(self, prepare: Callable[[], object] = lambda: None) -> None:
        """Bring all slaves from any AL state to OPERATIONAL, with process data.

        Args:
            prepare: fills the outputs before they are first sent.

        Raises:
            RuntimeError: a slave refuses a state; the message has the slave and its code.
        """
        if not self.slaves:
            self.scan()
        if all(slave.state == AlState.INIT for slave in self.slaves):
            self.to_preop()
        if not self._groups:
            self.map()
        if any(slave.state == AlState.PRE_OPERATIONAL for slave in self.slaves):
            self.to(AlState.SAFE_OPERATIONAL)
        prepare()
        self.cycle()
        self.to(AlState.OPERATIONAL)

    # -------------------------------------------------------- distributed clocks

    def synchronise(self) -> dict[int, int]:
        """Measure delays and offsets; from now on `cycle` keeps the clocks synchronised.

        Returns: delay from the reference clock by position (ns).
        """
        delays = clocks.measure(self.send, self.slaves)
        self._reference = self.slaves[0] if self.slaves else None
        return delays

    def sync0(self, cycle: int, shift: int = 0) -> None:
        """Start SYNC0 of all slaves at a common whole period, with period and shift in ns.

        Raises ValueError for a period or shift of more than 32 bits.
        """
        whole("cycle", cycle, 1, 0xFFFFFFFF, "ns")
        whole("shift", shift, -0xFFFFFFFF, 0xFFFFFFFF, "ns")
        now = self.slaves[0].number(R.SYSTEM_TIME, 8)
        start = (now // cycle + 10) * cycle + shift
        for slave in self.slaves:
            slave.write(R.ACTIVATION, b"\0")
            slave.write(R.SYNC0_CYCLE, cycle.to_bytes(4, "little"))
            slave.write(R.START_TIME, start.to_bytes(8, "little"))
            slave.write(R.ACTIVATION, b"\3")
