"""What an environment needs of drives on a bus, whichever bus it is."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from ....drive.master.port import Port
from ..envelope import Envelope
from .pace import Pace

WAITING_STEP = 5e-3  # s of machine time per SYNC or process-data frame, in lock-step

Limits = Mapping[str, Envelope | Mapping[str, float]]


class DriveSide(Protocol):
    """Drives on a bus with the process images of a task: `CanDrives`, `EtherCatDrives`."""

    pace: Pace

    @property
    def port(self) -> Port:
        """The port on which a master reaches the drives."""

    @property
    def envelopes(self) -> Limits:
        """Guard limits by drive: all of a drive, or some by name. The drive supplies the others."""

    def awake(self) -> None:
        """Make sure that process data are exchanged. Called before each episode."""

    def trouble(self) -> str:
        """Describe why drives do not respond, as far as the bus shows it; empty if it does not."""

    def connect(
        self, axes: Sequence[str], rpdos: Sequence[Sequence[str]], tpdos: Sequence[Sequence[str]]
    ) -> None:
        """Map the objects of each PDO in every drive and start the exchange of process data."""

    def arm(self, on: bool) -> list[str]:
        """Switch the watchdog by which a drive stops itself when it loses this master.

        Returns: names of the drives that have no such watchdog.
        """

    def send(self) -> None:
        """Send the set-points that were written to the port."""

    def sample(self, patience: float) -> bool:
        """Request the answers; -> whether all of them arrived within `patience` (s)."""


def check_names(wanted: Sequence[str], given: Iterable[str]) -> None:
    """Raise ValueError unless a port has the drives of the task, in the task's order."""
    if [*wanted] != [*given]:
        raise ValueError(
            f"port: the task commands the drives {', '.join(wanted)}, the port has "
            f"{', '.join(given)}: give them these names, in this order"
        )
