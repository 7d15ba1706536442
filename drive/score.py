"""How a model answers where a real drive has answered: each answer scored, differences named."""

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum

from .model.rows import Object

SERIAL = (0x1018, 4)
STATUSWORD, ERROR_CODES = 0x6041, (0x1001, 0x1003, 0x603F)


class Verdict(StrEnum):
    """What became of an answer."""

    EQUAL = "equal"
    TIME = "explained by time"
    PHYSICS = "explained by physics"
    DIFFERS = "differs"


@dataclass
class Difference:
    """An answer that differs again and again."""

    what: str  # register or object
    recorded: str
    model: str
    first: float  # s
    count: int = 1


@dataclass
class Score:
    """Answers of a recording."""

    counts: Counter[Verdict] = field(default_factory=Counter)
    differences: dict[tuple[str, str, str], Difference] = field(default_factory=dict)

    def add(self, verdict: Verdict) -> None:
        """One answer."""
        self.counts[verdict] += 1

    def differs(self, what: str, recorded: str, model: str, time: float) -> None:
        """One answer that nothing explains, at `time` (s)."""
        self.counts[Verdict.DIFFERS] += 1
        found = self.differences.get((what, recorded, model))
        if found:
            found.count += 1
        else:
            self.differences[what, recorded, model] = Difference(what, recorded, model, time)

    @property
    def total(self) -> int:
        """All answers."""
        return self.counts.total()


def live(row: Object) -> bool:
    """Whether an object shows what is measured, so that another axis gives another value.

    State and fault codes do not count: there a difference is one of behaviour.
    """
    if (row.index, row.subindex) == SERIAL:
        return True
    if row.index == STATUSWORD or row.index in ERROR_CODES:
        return False
    return row.access == "ro" and row.area != "constant"
