"""An exercise in Python: a fresh machine, a master judged in every cycle, and a report."""

from collections.abc import Callable
from pathlib import Path

from ...drive.drive import Drive
from ...drive.master import Master
from ..masters.port import MachinePort
from ..plants.catalogue import fresh
from .attempt import Attempt, Report
from .exercise import Exercise, named


class Laboratory:
    """A fresh machine on which an exercise has begun.

    >>> laboratory = Laboratory("32_units")
    >>> laboratory.master.enable()
    >>> laboratory.drive.write("target_position", 75_000)
    >>> laboratory.wait(1.0)
    >>> laboratory.report.wrong
    ''

    Args:
        exercise: name of a shipped exercise, path of a file, or an `Exercise`.
        drive: drive model by name or folder.

    Raises:
        ValueError: the exercise does not exist, or the machine cannot begin it.
    """

    def __init__(self, exercise: str | Exercise, drive: str = "generic"):
        chosen = _chosen(exercise)
        self.machine = fresh(chosen.axis, drive)
        self._fresh = self.machine.snapshot()
        self.axis = next(iter(self.machine.drives))
        self.begin(chosen)

    def begin(self, exercise: str | Exercise) -> None:
        """Begin an exercise on a fresh machine; nothing is left of earlier attempts."""
        self.exercise = _chosen(exercise)
        self.machine.restore(self._fresh)
        self.attempt = Attempt(self.exercise, self.machine, self.axis)
        self.master = Master(MachinePort(self.machine, self.attempt.look), self.axis)

    @property
    def drive(self) -> Drive:
        """The drive of the axis; time advances with `wait` or the master."""
        return self.machine.drives[self.axis]

    @property
    def report(self) -> Report:
        """The result so far."""
        return self.attempt.report

    def control(self, *controlwords: int) -> None:
        """Send controlwords one after the other, for ten position cycles each."""
        for controlword in controlwords:
            self.drive.write("controlword", controlword)
            self.wait(10 * self.machine.cycle_time)

    def wait(self, seconds: float) -> None:
        """Advance time, judged cycle by cycle."""
        self.master.wait(seconds)

    def wait_until(self, condition: Callable[[], bool], timeout: float = 10.0) -> None:
        """Advance time until a condition holds. Raises TimeoutError after `timeout` (s)."""
        for _ in range(round(timeout / self.machine.cycle_time)):
            if condition():
                return
            self.wait(self.machine.cycle_time)
        raise TimeoutError(f"not within {timeout:g} s: {self.drive.describe()}")

    def predict(self, option: int) -> bool:
        """Answer the question of the step; -> whether the answer is correct."""
        return self.attempt.predict(option)


def _chosen(exercise: str | Exercise) -> Exercise:
    return exercise if isinstance(exercise, Exercise) else named(exercise)


def check(file: str | Path, drive: str = "generic") -> Report:
    """Run a solution and judge it.

    A solution is a Python file with ``EXERCISE``, a name, and ``solve(laboratory)``. It runs as
    code, so check only files whose author you trust, or check them where they can do no harm.

    Raises:
        ValueError: the file has no EXERCISE or no `solve`.
        Exception: any exception of the solution.
    """
    text = Path(file).read_text(encoding="utf-8")
    names: dict = {"__name__": "solution", "__file__": str(file)}
    exec(compile(text, str(file), "exec"), names)
    if not isinstance(names.get("EXERCISE"), str) or not callable(names.get("solve")):
        raise ValueError(f'{file}: write EXERCISE = "32_units" and def solve(laboratory)')
    laboratory = Laboratory(names["EXERCISE"], drive)
    names["solve"](laboratory)
    return laboratory.report
