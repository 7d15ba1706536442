"""Journal: all actions on a machine from outside, by cycle, so that a run can be replayed.

Pages, masters and experiments reach the drives of a session only through `ACTS`. A run consists of
all actions since an exercise began, each with its position cycle. On a fresh machine of the same
kind, the same actions at the same cycles cause the same motion, bit for bit, and the same verdict.
"""

import base64
import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ...drive.objects.abort import SdoAbort
from ..course.attempt import Attempt
from ..course.exercise import Exercise, disturb
from ..engine.machine import Machine
from ..plants.catalogue import fresh

FORM = "servogym run 1"


def _parameters(machine: Machine, axis: str, content: str) -> str:
    return machine.drives[axis].use_parameters(base64.b64decode(content))


# a journal contains JSON: the name of an action, then its arguments
ACTS: dict[str, Callable[..., Any]] = {
    "write": lambda machine, axis, *arguments: machine.drives[axis].write(*arguments),
    "commission": lambda machine, axis, values: machine.drives[axis].commission(values),
    "parameters": _parameters,
    "inject": lambda machine, axis, cause: machine.drives[axis].inject(cause),
    "clear": lambda machine, axis: machine.drives[axis].clear_injected(),
    "ail": disturb,
}
# actions on the attempt instead of the machine
ANSWERS: dict[str, Callable[..., Any]] = {
    "hint": Attempt.hint, "predict": Attempt.predict, "lose": Attempt.lose,
}
CYCLES = "cycles"  # position cycles of an exchange, from here on


class Journal:
    """The actions of a run, by position cycles since it began."""

    def __init__(self) -> None:
        self.cycle = 0
        self.events: list[list[Any]] = []
        self._cycles = 0

    def enter(self, what: str, *arguments: Any) -> None:
        """Record an action at the present cycle."""
        self.events.append([self.cycle, what, *map(_plain, arguments)])

    def passed(self, cycles: int) -> None:
        """Count position cycles, which form one exchange."""
        if cycles != self._cycles:
            self._cycles = cycles
            self.events.append([self.cycle, CYCLES, cycles])
        self.cycle += cycles


def _plain(value: Any) -> Any:
    """Convert a value for JSON; numbers keep all their digits."""
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    return value.item() if hasattr(value, "item") else value


def outcome(kind: str, drive: str, axis: str, attempt: Attempt, journal: Journal) -> dict[str, Any]:
    """A run, as stored in its file.

    Args:
        kind: kind of the machine, key of `plants.catalogue.AXES`.
        drive: drive model.
        axis: the axis that was judged.
        attempt: the attempt at the exercise.
        journal: the journal since the exercise began.
    """
    return {
        "form": FORM, "exercise": attempt.exercise.name, "machine": kind, "drive": drive,
        "axis": axis, "cycles": journal.cycle, "report": asdict(attempt.report),
        "events": journal.events,
    }


def read(path: str | Path) -> dict[str, Any]:
    """Read a run from a file. Raises ValueError for anything else."""
    try:
        run = json.loads(Path(path).read_text(encoding="utf-8"))
        if not isinstance(run, dict) or run.get("form") != FORM:
            raise ValueError(f"it does not say {FORM!r}")
        for cycle, what, *_ in run["events"]:
            if not (isinstance(cycle, int) and what in {*ACTS, *ANSWERS, CYCLES}):
                raise ValueError(f"{[cycle, what]} is not an event")
        return run
    except (OSError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not a run of an exercise: {error}") from None


def play(
    run: Mapping[str, Any], exercise: Exercise,
    tell: Callable[[float, str], object] = lambda time, text: None,
) -> Attempt:
    """Replay a run on a fresh machine, exchange by exchange; -> the attempt.

    Args:
        run: the run, as `read` returns it.
        exercise: the exercise that it names.
        tell: receives the time (s) and a description of each action.

    Raises:
        ValueError: there is no such machine.
    """
    machine = fresh(str(run["machine"]), str(run["drive"]))
    attempt = Attempt(exercise, machine, str(run["axis"]))
    cycle, exchange, last = 0, 1, int(run["cycles"])
    events = deque(run["events"])
    while True:
        while events and events[0][0] <= cycle:
            _, what, *arguments = events.popleft()
            if what == CYCLES:
                exchange = int(arguments[0])
                continue
            said = f"{what} {', '.join(map(str, arguments))}"
            try:
                if what in ACTS:
                    ACTS[what](machine, *arguments)
                else:
                    ANSWERS[what](attempt, *arguments)
            except (SdoAbort, ValueError, TypeError) as error:  # refused as in the run
                said += f": {error}"
            tell(cycle * machine.cycle_time, said)
        if cycle >= last:
            return attempt
        passed = max(min(exchange, last - cycle), 1)
        machine.step(passed)
        cycle += passed
        attempt.look()


def same(run: Mapping[str, Any], attempt: Attempt) -> bool:
    """Whether a replay has the result that the run states."""
    was, now = dict(run["report"]), asdict(attempt.report)
    times = zip(was.pop("times"), now.pop("times"), strict=False)
    return was == now and all(math.isclose(a, b, abs_tol=1e-9) for a, b in times)
