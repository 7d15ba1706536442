"""When the steps of an environment on a bus happened, compared with their schedule."""

from array import array
from typing import NamedTuple

import numpy as np

EDGES = np.array([0, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, np.inf])  # µs


class Row(NamedTuple):
    """The distribution of one time."""

    what: str
    median: float  # µs
    p99: float  # µs
    p999: float  # µs
    most: float  # µs
    counts: tuple[int, ...]  # between `EDGES`


class Timing:
    """Times of each step (s).

    Attributes:
        waking: delay from the scheduled time until this process woke up.
        answers: time from the request (SYNC, or the frame that reads) to the last answer.
        thinking: time that the policy took.
        sending: delay from the scheduled time until the set-points were sent.
        missed: number of steps whose set-points were sent after the step had ended.
        lost: number of steps without all answers.
        stale: number of steps in which the previous action was used, as the policy was late.
        in_a_row: the largest number of consecutive steps of one of these three kinds.
    """

    EDGES = EDGES
    KINDS = ("waking", "answers", "thinking", "sending")

    def __init__(self, period: float):
        self.period = period
        self.waking, self.answers, self.thinking, self.sending = (array("d") for _ in self.KINDS)
        self.missed = self.lost = self.stale = self.in_a_row = 0

    def rows(self) -> list[Row]:
        """Return the distribution of each time that was measured, in the order of a step."""
        rows = []
        for what in self.KINDS:
            values = np.array(getattr(self, what)) * 1e6
            if len(values):
                median, p99, p999, most = np.percentile(values, (50, 99, 99.9, 100))
                counts = np.histogram(np.maximum(values, 0.0), EDGES)[0]
                rows.append(Row(what, median, p99, p999, most, tuple(counts.tolist())))
        return rows

    def row(self, steps: int) -> int:
        """Record that so many steps of a kind occurred in a row, and return their number."""
        self.in_a_row = max(self.in_a_row, steps)
        return steps

    @property
    def share(self) -> float:
        """Share of the total time that the policy took."""
        return sum(self.thinking) / (len(self.waking) * self.period) if self.waking else 0.0

    def as_dict(self) -> dict[str, object]:
        """Return all values for a report."""
        rows = {row.what: row._asdict() for row in self.rows()}
        return rows | {
            "steps": len(self.waking), "period": self.period, "missed": self.missed,
            "lost": self.lost, "stale": self.stale, "in_a_row": self.in_a_row, "share": self.share,
        }
