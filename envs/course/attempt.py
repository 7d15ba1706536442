"""An attempt at an exercise: a fresh machine, and a judge that evaluates every cycle."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...drive.advice import cause_of, refused
from ...drive.kernel.words import Mode, command_of
from ..engine.machine import Machine
from ..masters.port import MachinePort
from .condition import Look, holds
from .exercise import Exercise, Step

START_HOMING = 0x10  # bit 4 of the controlword in mode hm
JUMP = 10  # position cycles between two looks at most; a longer gap was not observed
SHIFT = 2.0  # mm or °, by which elasticity and noise may move the reference
# objects by which an exercise is measured: home offset, polarity, units, rated values, standstill
RULER = frozenset((0x606F, 0x6070, 0x6075, 0x6076, 0x607C, 0x607E, *range(0x6089, 0x6098), 0x60A8,
                   0x60A9, 0x60AA, 0x60AB))
# sources of a look: fields of the record, and variables of the object dictionary
DISCRETE = ("state", "mode", "fault", "refused_command", "homed", "standstill")
WORDS = ("controlword", "homing_method")
MEASURED = (
    "position_actual_value", "velocity_actual_value", "torque_actual_value",
    "following_error_actual_value",
)
REFERENCE = frozenset(("homed", "homing"))  # keys of a goal that gives an axis its reference


class Observer:
    """Observes a drive: its state, and the parameters that have changed.

    It compares the bytes of the parameters, so it notices every change, whether by a page, an SDO
    or a PDO.

    Args:
        machine: the machine.
        axis: name of the drive in it.
    """

    def __init__(self, machine: Machine, axis: str):
        self.machine, self.drive = machine, machine.drives[axis]
        units = MachinePort(machine).units(axis)
        scale = 1e3 if units.name == "m" else math.degrees(1.0)
        self._position, self._velocity = units.position * scale, units.velocity * scale
        slots = [
            slot
            for slot in self.drive.objects.slots.within("axis")
            if slot.row.format and slot.row.access == "rw" and slot.row.index >= 0x2000
            and not slot.row.name.startswith(("controlword", "target_", "modes_of_operation"))
        ]
        self._slots = {slot.row.name: slot for slot in slots}
        self.ruler = {slot.row.name: slot.row for slot in slots if slot.row.index in RULER}
        sizes = [(slot.row.name, slot.offset, slot.code.size) for slot in slots]
        self._places = np.concatenate([np.arange(at, at + size) for _, at, size in sizes])
        self._owner = np.repeat(np.arange(len(sizes)), [size for *_, size in sizes])
        self._names = [name for name, *_ in sizes]
        self._bytes = np.frombuffer(slots[0].view, np.uint8)
        # an attribute of the record takes a microsecond, a column a tenth of it
        axes, self._index = np.asarray(self.drive.axes), self.drive.index
        self._joint, self._scale = int(machine.coupling(axis).qpos), scale
        self._axes = [axes[name] for name in DISCRETE]
        self._words = [axes["od"][name] for name in WORDS]
        self._measured = [axes["od"][name] for name in MEASURED]
        self.begin()

    def begin(self) -> None:
        """Start counting refusals, writes and the largest torque."""
        self.drive.axis.refused_command = 0
        self._before = self._bytes[self._places].tobytes()
        self._key: tuple[int, ...] = ()
        self._values = {name: float(slot.get()) for name, slot in self._slots.items()}
        self._peak = 0.0

    def look(self) -> Look:
        """Return the present state of the drive."""
        index, written = self._index, frozenset[str]()
        now = self._bytes[self._places].tobytes()
        if now != self._before:
            pair = (np.frombuffer(each, np.uint8) for each in (now, self._before))
            changed = np.unique(self._owner[np.not_equal(*pair)])
            written = frozenset(self._names[i] for i in changed)
            self._values = self._values | {n: float(self._slots[n].get()) for n in written}
            self._before = now
        key = tuple(int(column.item(index)) for column in (*self._axes, *self._words))
        if key != self._key:
            self._key, self._discrete = key, self._named()
        position, velocity, torque, error = (float(column.item(index)) for column in self._measured)
        self._peak = max(self._peak, abs(torque))
        return Look(
            self.machine.time, *self._discrete, position * self._position,
            velocity * self._velocity, torque, self._peak, error * self._position, written,
            self._values,
        )

    def datum(self, look: Look) -> float:
        """Return the joint position at which the drive shows 0 (mm or °)."""
        return float(self.machine.data.qpos[self._joint]) * self._scale - look.position

    def _named(self) -> tuple[str, str, str, str, str, bool, int, bool]:
        """The part of a look that consists of names, which changes rarely."""
        drive, axis = self.drive, self.drive.axis
        controlword, mode = int(axis.od.controlword), drive.mode
        homing = mode == Mode.HOMING and controlword & START_HOMING and drive.energised
        return (
            drive.state.name, command_of(controlword).name, mode.name, cause_of(axis),
            refused(axis), bool(axis.homed), int(axis.od.homing_method) if homing else 0,
            not axis.standstill,
        )


@dataclass
class Report:
    """The result of an attempt.

    Args:
        exercise: its name.
        done: whether all steps are done.
        step: number of steps that are done.
        wrong: the message of a wrong approach, empty without one.
        times: times of the steps that are done (s since the exercise began).
        hints: number of hints used.
        predictions: for each question, whether it was answered correctly.
    """

    exercise: str
    done: bool
    step: int
    wrong: str
    times: list[float]
    hints: int
    predictions: list[bool]


class Attempt:
    """An exercise in progress on an axis of a machine.

    Args:
        exercise: the exercise.
        machine: a fresh machine, as `servogym.envs.plants.catalogue.power_on` leaves it.
        axis: name of the drive.
        tell: called with a line when a step is done or lost.

    Raises:
        ValueError: the machine cannot begin as the exercise says.
    """

    def __init__(
        self, exercise: Exercise, machine: Machine, axis: str = "x",
        tell: Callable[[str], None] = lambda text: None,
    ):
        self.exercise, self.machine, self.axis = exercise, machine, axis
        self.wrong = ""
        self.step = 0
        self.times: list[float] = []
        self.hints = 0
        self.predictions: list[bool] = []
        self._tell = tell
        self._predicted = False
        self._time = 0.0  # s, sum over the looks
        self._datum: float | None = None  # of the reference that a goal has asked for
        exercise.begin.act(machine, axis)
        machine.step(2)
        self._observer = Observer(machine, axis)
        self._ruler = self._observer.ruler.keys() - exercise.asked_for
        self._last = machine.time
        self._enter()

    @property
    def done(self) -> bool:
        """Whether all steps are done."""
        return self.step >= len(self.exercise.steps)

    @property
    def present(self) -> Step | None:
        """The step to be done, None when all are done."""
        return None if self.done else self.exercise.steps[self.step]

    @property
    def asks(self) -> bool:
        """Whether the step waits for a prediction."""
        present = self.present
        return present is not None and present.predict is not None and not self._predicted

    @property
    def report(self) -> Report:
        """The result so far."""
        return Report(
            self.exercise.name, self.done, self.step, self.wrong, [*self.times], self.hints,
            [*self.predictions],
        )

    def predict(self, option: int) -> bool:
        """Answer the question of the step, once; returns whether the answer is right.

        Raises ValueError: there is no question now, or no such option.
        """
        present = self.present
        if present is None or present.predict is None or self._predicted:
            raise ValueError("there is no question now: look at `asks`")
        if not 0 <= option < len(present.predict.options):
            raise ValueError(f"option = {option!r} is out of 0..{len(present.predict.options) - 1}")
        self._predicted = True
        self.predictions.append(option == present.predict.answer)
        return self.predictions[-1]

    def hint(self) -> str:
        """Return the next hint of the step and count it; after the last, return the last again."""
        hints = self.present.hints if self.present else ()
        if not hints:
            return ""
        if self._hinted < len(hints):
            self._hinted += 1
            self.hints += 1
        return hints[self._hinted - 1]

    @property
    def hinted(self) -> tuple[str, ...]:
        """The hints of the step given so far."""
        return self.present.hints[: self._hinted] if self.present else ()

    def look(self) -> None:
        """Judge the cycle that has passed; call it after each position cycle."""
        present = self.present
        if present is None or self.wrong:
            return
        now = self.machine.time
        passed, self._last = now - self._last, now
        if not 0.0 <= passed <= JUMP * self.machine.cycle_time:
            self.lose("The machine was switched off and on: the progress is lost.")
            return
        self._time += passed
        look = self._observer.look()
        if why := self._measured_otherwise(look):
            self.lose(why)
            return
        for when, say in present.wrong:
            if holds(look, when):
                self.lose(say)
                return
        if present.throughout and not holds(look, present.throughout):
            self.lose(f"This has to hold all the time: {_words(present.throughout)}.")
            return
        if holds(look, present.goal[self._reached]):
            if not REFERENCE.isdisjoint(present.goal[self._reached]):
                self._datum = self._observer.datum(look)
            self._reached += 1
        if self._reached < len(present.goal):
            return
        if self.asks:
            self.lose("Answer the question before you do the step.")
            return
        self.times.append(self._time)
        self.step += 1
        self._tell(f"step {self.step} of {self.exercise.title!r} is done")
        self._enter()

    def _measured_otherwise(self, look: Look) -> str:
        """Explain why numbers of the drive have changed their meaning; empty if they have not."""
        if changed := look.written & self._ruler:
            row = self._observer.ruler[min(changed)]
            return (
                f"You changed {row.index:04X}h, {row.name.replace('_', ' ')}: the exercise is "
                "measured by it, so leave it as it was."
            )
        present = self.present
        if self._datum is None or present is None or any(
            not REFERENCE.isdisjoint(goal) for goal in present.goal[self._reached :]
        ):
            return ""
        if abs(self._observer.datum(look) - self._datum) <= SHIFT:
            return ""
        return "You made another position the reference: positions here count from the first one."

    def lose(self, why: str) -> None:
        """End the attempt with a reason; an attempt that has already ended does not change."""
        if self.done or self.wrong:
            return
        self.wrong = why
        self._tell(f"{why} Begin the exercise again.")

    def _enter(self) -> None:
        """Begin the step."""
        self._reached, self._hinted = 0, 0
        self._predicted = False
        present = self.present
        if present is not None:
            present.begin.act(self.machine, self.axis)
            self._observer.begin()


def _words(condition: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in condition.items())
