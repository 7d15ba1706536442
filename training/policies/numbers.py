"""Tuned numbers by policy and task, in one file, with the effort of the tuning.

A tunable policy is a class with `RANGES`: the lowest, highest and untuned value of each number. It
reads its numbers with `numbers`. `servogym tune-policy` writes the file.
"""

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

FILE = Path(__file__).parents[2] / "assets" / "policies" / "tuned.json"


class Range(NamedTuple):
    """The range of a tunable number."""

    low: float
    high: float
    untuned: float


class Tunable:
    """A policy with tunable numbers."""

    NAME: ClassVar[str]  # of the policy
    RANGES: ClassVar[Mapping[str, Range]]
    GIVEN: ClassVar[Mapping[str, float] | None] = None  # the numbers that a tuner tries

    def numbers(self, task: str) -> dict[str, float]:
        """Return the numbers for a task (by id): those being tried, else the tuned or untuned."""
        own = {name: one.untuned for name, one in self.RANGES.items()}
        found = tuned().get(self.NAME, {}).get(task.rpartition("/")[2], {})
        return own | dict(found.get("numbers", {}) if self.GIVEN is None else self.GIVEN)

    @classmethod
    def fitted(cls) -> bytes:
        """Return the numbers of all tasks from the file, as the hash of an entry covers them."""
        found = {task: one["numbers"] for task, one in tuned().get(cls.NAME, {}).items()}
        return json.dumps(found, sort_keys=True).encode()


@lru_cache(maxsize=1)
def tuned() -> dict[str, Any]:
    """Return the tuned numbers that are shipped."""
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
