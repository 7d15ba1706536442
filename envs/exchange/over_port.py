"""The drives of an environment on a bus: the same process images, real time, and a guard between.

>>> bus = can.Bus(interface="socketcan", channel="can0", bitrate=1_000_000)
>>> env = gymnasium.make("servogym/LinearAxis-v0", port=CanDrives(CanPort(bus), {"x": 1}))

A step of an agent is a period of the bus, by absolute times::

    t            t + phase                          t + period
    | ask, answers, policy | set-points go out ...  | ask, ...

Set-points go out at one and the same phase of each step, whenever the policy has ended, because a
drive interpolates from each to the next: what comes late is wrong by its velocity times the delay.
RPDOs act when they come, and TPDOs answer a SYNC, which comes from here. On EtherCAT outputs go out
with a frame of process data, and inputs are read alone, so that reading is no new set-point.

What a bus does not tell is taken from what it tells: the load is where the encoder says it is, the
share of the step at an internal limit is that of its end. The machine of such an environment has
no time of its own; it keeps what a task reads of its drives.

Drives that begin an episode without a reference, as those of ``Homing-v0``, are homed by the master
with the method the task imitates. So it knows the start and the true home, each as the encoder and
that method have it; an interrupted homing then takes the reference away from the drive (6041h,
mode hm). Where the drive takes a new reference its positions jump, and the master goes on counting
from the old one: the place found is known to the mean of two velocities. What an impact on an end
stop costs, no bus tells: it counts as none.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...drive.canopen.frame import Base, Frame
from ...drive.canopen.node import NmtCommand
from ...drive.canopen.port import FramePort
from ...drive.canopen.remote import SYNC, CanOpenPort
from ...drive.ethercat.al import AlState
from ...drive.ethercat.port import EtherCatPort, SegmentMaster
from ...drive.kernel.words import ENABLED, Mode
from ...drive.kernel.words import Controlword as C
from ...drive.kernel.words import Statusword as S
from ...drive.master.errors import ServoError
from ...drive.master.master import Master
from ...drive.master.port import Port
from ...drive.model.model import DriveModel, load
from ...drive.objects.abort import SdoAbort
from ..engine.machine import Machine
from .envelope import Envelope, Guard, Stopped
from .timing import Timing

PDOS = 4  # of each direction with an identifier of their own (CiA 301, default connection set)
RPDO, TPDO = 0x200, 0x180  # identifiers of the first, for node-id 0; the next are 100h apart
AT_ONCE, AT_SYNC = 255, 1  # transmission types of RPDOs, of TPDOs
OFF = 0x8000_0000  # COB-ID of a PDO that does not exist
MASTER, BEAT, WATCH = 127, 0.02, 0.2  # node-id; s between heartbeats, s until drives miss one
LIVES = 4  # questions of node guarding that may be missed
WAIT = 2e-3  # s for a frame, while a master waits
A_STEP = 5e-3  # s that pass with a SYNC or a frame of process data, in lock-step
SILENT = 2.0  # s without a frame, then the clock goes on in lock-step as well
APART = 4e-3  # s, between SYNCs while a master waits
HEARTBEAT = Frame(0x700 + MASTER, b"\x05")
PHASE = 0.4  # of a step: until then bus and policy have answered, then set-points go out
LAST = 0.8  # of a step: what a policy has not said by then takes no part in it
ANSWERS = 0.7  # of that: what is left is for the policy, or to send the last action again
LOCK_STEP_PATIENCE = 10.0  # s for an answer or an action, where time waits for both
LOOKS = 300  # at the inputs until a slave counts as silent: of SOEM more than 2 ms each
NO_LIMIT = 4294967295  # of 60C5h and 60C6h
OPEN = -(2**31), 2**31 - 1  # of 607Dh: a drive without position limits (CiA 402-2)
REVERSALS = 5.0  # accelerations of the quick stop that set-points may have (inferred)
SEARCHES = 300.0  # s that a homing may take: slowly from end to end
FORGETS = 5.0  # s until an interrupted homing stands
REFERENCED = 0x1000  # statusword in homing mode: homing attained (CiA 402-2)
IDENTITY = ("vendor_id", "product_code")
COMPARED = (  # objects that decide what a task's numbers mean, or when a drive gives up
    "following_error_window", "following_error_time_out", "max_profile_velocity", "max_torque",
    "min_position_limit", "max_position_limit", "quick_stop_deceleration",
)
INTERPOLATION = ("interpolation_time_period_value", "interpolation_time_index")  # 60C2h
PROFILE = ("profile_velocity", "profile_acceleration", "profile_deceleration")
APPROACH = 0.4  # of them, on the way to the start: its gains may be set for slower motion
REST = 0.3  # s that an axis stands before an episode: its integrator has come to rest
NEAR = 1e-5  # m or rad from where an episode begins; no motion there
MISSED, BRIDGED = 3, 0.01  # steps, and time (s), without answers or actions until a guard stops
HELD_UP = (
    "no frame came within the time of its watchdog (0420h), because this computer or the drive's "
    "was held up; begin anew, with less beside it"
)
QUICK_STOP = 0x02  # controlword
GUARDED = {  # objects an agent may command on a bus: those the guard looks at
    "controlword", "modes_of_operation", "target_position", "target_velocity", "target_torque",
    "torque_offset", "max_torque",
}
BESIDE = 0.01  # m or rad beyond the end stops, that an axis may push itself into them


Limits = Mapping[str, Envelope | Mapping[str, float]]


class Pace:
    """Real time: steps end at absolute times, so that they do not drift."""

    real = True

    def now(self) -> float:
        """The clock (s)."""
        return time.monotonic()

    def wait(self, deadline: float) -> None:
        """Sleep until a time (s)."""
        left = deadline - time.monotonic()
        if left > 0.0:
            time.sleep(left)


class LockStep(Pace):
    """Time that passes with the steps, as fast as the drives' machines let it.

    They have to be served by a clock that waits for the bus: ``sync_end`` on CAN, ``frame`` on
    EtherCAT, see `servogym.envs.serve.description.BusRow`.
    """

    real = False

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        """Steps times their length (s)."""
        return self.time

    def wait(self, deadline: float) -> None:
        """It is that time (s)."""
        self.time = max(self.time, deadline)


class DriveSide(Protocol):
    """Drives on a bus, with process images of a task: `CanDrives`, `EtherCatDrives`."""

    pace: Pace

    @property
    def port(self) -> Port:
        """Where a master's requests go."""

    @property
    def envelopes(self) -> Limits:
        """Limits by drive, all of them or some by name; the others are those the drive has."""

    def awake(self) -> None:
        """See that process data are exchanged, before an episode."""

    def trouble(self) -> str:
        """What the bus knows of drives that do not do as they are told; empty for nothing."""

    def connect(
        self, axes: Sequence[str], rpdos: Sequence[Sequence[str]], tpdos: Sequence[Sequence[str]]
    ) -> None:
        """Map the objects of each PDO in every drive, and start process data."""

    def arm(self, on: bool) -> list[str]:
        """Let the drives stop by themselves when nothing comes from here any more.

        Returns: names of those that have no such watchdog.
        """

    def send(self) -> None:
        """Set-points written to the port go out now."""

    def sample(self, patience: float) -> bool:
        """Ask for the answers; -> whether all have come within a time (s)."""


class _Beating:
    """A bus on which a master's heartbeat goes out with the frames, and not too many SYNCs.

    Args:
        bus: that of the drives.
        real: time passes by itself, else with each SYNC.
    """

    def __init__(self, bus: FramePort, real: bool):
        self._bus, self._real, self._next, self._synced = bus, real, 0.0, 0.0
        self._syncs = 0
        self.silent = not real  # no SYNC, so no time passes, until an episode is to begin
        self.answers: set[int] = set()  # identifiers that follow a SYNC
        self._owed: set[int] = set()  # of them, those of the latest SYNC that have not come
        self._quiet = self._in_vain = 0.0  # s without an answer; of it, beyond `SILENT`, in all
        self.guarded: list[int] = []  # node-ids that are asked for their state (node guarding)

    def now(self) -> float:
        """Time (s); in lock-step that of the SYNCs.

        A drive has acted on a command after so many cycles, not after so many seconds; who waits
        for an answer that does not come has to give up all the same, see `SILENT`.
        """
        if self._real:
            return self._bus.now()
        return self._syncs * A_STEP + self._in_vain

    def wait(self, seconds: float | None = None) -> None:
        """How long an exchange waits for the first frame (s); the usual time if not given."""
        if hasattr(self._bus, "patience"):
            self._bus.patience = WAIT if seconds is None else seconds

    def sync_now(self) -> None:
        """The next SYNC is not held back."""
        self._synced = -math.inf

    def exchange(self, frames: Iterable[Frame]) -> Iterable[Frame]:
        now, given = self.now(), [*frames]
        if now >= self._next or (not self._real and SYNC in given):
            self._next = now + BEAT
            asked = [Frame(0x700 + node_id, b"", remote=True) for node_id in self.guarded]
            given[:0] = [HEARTBEAT, *asked]
        # a master that waits exchanges as fast as the bus gives frames back
        if self.silent:
            given = [frame for frame in given if frame != SYNC]
        if self._real and now < self._synced + APART:
            given = [frame for frame in given if frame != SYNC]
        if SYNC in given:
            self._syncs += 1
            self._synced = now
            self._owed = set() if self._real else set(self.answers)
        received = self._exchanged(given)
        while self._owed and self._quiet <= SILENT:
            received += self._exchanged([])
        return received

    def _exchanged(self, frames: Iterable[Frame]) -> list[Frame]:
        """What comes; a bus is quiet while none of the answers that are owed is among it."""
        begin = self._bus.now()
        received = [*self._bus.exchange(frames)]
        passed = self._bus.now() - begin
        came = {frame.id for frame in received}
        heard = self._owed & came if self._owed else came
        self._owed -= came
        self._quiet = 0.0 if heard else self._quiet + passed
        if self._quiet > SILENT or self.silent:
            self._in_vain += passed
        return received


class CanDrives:
    """Nodes on a CAN bus, whose SYNC comes from here.

    Args:
        bus: the way to it, such as `servogym.drive.wire.bus.CanPort`.
        nodes: node-id by the name of the drive in the task's machine.
        model: of the drives.
        envelopes: limits by drive, all of them or some by name; the others are those it has.
        pace: real time, if not given.
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
        self._bus = _Beating(bus, self.pace.real)
        self.port = CanOpenPort(self._bus, nodes, model)

    def trouble(self) -> str:
        """Nodes whose TPDOs do not follow the SYNC because they wait for another one (1005h)."""
        said = []
        for axis, node in self.port.nodes.items():
            with suppress(ServoError, SdoAbort):
                awaited = int.from_bytes(node.sdo.upload(0x1005, 0), "little") & 0x7FF
                if awaited != Base.SYNC:
                    said.append(f"; {axis} waits for the SYNC {awaited:X}h (1005h): set it to "
                                f"{Base.SYNC:X}h")
        return "".join(said)

    def awake(self) -> None:
        """From now on SYNCs go out, and nodes that have left OPERATIONAL go back to it."""
        self._bus.silent = False
        for node in self.port.nodes.values():
            node.nmt(NmtCommand.START)

    def connect(
        self, axes: Sequence[str], rpdos: Sequence[Sequence[str]], tpdos: Sequence[Sequence[str]]
    ) -> None:
        """See `DriveSide`. Raises ValueError for other drives, SdoAbort where one refuses."""
        _same(axes, self.port.nodes)
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
        self._bus.answers = {pdo.cob_id for node in self.port.nodes.values() for pdo in node.tpdos}

    def _map(
        self, node: Any, communication: int, mapping: int, cob_id: int, kind: int,
        names: Sequence[str],
    ) -> None:
        def put(index: int, subindex: int, value: int, size: int) -> None:
            node.sdo.download(index, subindex, value.to_bytes(size, "little"))

        try:
            put(communication, 1, OFF | cob_id, 4)
        except SdoAbort:
            if names:
                raise
            return  # the drive has fewer PDOs, and needs none here
        if names:
            put(mapping, 0, 0, 1)
            model = next(iter(self.port.models.values()))
            for n, name in enumerate(names, 1):
                row = model.number(name)
                put(mapping, n, row.index << 16 | row.subindex << 8 | 8 * row.size, 4)
            put(mapping, 0, len(names), 1)
            put(communication, 2, kind, 1)
            put(communication, 1, cob_id, 4)

    def arm(self, on: bool) -> list[str]:
        """Watch the heartbeat of this master (1016h), or its questions (100Ch, 100Dh).

        What follows their loss is said by 6007h.
        """
        self._bus.guarded = []
        return [axis for axis, node in self.port.nodes.items() if not self._watches(node, on)]

    def _watches(self, node: Any, on: bool) -> bool:
        def put(index: int, subindex: int, value: int, size: int) -> bool:
            data = value.to_bytes(size, "little")
            with suppress(SdoAbort):
                node.sdo.download(index, subindex, data)
                return bool(node.sdo.upload(index, subindex)[:size] == data)
            return False

        if put(0x1016, 1, MASTER << 16 | round(1e3 * WATCH) if on else 0, 4):
            return True
        guard_time = round(1e3 * WATCH / LIVES) if on else 0
        if put(0x100C, 0, guard_time, 2) and put(0x100D, 0, LIVES if on else 0, 1):
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
        pdos = [pdo for node in self.port.nodes.values() for pdo in node.tpdos]
        self._bus.wait(0.0)
        self.port.exchange(sync=False)  # what has come too late for the last step is no answer
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


class EtherCatDrives:
    """Slaves of a segment, in OPERATIONAL.

    Args:
        master: in memory, or `servogym.drive.wire.soem.SoemMaster`.
        axes: names of the drives in the task's machine, in the order of the slaves; slaves behind
            them get no power.
        model: of the drives.
        envelopes: limits by drive, all of them or some by name; the others are those it has.
        pace: real time, if not given.
    """

    def __init__(
        self,
        master: SegmentMaster,
        axes: Sequence[str],
        model: str | Path | DriveModel = "generic",
        *,
        envelopes: Limits | None = None,
        pace: Pace | None = None,
    ):
        self.envelopes, self.pace = dict(envelopes or {}), pace or Pace()
        self._master, self._axes, self._model = master, [*axes], load(model, "ethercat")
        self.port: Any = None

    def connect(
        self, axes: Sequence[str], rpdos: Sequence[Sequence[str]], tpdos: Sequence[Sequence[str]]
    ) -> None:
        """See `DriveSide`. Raises as `EtherCatPort`."""
        _same(axes, self._axes)
        slaves = self._master.slaves or self._master.scan()
        others = [f"slave {n}" for n in range(len(self._axes), len(slaves))]
        models = dict.fromkeys([*self._axes, *others], self._model)
        outputs, inputs = ([name for pdo in pdos for name in pdo] for pdos in (rpdos, tpdos))
        self.port = EtherCatPort(
            self._master, models, outputs=outputs, inputs=inputs,
            now=self.pace.now if self.pace.real else lambda: A_STEP * self.port.exchanges,
        )
        self.port.cyclic = self.pace.real

    def trouble(self) -> str:
        """Slaves that have left OPERATIONAL take no process data, whatever these command."""
        fallen = [
            f"{axis} is in {slave.state.name}"
            for axis, slave in zip(self._axes, self._master.slaves, strict=False)
            if slave.state != AlState.OPERATIONAL
        ]
        return f"; {', '.join(fallen)}: {HELD_UP}" if fallen else ""

    def awake(self) -> None:
        """Slaves whose watchdog has expired while nothing was exchanged go on."""
        self._master.recover()

    def arm(self, on: bool) -> list[str]:
        """The watchdog of the sync managers always looks."""
        return []

    def send(self) -> None:
        """See `DriveSide`."""
        self.port.send()

    def sample(self, patience: float) -> bool:
        """See `DriveSide`; reads the inputs alone, and again where a frame is lost."""
        pace, looks = self.pace, 1
        end = pace.now() + patience
        while not self._master.look():
            if looks >= LOOKS or (pace.real and pace.now() >= end):
                return False
            looks += 1
        return True


def _same(wanted: Sequence[str], given: Any) -> None:
    if [*wanted] != [*given]:
        raise ValueError(
            f"port: the task commands the drives {', '.join(wanted)}, the port has "
            f"{', '.join(given)}: give them these names, in this order"
        )


def _insist(act: Callable[[], object]) -> None:
    """Do it whatever happens; Ctrl-C, pressed again, does not take it away."""
    while True:
        try:
            act()
        except KeyboardInterrupt:
            continue
        except BaseException:
            pass
        return


class PortLine:
    """What lies between an environment and its drives on a bus.

    Args:
        machine: of the environment.
        axes: names of the drives its agent commands.
        images: records of their RPDOs and TPDOs.
        pdos: the objects of each, shared out to PDOs.
        period: of the agent's steps (s).
        units: position units per m or rad.
        side: the drives.
        referenced: whether the drives have a reference at the beginning of an episode. Where they
            have none, no software limits hold: the guard's are the end stops of `machine`.

    Raises:
        ValueError: a drive that is not the model, or has no limits; a set-point without a guard.
    """

    def __init__(
        self, machine: Machine, axes: Sequence[str], images: Sequence[np.dtype],
        pdos: Sequence[Sequence[Sequence[str]]], period: float, units: float, side: DriveSide,
        referenced: bool = True,
    ):
        self._machine, self._axes, self._period, self._units = machine, [*axes], period, units
        self._rpdo, self._tpdo = images
        self._side, self._has_reference = side, referenced
        self._guardable()
        self._kept: dict[tuple[str, str], float] = {}  # of the drives, before it was changed here
        side.connect(self._axes, *pdos)
        self.master = Master(side.port, *self._axes)
        self._home_at: dict[str, float] = {}  # of drives that look for it (m or rad)
        self._shift = dict.fromkeys(self._axes, 0.0)  # of positions, by a reference taken since
        places = dict(zip(machine.drives, machine.couplings, strict=True))
        self._qpos = {axis: int(places[axis].qpos) for axis in self._axes}
        self._last = dict.fromkeys(self._axes, (0.0, 0.0))  # position and velocity, a step ago
        self._identify()
        self.differs = [*self._differing()]  # from the task's own drives, in words
        self.guards = {
            axis: Guard(axis, self._envelope(axis), period, 1 / units, 1 / units)
            for axis in self._axes
        }
        self.timing = Timing(period)
        self.phase = PHASE  # of a step: when set-points go out
        # steps one after the other without answers, set-points or actions in time, until it stops
        self.missed = max(MISSED, math.ceil(BRIDGED / period))
        self._begun = False  # an episode: before it, the drives get no power from here
        self.time_limit = math.inf  # s, from the first episode on
        self._running = self._behind = 0  # steps one after the other: without answers, too late
        self._deadline, self._ends = 0.0, math.inf
        self.unwatched: list[str] = []  # drives without a watchdog for a lost master
        self.refused: list[str] = []  # of real time, by the system
        self.home: int | None = None  # method 6098h by which drives are referenced, once
        self._sure = False  # that all drives answer and are referenced, or are to be homed
        self.dry = False  # all but the power: controlwords stay 0
        self.stopped: Stopped | None = None
        self.on_step: Callable[[np.ndarray], object] | None = None  # answers of the drives
        self.sent: np.ndarray | None = None  # the last commands

    def _guardable(self) -> None:
        """See that the guard knows what the agent commands."""
        names = set(self._rpdo.names or ())
        for name in sorted(names - GUARDED):
            raise ValueError(
                f"RPDO has {name}, at which the guard does not look: on a bus an agent may command "
                f"{', '.join(sorted(GUARDED))}"
            )
        if {"target_position", "target_velocity"} <= names:
            raise ValueError(
                "RPDO has target_position and target_velocity: the guard follows one of them, "
                "leave the other out"
            )

    def _set(self, axis: str, name: str, value: float) -> None:
        """Change an object of a drive until `_give_back`."""
        if (axis, name) not in self._kept:
            self._kept[axis, name] = self._side.port.upload(axis, name)
        self._side.port.write(axis, name, value)

    def _give_back(self, *names: str) -> None:
        """Objects, all if none is named, become what they were before `_set`."""
        for axis, name in [*self._kept]:
            if not names or name in names:
                self._side.port.write(axis, name, self._kept.pop((axis, name)))

    def _identify(self) -> None:
        """See that the drives are the model; tell them the period of the set-points."""
        for axis in self._axes:
            model, own = self._side.port.models[axis], self._machine.drives[axis]
            for name in IDENTITY:
                if name in own.objects.names:
                    there, here = self._side.port.upload(axis, name), own.read(name)
                    if there != here:
                        raise ValueError(
                            f"{axis}: {name} is {there:#x}, of model {model.name!r} it is "
                            f"{here:#x}: give the model of the drive that is there"
                        )
            for name in INTERPOLATION:
                if name in own.objects.names:
                    self._set(axis, name, own.read(name))

    def _differing(self) -> Iterator[str]:
        """What the drives are set to otherwise than those the task has in memory."""
        for axis in self._axes:
            own = self._machine.drives[axis]
            for name in COMPARED:
                with suppress(SdoAbort, ValueError):
                    there, here = self._side.port.upload(axis, name), own.read(name)
                    if there != here:
                        yield f"{axis}: {name} is {there:g}, in the task {here:g}"

    def _envelope(self, axis: str) -> Envelope:
        """The limits given for a drive, and its own where none are. Raises ValueError."""
        given = self._side.envelopes.get(axis, {})
        if isinstance(given, Envelope):
            return given
        try:
            return Envelope(**{**self._limits(axis), **given})
        except ValueError as error:
            raise ValueError(f"{axis}: {error}") from None

    def _limits(self, axis: str) -> dict[str, float]:
        """What the drive itself has: positions, speed, torque, following error.

        Set-points may be accelerated as it says (60C5h, 60C6h), or as its quick stop does, several
        times over, and turn from one limit to the other within a step.
        """
        unit, n = 1.0 / self._units, [*self._machine.drives].index(axis)

        def read(name: str, otherwise: float = math.inf) -> float:
            with suppress(SdoAbort, ValueError):
                return self._side.port.upload(axis, name)
            return otherwise

        most = max(read("max_acceleration"), read("max_deceleration"))
        if not most < NO_LIMIT:
            most = REVERSALS * read("quick_stop_deceleration")
        acceleration = most * unit
        low, high = (read(f"{end}_position_limit") * unit for end in ("min", "max"))
        if not self._has_reference:
            stops = self._machine.mechanics[n]
            low, high = float(stops["low"]) - BESIDE, float(stops["high"]) + BESIDE
        elif {low, high} & {OPEN[0] * unit, OPEN[1] * unit}:
            low, high = -math.inf, math.inf
        speed = read("max_motor_speed") * math.tau / 60.0 / abs(self._machine.couplings[n].gear)
        return {
            "low": low, "high": high,
            "velocity": min(read("max_profile_velocity") * unit, speed),
            "acceleration": acceleration, "jerk": 2.0 * acceleration / self._period,
            "torque": 1e-3 * read("max_torque"),
            "following_error": read("following_error_window") * unit,
            "following_error_time": 1e-3 * read("following_error_time_out", 0.0),
        }

    @property
    def lost(self) -> int:
        """Steps without all the answers."""
        return self.timing.lost

    @property
    def patience(self) -> float:
        """How long a policy may still think (s): longer than `phase`, late is better than never."""
        if not self._side.pace.real:
            return LOCK_STEP_PATIENCE
        return max(self._deadline + LAST * self._period - self._side.pace.now(), 0.0)

    @property
    def time(self) -> float:
        """The clock of the bus (s)."""
        return self._side.pace.now()

    def begin(self, random: np.random.Generator) -> None:
        """Before an episode."""
        if self.stopped is not None:
            raise self.stopped
        self._begun = True
        self._side.awake()
        self._running = self._behind = 0
        if self._ends == math.inf:
            self._ends = time.monotonic() + self.time_limit

    def place(
        self, positions: Mapping[str, float], mode: Mode,
        search: tuple[int, float] | None = None,
    ) -> dict[str, float]:
        """Enable the drives and move them to positions (m or rad); -> where they are.

        What is not commanded here stands where it is told to.
        Drives that get no power (`dry`) are left where they are.

        Args:
            positions: by drive.
            mode: in which the agent moves them.
            search: homing method by which the drives, that then lose this reference again, find
                their home, and where that is (m or rad).

        Raises:
            Stopped: a position is out of the envelope, or a drive does not follow.
            ValueError: a drive is not referenced, or does not have the method.
        """
        others = {name: at for name, at in positions.items() if name not in self._axes}
        positions = {name: at for name, at in positions.items() if name in self._axes}
        for axis, position in positions.items():
            limits = self.guards[axis].envelope
            if not limits.low <= position <= limits.high:
                raise self.stop(Stopped(axis, f"the start {position:.4g} is out of the envelope"))
        try:
            if not self._sure:
                self._answering()
                if search is None and self.home is None:
                    self._referenced()
                self._sure = True
            if search is not None:
                self._can_search(*search)
            if not self.dry:
                self._go(positions, mode, None if search is None else search[0])
        except (ServoError, SdoAbort, TimeoutError) as error:
            said = f"on the way to the start: {error}"
            self.stop(Stopped("", said))
            self.stopped = Stopped("", f"{said}{self._side.trouble()}")
            raise self.stopped from error
        except BaseException as error:
            self.stop(error)
            raise
        here = {axis: self._at(axis) / self._units for axis in self._axes}
        for axis, position in here.items():
            self.guards[axis].begin(position)
            self._shift[axis], self._last[axis] = 0.0, (position, 0.0)
        self._deadline = self._side.pace.now()
        return others | here

    def _answering(self) -> None:
        """Raises Stopped, before there is power, where process data do not come back."""
        patience = BEAT if self._side.pace.real else LOCK_STEP_PATIENCE
        if not any(self._side.sample(patience) for _ in range(LIVES)):
            said = f"no process data come back{self._side.trouble()}"
            raise self.stop(Stopped("", said))

    def _referenced(self) -> None:
        """Raises ValueError for a drive that does not know where it is."""
        self.master.set_mode(Mode.HOMING)
        for axis in self._axes:
            if not int(self._side.port.upload(axis, "statusword")) & REFERENCED:
                raise ValueError(
                    f"{axis} is not referenced: home it with --home METHOD (6098h), once"
                )

    def _can_search(self, method: int, home: float) -> None:
        """Raises ValueError for a drive without the method; sets where it finds its home."""
        for axis in self._axes:
            model = self._side.port.models[axis]
            if method not in model.homing_methods:
                raise ValueError(
                    f"{axis}: drive {model.name!r} does not have the homing method {method} "
                    "by which the task knows its true home"
                )
            self._home_at[axis] = home
            self._set(axis, "home_offset", -round(home * self._units))

    def _go(self, positions: Mapping[str, float], mode: Mode, search: int | None) -> None:
        self.unwatched = self._side.arm(True)
        self.master.reset_fault()  # of a connection lost before; a cause that stays is told
        self._give_back("max_torque")  # an agent may have left its own
        self.master.enable()
        if search is not None:
            for axis in self._axes:
                self._set(axis, "homing_method", search)
            self.master.home(timeout=SEARCHES)
        elif self.home is not None:
            self.master.home(self.home)
            self.home = None
        wanted = {axis: round(place * self._units) for axis, place in positions.items()}
        if any(abs(self._at(axis) - wanted[axis]) > NEAR * self._units for axis in wanted):
            self.master.set_mode(Mode.PROFILE_POSITION)
            with self._gently():
                self.master.move_to(wanted)
        if search is not None:
            self._forget()
        for axis in self._axes:
            if "max_torque" in (self._rpdo.names or ()):
                self._set(axis, "max_torque", self._side.port.upload(axis, "max_torque"))
            for name in ("target_position", "target_velocity", "target_torque"):
                if name in (self._rpdo.names or ()):
                    value = self._at(axis) if name == "target_position" else 0
                    self._side.port.write(axis, name, value)
        self.master.set_mode(mode)
        pace = self._side.pace
        deadline = pace.now()
        for _ in range(math.ceil(REST / self._period)):
            deadline += self._period
            pace.wait(deadline)
            self._side.send()
            self._side.sample(self._period if pace.real else LOCK_STEP_PATIENCE)

    def _forget(self) -> None:
        """Begin a homing and interrupt it: a drive then has no reference (CiA 402-2, hm)."""
        self.master.set_mode(Mode.HOMING)
        self.master.control(ENABLED | C.NEW_SET_POINT)
        self.master.control(ENABLED)
        self.master.wait_until(
            lambda word: bool(word & S.TARGET_REACHED and not word & REFERENCED), FORGETS,
            "an interrupted homing takes the reference away",
        )
        for axis in self._axes:
            self._set(axis, "homing_method", self._side.port.models[axis].homes_here)

    @contextmanager
    def _gently(self) -> Iterator[None]:
        """A share of the profile's speed and accelerations, as long as this lasts."""
        for axis in self._axes:
            for name in PROFILE:
                with suppress(SdoAbort, ValueError):
                    value = self._side.port.upload(axis, name)
                    self._set(axis, name, max(round(APPROACH * value), 1))
        yield
        self._give_back(*PROFILE)

    def _at(self, axis: str) -> int:
        return int(self._side.port.upload(axis, "position_actual_value"))

    def idle(self) -> None:
        """The drives hear that this master is there, while nothing else is to be sent."""
        if self._side.pace.real:
            self._side.send()

    def settle(self) -> None:
        """Steps count from now on: the drives stand, and a policy may have taken its time."""
        self._deadline = self._side.pace.now()

    def look(self, world: np.ndarray, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Set-points out and answers in, without a step."""
        self._exchange(rpdos, tpdos, 0.0)

    def run(self, world: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Run cycles as `loop.run` does, for one world, images as bytes. Raises Stopped."""
        self._exchange(rpdos, tpdos, self._period)

    def _exchange(self, rpdos: np.ndarray, tpdos: np.ndarray, period: float) -> None:
        if self.stopped is not None:
            raise self.stopped
        try:
            if period:
                self._send(rpdos)
            else:
                self._command(rpdos.view(self._rpdo).reshape(-1))
                self._deadline = self._side.pace.now()
            self._ask(tpdos, period)
        except BaseException as error:
            self.stop(error)
            raise

    def _send(self, rpdos: np.ndarray) -> None:
        """Set-points, at their phase of the step."""
        pace, timing = self._side.pace, self.timing
        due = self._deadline + (self.phase * self._period if pace.real else 0.0)
        pace.wait(due)
        self._command(rpdos.view(self._rpdo).reshape(-1))
        now = pace.now()
        timing.sending.append(now - due)
        missed = now > self._deadline + self._period
        timing.missed += missed
        self._behind = self._behind + 1 if missed else 0
        if timing.row(self._behind) >= self.missed:
            raise Stopped("", f"{self.missed} set-points came a step late, one after the other")
        if missed:
            self._deadline = now - self.phase * self._period
        if time.monotonic() >= self._ends:
            raise Stopped("", f"the time limit of {self.time_limit:g} s is over")

    def _ask(self, tpdos: np.ndarray, period: float) -> None:
        """Answers, at the end of a step."""
        pace, timing = self._side.pace, self.timing
        self._deadline += period
        pace.wait(self._deadline)
        begin = pace.now()
        share = ANSWERS * self.phase * self._period
        came = self._side.sample(share if pace.real else LOCK_STEP_PATIENCE)
        if period:
            timing.waking.append(begin - self._deadline)
            timing.answers.append(pace.now() - begin)
        if came:
            self._running = 0
            self._answer(tpdos)
            return
        timing.lost, self._running = timing.lost + 1, self._running + 1
        if timing.row(self._running) >= self.missed:
            raise Stopped("", f"{self.missed} answers have not come, one after the other")

    def _command(self, images: np.ndarray) -> None:
        for axis, image in zip(self._axes, images.tolist(), strict=True):
            values = dict(zip(self._rpdo.names or (), image, strict=True))
            if values["controlword"] & ENABLED == ENABLED:  # whatever else it asks for
                self.guards[axis].command(values)
            if self.dry:
                values["controlword"] = 0
            for name, value in values.items():
                self._side.port.write(axis, name, value)
        self._side.send()
        self.sent = images.copy()

    def _answer(self, tpdos: np.ndarray) -> None:
        images, names = tpdos.view(self._tpdo).reshape(-1), self._tpdo.names or ()
        read = self._side.port.read
        answers = [{name: read(axis, name) for name in names} for axis in self._axes]
        for n, values in enumerate(answers):
            images[n] = (*values.values(),)
        self._mirror(answers)
        for axis, values in zip(self._axes, answers, strict=True):
            self.guards[axis].answer(values)
        if self.on_step is not None:
            self.on_step(images)

    def _mirror(self, answers: Sequence[Mapping[str, float]]) -> None:
        """What a task looks at in its machine."""
        machine, limited = self._machine, 0
        for axis, values in zip(self._axes, answers, strict=True):
            if axis in self._home_at:
                self._take_reference(axis, values)
            position = values["position_actual_value"] / self._units + self._shift[axis]
            machine._coordinates[0][self._qpos[axis]] = position
            limited |= int(values["statusword"]) & S.INTERNAL_LIMIT_ACTIVE
        machine.data.qpos[:] = machine._coordinates[0]
        machine.world["step_ticks"], machine.world["limited_ticks"] = 1, bool(limited)

    def _take_reference(self, axis: str, values: Mapping[str, float]) -> None:
        """Torque of a drive that looks for its home, and where it has found it."""
        n = [*self._machine.drives].index(axis)
        record, coupling = self._machine.axes[n], self._machine.couplings[n]
        record.torque = 1e-3 * values["torque_actual_value"] * record.rated_torque
        position, velocity = (
            values[f"{name}_actual_value"] / self._units for name in ("position", "velocity")
        )
        here = values["modes_of_operation_display"] == Mode.HOMING
        if here and int(values["statusword"]) & REFERENCED and not record.homed:
            before, speed = self._last[axis]
            moved = before + 0.5 * (speed + velocity) * self._period
            self._shift[axis] = moved - position
            place = (self._home_at[axis] + self._shift[axis]) * coupling.gear
            record.zero_counts = round((place + record.home_offset) / record.rad_per_increment)
            record.homed = 1
        self._last[axis] = position + self._shift[axis], velocity

    def stop(self, error: BaseException) -> Stopped:
        """Quick stop of all drives and power off; -> why, which every further step raises."""
        if self.stopped is None:
            name = "Ctrl-C" if isinstance(error, KeyboardInterrupt) else f"{error}" or f"{error!r}"
            told = error if isinstance(error, Stopped) else Stopped("", name)
            self.stopped = told
            torque = partial(self._give_back, "max_torque")  # all of it, to brake
            acts: list[Callable[[], object]] = [
                torque, partial(self.master.control, QUICK_STOP), self._side.send,
                self.master.quick_stop, partial(self.master.control, 0), self._side.send,
                self._give_back, partial(self._side.arm, False),
            ]
            for act in acts if self._begun else [self._give_back]:
                _insist(act)
        return self.stopped

    def close(self) -> None:
        """The axes come to rest and lose their power."""
        self.stop(Stopped("", "closed"))

    def state(self) -> Any:
        """Raises TypeError: drives on a bus cannot be copied."""
        raise TypeError("an environment on a port cannot be copied or pickled: make another one")

    def become(self, state: Any) -> None:
        """Raises TypeError: drives on a bus cannot be copied."""
        self.state()
