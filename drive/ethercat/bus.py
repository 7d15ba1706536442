"""A segment with the machines that its drives move, and the time of both, for three clocks.

``frame``: each frame of process data advances time by one period, the SYNC0 cycle of a synchronised
drive or 60C2h of any other, so runs are bit-identical and as fast as possible. ``dc``: the caller
gives the time, and machines of synchronised drives run for one SYNC0 cycle at each edge of SYNC0.
``real``: the caller gives the time, and machines follow it by at most one period between two
frames; periods that they miss are counted.

`receive` answers a frame, and `advance` runs the machines afterwards, because a master does not
wait for physics. Times are in ns; this module reads no clock.
"""

import copy
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar

from ..machine import Machine
from ..model.given import whole
from .controller.record import NEVER
from .controller.registers import R
from .segment import LATEST, Segment
from .slave import interpolation_ns

IDLE_MOST = 50_000_000  # longest step of physics without process data (ns)


class Clock(StrEnum):
    """The source of time of a segment."""

    FRAME = "frame"
    DC = "dc"
    REAL = "real"


@dataclass
class Statistics:
    """Counters of a bus."""

    frames: int = 0  # received
    answered: int = 0
    cycles: int = 0  # exchanges of process data
    missed: int = 0  # times a machine could not follow the clock


class _Plant:
    """One machine and the slaves of its drives."""

    def __init__(self, machine: Machine, slaves: list[int]):
        self.machine = machine
        self.slaves = slaves
        self.drive = next(iter(machine.drives.values()))
        self.cycle = round(machine.cycle_time * 1e9)  # ns
        self.time = 0  # ns, up to which frames or the clock have advanced it
        self.due = set(slaves)  # slaves whose process data the bus cycle still waits for
        self.edges = 0  # of SYNC0 so far

    @property
    def period(self) -> int:
        """60C2h, rounded down to whole cycles of the machine (ns)."""
        return max(interpolation_ns(self.drive) // self.cycle, 1) * self.cycle

    def run(self, span: int) -> bool:
        """Run the whole cycles in `span` ns; -> whether there was at least one."""
        cycles = span // self.cycle
        if cycles > 0:
            self.machine.step(cycles)
        return cycles > 0


class Bus:
    """A segment with the machines that its drives move.

    Args:
        segment: the slaves.
        machines: with the slaves' drives; a drive without a machine does not run.
        clock: source of time.
    """

    KEPT: ClassVar[tuple[str, ...]] = ("time", "statistics", "extra")  # by `state`

    def __init__(
        self, segment: Segment, machines: Sequence[Machine] = (), clock: Clock | str = Clock.FRAME
    ):
        self.segment = segment
        self.clock = Clock(clock)
        self.time = 0  # ns
        self.statistics = Statistics()
        self.extra: deque[bytes] = deque()  # frames besides the replies; see `faulty`
        self._plants = []
        self._plant_of: dict[int, _Plant] = {}
        place = {id(s.drive): i for i, s in enumerate(segment.stations)}
        for machine in machines:
            slaves = [place[id(d)] for d in machine.drives.values() if id(d) in place]
            plant = _Plant(machine, slaves)
            self._plants.append(plant)
            self._plant_of |= dict.fromkeys(slaves, plant)

    # ----------------------------------------------------------------- frames

    def receive(self, length: int, now: int, port: int = 0) -> bool:
        """Let the frame in ``segment.frame[:length]`` pass; -> whether it returns.

        The clock ``frame`` ignores `now` (ns).
        """
        if self.clock != Clock.FRAME:
            self._edges(now)
            self.time = max(self.time, now)
        self.statistics.frames += 1
        answered = self.segment.pass_frame(length, self.time, port)
        self.statistics.answered += answered
        return answered

    def exchange(self, frame: bytes, now: int = 0, port: int = 0) -> bytes | None:
        """Exchange a frame given as bytes, with all its effects; -> the reply.

        Raises:
            ValueError: not bytes, or an invalid time (ns) or port.
        """
        length = self.segment.load(frame, now, port)
        if not length:
            return None
        answered = self.receive(length, now, port)
        reply = self.segment.frame[:length].tobytes() if answered else None
        self.advance(now)
        return reply

    # ------------------------------------------------------------------- time

    def advance(self, now: int) -> None:
        """Let the machines catch up with the clock, after a frame or after idle time."""
        touched = self.segment.touched()
        if touched:
            self.statistics.cycles += 1
        if self.clock == Clock.FRAME:
            self._advance_by_frames(touched)
        else:
            self._follow(now, bool(touched))

    def notes(self) -> list[str]:
        """Return hints for a master that has just set the SYNC unit of a slave."""
        lines = []
        for slave in self.segment.take_clocked():
            record = self.segment.escs[slave]
            if record["sync0_at"] == NEVER:
                continue
            cycle = self.segment.pdis[slave].get(R.SYNC0_CYCLE, 4) / 1e6
            if record["inputs_on"] and not self.segment.synchronised(slave):
                lines.append(
                    f"slave {slave}: SYNC0 of {cycle:g} ms was set after SAFE_OP, so the drive "
                    "still follows its frames: set it in PRE_OP, then request SAFE_OP"
                )
            elif self.clock == Clock.FRAME:
                lines.append(
                    f"slave {slave}: SYNC0 of {cycle:g} ms: with --clock frame, each frame of "
                    "process data advances time by one such cycle; a master that aligns its cycle "
                    "with the DC time needs --clock dc"
                )
        return lines

    def let_pass(self, span: int) -> None:
        """Advance the slaves alone by `span` ns, without frames; the machines run elsewhere.

        Raises ValueError for a negative or invalid span.
        """
        whole("span", span, 0, LATEST, "ns")
        self._edges(self.time + span)
        self.time += span

    def _advance_by_frames(self, touched: list[int]) -> None:
        ran, until = False, self.time
        for slave in touched:
            plant = self._plant_of.get(slave)
            if plant is None:
                continue
            plant.due.discard(slave)
            if not plant.due:
                plant.due = {s for s in plant.slaves if self.segment.escs["inputs_on"][s]}
                synchronised = self._synchronised(plant)
                span = self._sync0(plant) if synchronised else plant.period
                plant.time = max(plant.time, self.time - span) + span  # idle ones go on here
                until = max(until, plant.time)
                if not synchronised:  # a synchronised plant runs at the edges instead
                    ran |= plant.run(span)
        for slave in self.segment.take_requests():
            plant = self._plant_of.get(slave)  # without process data, an SDO lets a cycle pass
            if plant and not any(self.segment.escs["inputs_on"][s] for s in plant.slaves):
                ran |= plant.run(plant.cycle)
        if until > self.time:
            self._edges(until)
            self.time = until
        if ran:
            self.segment.publish(self.time)

    def _synchronised(self, plant: _Plant) -> bool:
        return self.segment.synchronised(plant.slaves[0])

    def _sync0(self, plant: _Plant) -> int:
        """SYNC0 cycle of the plant's first slave (ns)."""
        return self.segment.pdis[plant.slaves[0]].get(R.SYNC0_CYCLE, 4)

    def _edges(self, until: int) -> None:
        """Process edges of SYNC0 and watchdogs up to a time, and run the cycles they start."""
        while (due := self.segment.next_time) <= until:
            self.segment.poll(due)
            counts = self.segment.escs["sync0_count"]
            ran = False
            for plant in self._plants:
                edges = int(counts[plant.slaves[0]])
                if edges > plant.edges and self._synchronised(plant):
                    ran |= plant.run(self._sync0(plant))
                plant.edges = edges
            if ran:
                self.segment.publish(due)

    def _follow(self, now: int, exchanged: bool) -> None:
        self.segment.take_requests()
        self._edges(now)
        ran = False
        for plant in self._plants:
            if self._synchronised(plant):
                plant.time = now
                continue
            cyclic = bool(self.segment.escs["inputs_on"][plant.slaves[0]])
            most = plant.period if cyclic else IDLE_MOST
            behind = now - plant.time
            if cyclic and not exchanged and behind < 2 * most:
                continue  # its frame is still expected
            if behind > 2 * most:
                self.statistics.missed += 1
                plant.time = now - most
            span = min(now - plant.time, most) // plant.cycle * plant.cycle
            ran |= plant.run(span)
            plant.time += span
        if ran:
            self.segment.publish(now)
        self.time = max(self.time, now)

    # ------------------------------------------------------------------ state

    def state(self) -> dict[str, Any]:
        """Return the state except segment and machines, which have snapshots of their own."""
        plants = [(plant.time, plant.due, plant.edges) for plant in self._plants]
        own = {name: getattr(self, name) for name in self.KEPT}
        return copy.deepcopy({"plants": plants} | own)

    def become(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state` with the same segment and machines."""
        kept = copy.deepcopy(dict(state))
        for plant, row in zip(self._plants, kept.pop("plants"), strict=True):
            plant.time, plant.due, plant.edges = row
        for name, value in kept.items():
            setattr(self, name, value)
