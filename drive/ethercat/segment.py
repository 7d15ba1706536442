"""A segment: slaves in order, the links between their ports, and frames that pass them.

Source: ESC data sheet, section I (frame processing order, loops, link detection): a frame goes
port 0 - processing unit - port 3 - port 1 - port 2 - port 0, and a port without a link is a loop.
`exchange` takes a frame and a time, and returns the frame.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..kernel.record import accessible
from ..model.foreign import Key
from ..model.given import octets, whole
from ..objects.snapshot import seal, unseal
from .controller import esc, process_image
from .controller.pdi import Pdi
from .controller.process_image import ProcessImage
from .controller.record import ENTRANCES, ESC, NEVER, PORTS, SII_BYTES, Event
from .controller.registers import RESET, R

HOP = 600  # ns from one slave to the next, one way (inferred: about the delay of an ET1100)
NEXT_PORT = {0: 3, 3: 1, 1: 2, 2: 0}
FIRST, SECOND = -1, -2  # the master's ports, in place of the number of a slave
NOWHERE = -3  # the frame does not return
SERVED = 0x7FFFFFFF & ~Event.PROCESS_DATA  # events that concern the services
AUTO, AUTO_CLOSE, OPEN, CLOSED = range(4)  # loop control of a port in 0101h
LINKS = {"broken": Key(str, True), "held": Key(str, True)}  # state in a snapshot
ADDRESSES = ("axis", "rpdos", "tpdos")  # fields that are valid in one process only
LATEST = 1 << 60  # latest time that is accepted (ns): 36 years
SLOWEST = 1_000_000_000  # longest hop (ns)
PPB = 1_000_000  # largest deviation of a crystal (1e-9)
CLOCKS_APART = 1_000_003_000  # ns between the local clocks of two neighbours at power-on


class Station(Protocol):
    """The services of a drive behind a slave controller."""

    drive: Any
    sii: bytes
    esc: dict[int, bytes]

    def attach(self, pdi: Pdi, image: ProcessImage) -> None:
        """Connect the services to their controller."""

    def serve(self, events: int, now: int) -> None:
        """Process events (bits of `Event`) at `now` (ns)."""

    def power_on(self) -> None:
        """Restart after the controller has been powered on."""

    @property
    def state(self) -> Any:
        """State of the AL state machine."""

    def fail(self, code: int, state: Any = ...) -> None:
        """Retreat to a state, by default SAFE_OPERATIONAL, with an AL status code."""

    def snapshot(self) -> bytes:
        """Return the state of the services."""

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot."""


class End(NamedTuple):
    """A port of a slave, or of the master (slave -1 or -2)."""

    slave: int
    port: int


class Segment:
    """Slaves on a wire.

    Args:
        stations: the services behind the slaves, in the order of their processing units.
        hop: delay from one slave to the next, one way (ns).
        links: pairs of (slave, port); by default a line from port 1 to port 0 of the next slave.
            The master is slave -1, its second port -2.
        ring: the last slave is connected to the master's second port (redundancy).
        clocks: deviation of the slaves' crystals (1e-9), by default 0.

    Raises:
        ValueError: a link to a port that does not exist or has a link already, a SII that does not
            fit, a `hop` or deviation out of range.
    """

    def __init__(
        self, stations: Sequence[Station], *, hop: int = HOP,
        links: Iterable[tuple[tuple[int, int], tuple[int, int]]] | None = None, ring: bool = False,
        clocks: Sequence[int] = (),
    ):
        self.stations = list(stations)
        n = len(self.stations)
        self.hop = whole("hop", hop, 0, SLOWEST, "ns")
        self.escs = np.zeros(n, accessible(ESC))
        if len(clocks) > n:
            raise ValueError(f"clocks: {len(clocks)} deviations for {n} slaves")
        self.clocks = [whole("clocks", clock, -PPB, PPB, "1e-9") for clock in clocks]
        self.clocks += [0] * (n - len(clocks))
        self._peer = _peers(n, _line(n, ring) if links is None else links)
        self._broken: set[End] = set()
        self._held: set[End] = set()  # closed until 0101h is written (AUTO_CLOSE)
        self.exits = [FIRST, SECOND]
        self._walks = [(np.zeros(0, np.int64), np.zeros(0, np.int64))] * ENTRANCES
        self.frame = np.zeros(2048, np.uint8)  # `pass_frame` changes it in place
        self._sent = np.zeros(2048, np.uint8)
        self._touched = np.zeros(n, np.uint8)
        self._requests: list[int] = []
        self._clocked: list[int] = []
        self.pdis = [Pdi(self.escs, i) for i in range(n)]
        self.images = [ProcessImage(self.escs, i, s.drive) for i, s in enumerate(self.stations)]
        for i, station in enumerate(self.stations):
            if len(station.sii) > SII_BYTES:
                raise ValueError(f"slave {i}: its SII has {len(station.sii)} bytes, there is room "
                                 f"for {SII_BYTES}: shorten its strings or PDOs")
            self.escs["sii"][i, : len(station.sii)] = np.frombuffer(station.sii, np.uint8)
            self.escs["sii_size"][i] = len(station.sii)
            self._power_on(i, 0)
        self._rewire()

    def __len__(self) -> int:
        return len(self.stations)

    # ------------------------------------------------------------------ power

    def _power_on(self, i: int, now: int) -> None:
        """Reset registers, load the configuration area and restart the services."""
        record = self.escs[i]
        sii, size = record["sii"].copy(), int(record["sii_size"])
        self.escs[i : i + 1] = np.zeros(1, ESC)
        record["sii"], record["sii_size"] = sii, size
        record["memory"][: len(RESET)] = RESET
        for address, value in self.stations[i].esc.items():
            record["memory"][address : address + len(value)] = np.frombuffer(value, np.uint8)
        record["clock_now"], record["clock_local"] = now, i * CLOCKS_APART
        record["clock_ppb"] = self.clocks[i]
        for name in ("watchdog_at", "sync0_at", "sync1_at"):
            record[name] = NEVER
        record["port_time"] = -1
        record["present"] = 1
        esc.power_on(self.escs, i)
        esc.configure(self.escs, i)
        self.images[i].prepare()
        self.stations[i].attach(self.pdis[i], self.images[i])
        self.stations[i].power_on()

    def _place(self, slave: int) -> int:
        """Return the number of a slave. Raises ValueError if there is no such slave."""
        return whole("slave", slave, 0, len(self) - 1)

    def power(self, slave: int, on: bool, now: int = 0) -> None:
        """Switch a slave off, so that its neighbours lose their links, or on again; keeps the SII.

        Raises ValueError if there is no such slave.
        """
        self._place(slave)
        if on:
            self._power_on(slave, now)
        self.escs["present"][slave] = on
        self._rewire()

    # ------------------------------------------------------------------ links

    def break_link(self, slave: int, port: int = 1) -> None:
        """Break the cable at a port. Raises ValueError if there is none."""
        for end in self.cable(slave, port) - self._broken:
            if end.slave >= 0:
                lost = self.escs["memory"][end.slave]
                lost[R.LOST_LINKS + end.port] = min(int(lost[R.LOST_LINKS + end.port]) + 1, 0xFF)
            self._broken.add(end)
        self._rewire()

    def heal_link(self, slave: int, port: int = 1) -> None:
        """Repair the cable at a port. Raises ValueError if there is none."""
        self._broken -= self.cable(slave, port)
        self._rewire()

    def cable(self, slave: int, port: int) -> set[End]:
        """Return both ends of the cable at a port. Raises ValueError if there is none."""
        here = End(whole("slave", slave, SECOND, len(self) - 1), whole("port", port, 0, PORTS - 1))
        if here not in self._peer:
            cables = [str(end.port) for end in sorted(self._peer) if end.slave == slave]
            raise ValueError(
                f"port {port} of slave {slave} has no cable, only port {' and '.join(cables)}"
            )
        return {here, self._peer[here]}

    def _linked(self, end: End) -> bool:
        peer = self._peer.get(end)
        if peer is None or end in self._broken:
            return False
        return all(x.slave < 0 or bool(self.escs["present"][x.slave]) for x in (end, peer))

    def _open(self, end: End) -> bool:
        control = int(self.escs["memory"][end.slave, R.LOOP_CONTROL]) >> 2 * end.port & 3
        if control == AUTO_CLOSE and end in self._held:
            return False
        return control == OPEN or (control != CLOSED and self._linked(end))

    def _rewire(self) -> None:
        """Update the paths of frames, and show the links in 0110h."""
        for i in range(len(self)):
            memory = self.escs["memory"][i]
            status = int(memory[R.DL_STATUS]) & 0x0F
            for port in range(PORTS):
                end = End(i, port)
                if not self._linked(end):
                    self._held.add(end)
                elif int(memory[R.LOOP_CONTROL]) >> 2 * port & 3 != AUTO_CLOSE:
                    self._held.discard(end)
                status |= self._linked(end) << 4 + port
                status |= (not self._open(end)) << 8 + 2 * port
                status |= (self._linked(end) and self._open(end)) << 9 + 2 * port
            if status != self.pdis[i].get(R.DL_STATUS, 2):
                memory[R.ECAT_EVENT] |= 1 << 2
                self.pdis[i].set(R.DL_STATUS, 2, status)
        for entrance in range(ENTRANCES):
            self._walks[entrance] = self._walk(entrance)

    def _walk(self, entrance: int) -> tuple[np.ndarray, np.ndarray]:
        """Return slaves in the order of processing, and the time to each of them (ns)."""
        self.escs["port_time"][:, entrance] = -1
        slaves: list[int] = []
        times: list[int] = []
        start = (FIRST, SECOND)[entrance]
        self.exits[entrance] = NOWHERE
        begin = self._peer.get(End(start, 0))
        if begin is None or not self._linked(begin):
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        (at, port), time = begin, self.hop
        for _ in range(4 * PORTS * (len(self) + 1)):
            self.escs["port_time"][at, entrance, port] = time
            for _ in range(PORTS):
                if port == 0:
                    slaves.append(at)
                    times.append(time)
                port = NEXT_PORT[port]
                if self._open(End(at, port)):
                    break
            else:
                port = 0  # all are closed: port 0 is the recovery port (data sheet, section I)
            peer = self._peer.get(End(at, port))
            if peer is None or not self._linked(End(at, port)):
                break  # an open port without a cable swallows the frame
            if peer.slave < 0:
                self.exits[entrance] = peer.slave
                break
            (at, port), time = peer, time + self.hop
        return np.array(slaves, np.int64), np.array(times, np.int64)

    # ----------------------------------------------------------------- frames

    def pass_frame(self, length: int, now: int, port: int = 0) -> bool:
        """Let the frame in ``frame[:length]`` pass; -> whether it returns, at ``exits[port]``."""
        slaves, times = self._walks[port]
        events = esc.exchange(self.escs, slaves, times, port, self.frame, length, self._sent, now)
        if events & SERVED:
            self.serve(now)
        return not events & esc.NO_REPLY and self.exits[port] != NOWHERE

    def exchange(self, frame: bytes, now: int, port: int = 0) -> bytes | None:
        """Send a frame into the segment; -> the frame that returns, None if it is lost.

        Args:
            frame: Ethernet frame without its check sequence.
            now: time of sending (ns).
            port: port of the master, 0 or 1.

        Raises:
            ValueError: not bytes, or an invalid time or port.
        """
        length = self.load(frame, now, port)
        if not length or not self.pass_frame(length, now, port):
            return None
        return self.frame[:length].tobytes()

    def load(self, frame: bytes, now: int, port: int) -> int:
        """Copy a frame to the buffer; -> its length, 0 if too long. Errors as for `exchange`."""
        length = len(octets("frame", frame))
        whole("now", now, -LATEST, LATEST, "ns")
        whole("port", port, 0, ENTRANCES - 1)
        if length > len(self.frame):
            return 0
        self.frame[:length] = np.frombuffer(frame, np.uint8)
        return length

    def serve(self, now: int) -> None:
        """Let the services of the slaves that have events process them."""
        for i in np.flatnonzero(self.escs["events"] & SERVED).tolist():
            events = self.pdis[i].take_events()
            if events & Event.PORTS:
                self._held -= {End(i, port) for port in range(PORTS)}
                self._rewire()
            if events & Event.MAILBOX_REQUEST:
                self._requests.append(i)
            if events & Event.SYNC:
                self._clocked.append(i)
            if self.escs["present"][i]:
                self.stations[i].serve(events, now)

    # ------------------------------------------------------------------- time

    def poll(self, now: int) -> None:
        """Process edges of SYNC0 and watchdogs up to `now` (ns). Raises ValueError if invalid."""
        whole("now", now, -LATEST, LATEST, "ns")
        if esc.poll(self.escs, now) & SERVED:
            self.serve(now)

    @property
    def next_time(self) -> int:
        """The next time at which `poll` has something to do (ns)."""
        return int(esc.next_time(self.escs))

    def synchronised(self, slave: int) -> bool:
        """Whether a drive runs at the edges of SYNC0."""
        return bool(esc.synchronised(self.escs, slave))

    def publish(self, now: int) -> None:
        """Copy the inputs of all drives to their sync managers, after their cycles."""
        if process_image.publish(self.escs) & SERVED:
            self.serve(now)

    def touched(self) -> list[int]:
        """Return the slaves that exchanged process data since the last call."""
        if not esc.take_process_data(self.escs, self._touched):
            return []
        return np.flatnonzero(self._touched).tolist()

    @property
    def requested(self) -> list[int]:
        """Slaves that received a mailbox telegram since the last `take_requests`."""
        return self._requests

    def take_requests(self) -> list[int]:
        """Return the slaves of the mailbox telegrams received since the last call."""
        requests, self._requests = self._requests, []
        return requests

    def take_clocked(self) -> list[int]:
        """Return the slaves whose SYNC unit a master has written since the last call."""
        clocked, self._clocked = self._clocked, []
        return clocked

    def latch(self, slave: int, unit: int, rising: bool, now: int) -> None:
        """Process an edge at latch input 0 or 1 of a slave (09A8h). Raises ValueError."""
        whole("now", now, -LATEST, LATEST, "ns")
        esc.latch(self.escs, self._place(slave), now, whole("unit", unit, 0, 1), bool(rising))

    def warm_up(self) -> None:
        """Compile all functions, so that the first frame is answered in time."""
        kept = self.escs.copy()
        self.exchange(bytes(16), 0)
        self.poll(0)
        self.publish(0)
        self.touched()
        esc.next_time(self.escs)
        if len(self):
            self.synchronised(0)
            self.latch(0, 0, True, 0)
        self.escs[:] = kept

    # --------------------------------------------------------------- snapshot

    def snapshot(self, *, drives: bool = True) -> bytes:
        """Return the whole state as bytes; after `restore` the segment continues bit by bit alike.

        Args:
            drives: include the drives; leave them out if the snapshot of a machine has them.
        """
        escs = self.escs.copy()
        for name in ADDRESSES:
            escs[name] = 0
        parts = [escs.tobytes()]
        for station in self.stations:
            parts.append(station.snapshot())
            parts.append(station.drive.snapshot() if drives and station.drive else b"")
        links = {"broken": _text(self._broken), "held": _text(self._held)}
        return seal(self._identity, links, parts)

    @property
    def _identity(self) -> dict[str, Any]:
        """The identity of this segment in a snapshot."""
        models = [getattr(station.drive, "model", None) for station in self.stations]
        return {
            "kind": "segment",
            "layout of a slave controller (byte)": ESC.itemsize,
            "slaves": [model.name if model else "" for model in models],
            "cables": _text(self._peer),
        }

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot.

        Raises:
            ValueError: not a snapshot, damaged, or of another segment or version; nothing changes.
        """
        sizes = [self.escs.nbytes, *[None] * (2 * len(self.stations))]
        links, parts = unseal(snapshot, self._identity, LINKS, sizes)
        escs, *stations = parts
        opened = [
            station.drive.opened(part) if part else None
            for station, part in zip(self.stations, stations[1::2], strict=True)
        ]
        self._broken, self._held = _ends(links["broken"]), _ends(links["held"])
        self.escs[:] = np.frombuffer(escs, ESC)
        for i, station in enumerate(self.stations):
            station.restore(stations[2 * i])
            if opened[i]:
                station.drive.take(opened[i])
            self.images[i].prepare()
        before = self.escs["memory"].copy()
        self._rewire()
        self.escs["memory"][:] = before


def _ends(text: str) -> set[End]:
    return {End(*map(int, end.split(":"))) for end in text.split()}


def _text(ends: Iterable[End]) -> str:
    return " ".join(f"{end.slave}:{end.port}" for end in sorted(ends))


def _line(n: int, ring: bool) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    links = [((FIRST, 0), (0, 0))] if n else []
    links += [((i, 1), (i + 1, 0)) for i in range(n - 1)]
    if ring and n:
        links.append(((n - 1, 1), (SECOND, 0)))
    return links


def _peers(n: int, links: Iterable[tuple[tuple[int, int], tuple[int, int]]]) -> dict[End, End]:
    peers: dict[End, End] = {}
    for link in links:
        ends = [End(*end) for end in link]
        for end in ends:
            fits = end.port == 0 if end.slave < 0 else end.port in range(PORTS)
            if not SECOND <= end.slave < n or not fits or end in peers:
                raise ValueError(
                    f"link {link}: port {end.port} of slave {end.slave} does not exist or has a "
                    "cable already"
                )
        peers[ends[0]], peers[ends[1]] = ends[1], ends[0]
    return peers
