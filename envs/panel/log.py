"""The log of events: each command, refusal, fault and stop, with time, reason and remedy."""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

KEPT = 5000  # events
KINDS = ("command", "done", "refused", "fault", "stop", "info", "alarm")


class Event(NamedTuple):
    """An event of the log."""

    number: int
    kind: str  # one of KINDS; info and alarm are shown in every window
    text: str
    time: float  # s of the panel
    axis: str
    window: str  # the window that has commanded, or nothing
    reason: str
    remedy: str


class Log:
    """The latest events, the newest last."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._number = 0

    def enter(self, kind: str, *fields: Any) -> None:
        """Add an event with the fields of `Event` after its kind. Raises ValueError for a kind."""
        if kind not in KINDS:
            raise ValueError(f"kind {kind!r}: use one of {', '.join(KINDS)}")
        self._number += 1
        self.events = [*self.events[1 - KEPT :], Event(self._number, kind, *fields)]

    def csv(self) -> str:
        """All events as a table."""
        heading = ["number", "time (s)", "kind", "axis", "by", "event", "reason", "remedy"]
        return table([heading, *(
            (e.number, f"{e.time:.4f}", e.kind,
             *map(plain, (e.axis, e.window, e.text, e.reason, e.remedy)))
            for e in self.events
        )])


def table(rows: Iterable[Sequence[Any]]) -> str:
    """Rows as the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue()


def plain(text: str) -> str:
    """Make a text safe for a cell, so that a spreadsheet does not take it for a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
