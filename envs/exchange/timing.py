"""When the steps of an environment on a bus happened, against when they should have."""

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
        waking: after the planned time, until this process went on.
        answers: from the question (SYNC, or the frame that reads) to the last answer.
        thinking: that the policy took.
        sending: after the planned time, until the set-points went out.
        missed: steps whose set-points were later than the step is long.
        lost: steps without all the answers.
        stale: steps in which the policy had not answered, and its last action went on.
        in_a_row: the most of one of these three, one after the other.
    """

    EDGES = EDGES
    KINDS = ("waking", "answers", "thinking", "sending")

    def __init__(self, period: float):
        self.period = period
        self.waking, self.answers, self.thinking, self.sending = (array("d") for _ in self.KINDS)
        self.missed = self.lost = self.stale = self.in_a_row = 0

    def rows(self) -> list[Row]:
        """Each time that was measured, in the order of a step."""
        rows = []
        for what in self.KINDS:
            values = np.array(getattr(self, what)) * 1e6
            if len(values):
                median, p99, p999, most = np.percentile(values, (50, 99, 99.9, 100))
                counts = np.histogram(np.maximum(values, 0.0), EDGES)[0]
                rows.append(Row(what, median, p99, p999, most, tuple(counts.tolist())))
        return rows

    def row(self, steps: int) -> int:
        """Take note of so many such steps one after the other; returns their number."""
        self.in_a_row = max(self.in_a_row, steps)
        return steps

    @property
    def share(self) -> float:
        """Of the time of all steps, what the policy thought."""
        return sum(self.thinking) / (len(self.waking) * self.period) if self.waking else 0.0

    def as_dict(self) -> dict[str, object]:
        """All of it as numbers, for a report."""
        rows = {row.what: row._asdict() for row in self.rows()}
        return rows | {
            "steps": len(self.waking), "period": self.period, "missed": self.missed,
            "lost": self.lost, "stale": self.stale, "in_a_row": self.in_a_row, "share": self.share,
        }
