"""The machine behind a field bus: drives, and time that passes in whole cycles."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from .drive import Drive


class Machine(Protocol):
    """Drives by name on something that moves, such as `servogym.envs.Machine`."""

    @property
    def drives(self) -> Mapping[str, Drive]:
        """Drives by name, in the order of their axes."""

    @property
    def cycle_time(self) -> float:
        """Duration of one `step` (s)."""

    @property
    def time(self) -> float:
        """Time that has passed (s)."""

    def step(self, cycles: int = 1) -> object:
        """Let so many position cycles pass."""


@dataclass
class Standing:
    """Drives without a machine: their cycles run as with a locked motor shaft."""

    drives: Mapping[str, Drive]
    cycle_time: float  # (s)
    time: float = 0.0  # (s)

    def step(self, cycles: int = 1) -> None:
        """Let so many position cycles pass."""
        for drive in self.drives.values():
            for _ in range(cycles):
                drive.cycle(0.0)
        self.time += cycles * self.cycle_time

    def reset(self, positions: Mapping[str, float] | None = None) -> None:
        """Switch the drives off and on again; positions are ignored."""
        for drive in self.drives.values():
            drive.reset()
        self.time = 0.0
