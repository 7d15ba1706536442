"""How a master reaches drives: objects by name, and time that passes."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from ..model.model import DriveModel


class Units(NamedTuple):
    """What one drive unit is at the load; without known factors, itself."""

    position: float = 1.0  # of a position unit
    velocity: float = 1.0  # of a velocity unit, per s
    name: str = "position units"  # else "m" or "rad"


class Port(Protocol):
    """One or more drives that hear what is sent at the same time."""

    @property
    def models(self) -> Mapping[str, DriveModel]:
        """The drives by name, each with its model."""

    @property
    def latency(self) -> float:
        """After so long (s) a drive has acted on a command and what is read shows it."""

    def now(self) -> float:
        """Time (s) from any beginning."""

    def read(self, axis: str, name: str) -> int | float:
        """An object (drive units): what the last process data told, else the drive itself."""

    def upload(self, axis: str, name: str) -> int | float:
        """An object (drive units), asked of the drive itself.

        Raises SdoAbort where the drive refuses, ValueError for a name that its model does not have.
        """

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Set an object (drive units); process data go out with the next exchange.

        Raises SdoAbort where the drive refuses, ValueError or TypeError for what is no such value.
        """

    def exchange(self) -> object:
        """Send and take process data once; some time passes."""

    def units(self, axis: str) -> Units:
        """Of a drive."""
