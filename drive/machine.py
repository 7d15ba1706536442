"""What a field bus needs of a machine: drives, and time that passes in whole cycles."""

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
        """That has passed (s)."""

    def step(self, cycles: int = 1) -> object:
        """Let so many position cycles pass."""


@dataclass
class Standing:
    """Drives without a machine: their cycles pass, as with a motor that is held."""

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
        """Switch the drives off and on again; nothing has a position."""
        for drive in self.drives.values():
            drive.reset()
        self.time = 0.0
