"""The interface between a master and its drives: objects by name, and the passing of time."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from ..model.model import DriveModel


class Units(NamedTuple):
    """The size of the drive units in SI units at the load; 1 where the factors are unknown."""

    position: float = 1.0  # of a position unit
    velocity: float = 1.0  # of a velocity unit, per s
    name: str = "position units"  # else "m" or "rad"


class Port(Protocol):
    """A connection to one or more drives that receive process data at the same time.

    One that can lose frames may also have `silence`, the time (s) spent on lost requests, which no
    time limit counts, and `arrived(axis)`: whether a drive has what was sent to it.
    """

    @property
    def models(self) -> Mapping[str, DriveModel]:
        """Models of the drives by name."""

    @property
    def latency(self) -> float:
        """Time (s) after which the effect of a command is visible in what is read."""

    def now(self) -> float:
        """Present time (s), counted from an arbitrary origin."""

    def read(self, axis: str, name: str) -> int | float:
        """Read an object (drive units), from the last process data if it is mapped."""

    def upload(self, axis: str, name: str) -> int | float:
        """Read an object (drive units) from the drive itself.

        Raises SdoAbort if the drive refuses, ValueError for a name that its model does not have.
        """

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Write an object (drive units); mapped objects are sent with the next exchange.

        Raises SdoAbort if the drive refuses, ValueError or TypeError for an unsuitable value.
        """

    def exchange(self) -> object:
        """Exchange process data once; some time passes."""

    def units(self, axis: str) -> Units:
        """Return the units of a drive."""
