"""The connection between an environment and its drives on a bus: episodes, steps and stops."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from ....drive.kernel.words import ENABLED, Mode
from ....drive.master.errors import ServoError
from ....drive.master.master import Master
from ....drive.objects.abort import SdoAbort
from ...engine.machine import Machine
from ..envelope import Guard, Stopped
from ..timing import Timing
from . import limits
from .identity import differences, identify
from .mirror import Mirror
from .pace import LOCK_STEP_PATIENCE
from .settings import Settings
from .side import DriveSide
from .start import Search, Start

PHASE = 0.4  # of a step, at which set-points are sent; bus and policy have answered by then
LAST = 0.8  # of a step, after which a policy's answer is too late for it
ANSWERS = 0.7  # share of the phase for the drives' answers; the policy has the remainder
FIRST_ANSWER = 0.02  # s for the answers to each of the first questions
QUESTIONS = 4  # before an episode, until drives count as silent
MISSED, BRIDGED = 3, 0.01  # steps, and time (s), without answers or actions until a guard stops
INTERPOLATION = ("interpolation_time_period_value", "interpolation_time_index")  # 60C2h
QUICK_STOP = 0x02  # controlword


class PortLine:
    """The connection between an environment and its drives on a bus.

    Args:
        machine: of the environment.
        axes: names of the drives its agent commands.
        images: records of their RPDOs and TPDOs.
        pdos: the objects of each, divided into PDOs.
        period: of the agent's steps (s).
        units: position units per m or rad.
        side: the drives.
        referenced: whether the drives have a reference at the beginning of an episode. Software
            limits do not apply without one, so the guard uses the end stops of `machine`.

    Attributes:
        guards: the guard of each drive.
        differs: descriptions of the drives' settings that differ from those of the task.
        timing: when the steps happened.
        phase: share of a step at which set-points are sent.
        missed: steps in a row without answers, set-points or actions in time, after which the
            guard stops the drives.
        time_limit: for all episodes (s), from the first one on.
        unwatched: drives without a watchdog for a lost master.
        refused: what the operating system has refused of real-time operation.
        home: method (6098h) by which the drives are homed before the first episode.
        dry: keep the power stages off.
        stopped: why the drives have been stopped.
        on_step: called with the answers of each step.
        sent: the last commands.

    Raises:
        ValueError: a drive that is not the model, or has no limits; a set-point without a guard.
    """

    def __init__(
        self, machine: Machine, axes: Sequence[str], images: Sequence[np.dtype],
        pdos: Sequence[Sequence[Sequence[str]]], period: float, units: float, side: DriveSide,
        referenced: bool = True,
    ):
        self._axes, self._period, self._units = [*axes], period, units
        self._rpdo, self._tpdo = images
        self._side = side
        commanded = self._rpdo.names or ()
        limits.check_guarded(commanded)
        side.connect(self._axes, *pdos)
        port = side.port
        self.master = Master(port, *self._axes)
        identify(port, self._axes, machine)
        self.settings = Settings(port)
        for axis in self._axes:
            for name in INTERPOLATION:
                if name in machine.drives[axis].objects.names:
                    self.settings.set(axis, name, machine.drives[axis].read(name))
        self.differs = [*differences(port, self._axes, machine)]
        self.guards = {
            axis: Guard(axis, limits.envelope(
                axis, side.envelopes, port, machine, units=units, period=period,
                referenced=referenced,
            ), period, 1 / units, 1 / units)
            for axis in self._axes
        }
        self._start = Start(self.master, side, self.settings, commanded, units, period)
        self._mirror = Mirror(machine, self._axes, units, period)
        self.timing = Timing(period)
        self.phase = PHASE
        self.missed = steps_bridged(period)
        self.time_limit = math.inf
        self.unwatched: list[str] = []
        self.refused: list[str] = []
        self.home: int | None = None
        self.dry = False
        self.stopped: Stopped | None = None
        self.on_step: Callable[[np.ndarray], object] | None = None
        self.sent: np.ndarray | None = None
        self._begun = False  # an episode; until then the drives get no power from here
        self._checked = False
        self._unanswered = self._late = 0  # steps in a row
        self._deadline, self._ends = 0.0, math.inf

    @property
    def lost(self) -> int:
        """Number of steps in which not all answers arrived."""
        return self.timing.lost

    @property
    def patience(self) -> float:
        """Time (s) left for the policy; longer than `phase`, as late is better than never."""
        if not self._side.pace.real:
            return LOCK_STEP_PATIENCE
        return max(self._deadline + LAST * self._period - self._side.pace.now(), 0.0)

    @property
    def time(self) -> float:
        """Time (s) of the clock that schedules the steps."""
        return self._side.pace.now()

    # ---------------------------------------------------------------- episodes

    def check(self, referenced: bool = True) -> None:
        """See, before the drives get power, that they answer and have or will get a reference.

        Args:
            referenced: whether the episodes begin with a reference.

        Raises:
            Stopped: no process data come back.
            ValueError: a drive is not referenced and `home` is not set.
        """
        if self._checked:
            return
        self._side.awake()
        patience = FIRST_ANSWER if self._side.pace.real else LOCK_STEP_PATIENCE
        if not any(self._side.sample(patience) for _ in range(QUESTIONS)):
            raise Stopped("", f"no process data come back{self._side.trouble()}")
        if referenced and self.home is None:
            self._start.check_referenced()
        self._checked = True

    def begin(self, random: np.random.Generator) -> None:
        """Prepare an episode. Raises Stopped after a stop."""
        if self.stopped is not None:
            raise self.stopped
        self._begun = True
        self._side.awake()
        self._unanswered = self._late = 0
        if self._ends == math.inf:
            self._ends = time.monotonic() + self.time_limit

    def place(
        self, positions: Mapping[str, float], mode: Mode,
        search: tuple[int, float] | None = None,
    ) -> dict[str, float]:
        """Enable the drives and move them to positions (m or rad); -> where they stand.

        A drive that the agent does not command is taken to stand where it should. With `dry` the
        drives stay where they are.

        Args:
            positions: by drive.
            mode: the mode of operation in which the agent moves them.
            search: homing method and home (m or rad) by which the drives are homed first; they lose
                this reference again.

        Raises:
            Stopped: a position is outside the envelope, or a drive does not follow.
            ValueError: a drive is not referenced, or does not have the method.
        """
        others = {name: at for name, at in positions.items() if name not in self._axes}
        own = {name: at for name, at in positions.items() if name in self._axes}
        homing = None if search is None else Search(*search)
        try:
            for axis, position in own.items():
                envelope = self.guards[axis].envelope
                if not envelope.low <= position <= envelope.high:
                    raise Stopped(axis, f"the start {position:.4g} is out of the envelope")
            self.check(referenced=homing is None)
            if homing is not None:
                self._start.prepare(homing)
            if not self.dry:
                self.unwatched = self._side.arm(True)
                self._start.go(own, mode, homing, self.home)
                self.home = None
        except (ServoError, SdoAbort, TimeoutError) as error:
            said = f"on the way to the start: {error}"
            self.stop(Stopped("", said))
            self.stopped = Stopped("", f"{said}{self._side.trouble()}")
            raise self.stopped from error
        except BaseException as error:
            self.stop(error)
            raise
        here = {axis: self._start.position(axis) / self._units for axis in self._axes}
        for axis, position in here.items():
            self.guards[axis].begin(position)
        self._mirror.begin(here, None if homing is None else homing.home)
        self._deadline = self._side.pace.now()
        return others | here

    def idle(self) -> None:
        """Keep the watchdogs of the drives satisfied while nothing else is to be sent."""
        if self._side.pace.real:
            self._side.send()

    def settle(self) -> None:
        """Schedule the steps from now on: the drives stand, and a policy may have taken long."""
        self._deadline = self._side.pace.now()

    # ------------------------------------------------------------------- steps

    def look(self, world: np.ndarray, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Exchange set-points and answers outside a step."""
        self._exchange(rpdos, tpdos, 0.0)

    def run(self, world: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Run a step as `loop.run` does, for one world, images as bytes. Raises Stopped."""
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
        """Send the set-points at their phase of the step."""
        pace, timing = self._side.pace, self.timing
        due = self._deadline + (self.phase * self._period if pace.real else 0.0)
        pace.wait(due)
        self._command(rpdos.view(self._rpdo).reshape(-1))
        now = pace.now()
        timing.sending.append(now - due)
        missed = now > self._deadline + self._period
        timing.missed += missed
        self._late = self._late + 1 if missed else 0
        if timing.row(self._late) >= self.missed:
            raise Stopped("", f"{self.missed} set-points came a step late, one after the other")
        if missed:
            self._deadline = now - self.phase * self._period
        if time.monotonic() >= self._ends:
            raise Stopped("", f"the time limit of {self.time_limit:g} s is over")

    def _ask(self, tpdos: np.ndarray, period: float) -> None:
        """Request the answers at the end of a step."""
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
            self._unanswered = 0
            self._answer(tpdos)
            return
        timing.lost, self._unanswered = timing.lost + 1, self._unanswered + 1
        if timing.row(self._unanswered) >= self.missed:
            raise Stopped("", f"{self.missed} answers have not come, one after the other")

    def _command(self, images: np.ndarray) -> None:
        """Let the guards check the commands and send them."""
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
        """Give the answers to the agent, the machine of the task and the guards."""
        images, names = tpdos.view(self._tpdo).reshape(-1), self._tpdo.names or ()
        read = self._side.port.read
        answers = [{name: read(axis, name) for name in names} for axis in self._axes]
        for n, values in enumerate(answers):
            images[n] = (*values.values(),)
        self._mirror.show(answers)
        for axis, values in zip(self._axes, answers, strict=True):
            self.guards[axis].answer(values)
        if self.on_step is not None:
            self.on_step(images)

    # -------------------------------------------------------------------- stop

    def stop(self, error: BaseException) -> Stopped:
        """Stop all drives by quick stop and switch them off; -> the reason, kept from then on.

        Every later step raises it. Only the first reason counts.
        """
        if self.stopped is None:
            name = "Ctrl-C" if isinstance(error, KeyboardInterrupt) else f"{error}" or f"{error!r}"
            self.stopped = error if isinstance(error, Stopped) else Stopped("", name)
            restore = self.settings.restore
            acts: list[Callable[[], object]] = [
                partial(restore, "max_torque"),  # the drive brakes with all its torque
                partial(self.master.control, QUICK_STOP), self._side.send,
                self.master.quick_stop, partial(self.master.control, 0), self._side.send,
                restore, partial(self._side.arm, False),
            ]
            for act in acts if self._begun else [restore]:
                _insist(act)
        return self.stopped

    def close(self) -> None:
        """Bring the axes to rest and switch their power off."""
        self.stop(Stopped("", "closed"))

    def state(self) -> Any:
        """Raise TypeError: drives on a bus cannot be copied."""
        raise TypeError("an environment on a port cannot be copied or pickled: make another one")

    def become(self, state: Any) -> None:
        """Raise TypeError: drives on a bus cannot be copied."""
        self.state()


def steps_bridged(period: float) -> int:
    """Return how many steps (s) without answers or actions a guard tolerates by default."""
    return max(MISSED, math.ceil(BRIDGED / period))


def _insist(act: Callable[[], object]) -> None:
    """Call `act` and ignore its errors; a repeated Ctrl-C does not cut it short."""
    while True:
        try:
            act()
        except KeyboardInterrupt:
            continue
        except BaseException:
            pass
        return
