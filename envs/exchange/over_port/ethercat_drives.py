"""Drives of an environment as slaves of an EtherCAT segment."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ....drive.ethercat.al import AlState
from ....drive.ethercat.port import EtherCatPort, SegmentMaster
from ....drive.model.model import DriveModel, load
from .pace import Pace
from .side import WAITING_STEP, Limits, check_names

READ_ATTEMPTS = 300  # until a slave counts as silent; with SOEM each takes more than 2 ms
HELD_UP = (
    "no frame came within the time of its watchdog (0420h), because this computer or the drive's "
    "was held up; begin anew, with less beside it"
)


class EtherCatDrives:
    """Slaves of a segment, brought to OPERATIONAL.

    Args:
        master: in memory, or `servogym.drive.wire.soem.SoemMaster`.
        axes: names of the drives in the task's machine, in the order of the slaves; slaves behind
            them get no power.
        model: model of the drives.
        envelopes: guard limits by drive, all or some by name; the drive supplies the others.
        pace: the clock; real time if not given.
    """

    def __init__(
        self,
        master: SegmentMaster,
        axes: Sequence[str],
        model: str | Path | DriveModel = "generic",
        *,
        envelopes: Limits | None = None,
        pace: Pace | None = None,
    ):
        self.envelopes, self.pace = dict(envelopes or {}), pace or Pace()
        self._master, self._axes, self._model = master, [*axes], load(model, "ethercat")
        self.port: Any = None

    def connect(
        self, axes: Sequence[str], rpdos: Sequence[Sequence[str]], tpdos: Sequence[Sequence[str]]
    ) -> None:
        """See `DriveSide`. Raises as `EtherCatPort`."""
        check_names(axes, self._axes)
        slaves = self._master.slaves or self._master.scan()
        others = [f"slave {n}" for n in range(len(self._axes), len(slaves))]
        models = dict.fromkeys([*self._axes, *others], self._model)
        outputs, inputs = ([name for pdo in pdos for name in pdo] for pdos in (rpdos, tpdos))
        self.port = EtherCatPort(
            self._master, models, outputs=outputs, inputs=inputs,
            now=self.pace.now if self.pace.real else lambda: WAITING_STEP * self.port.exchanges,
        )
        self.port.cyclic = self.pace.real

    def trouble(self) -> str:
        """Name the slaves that have left OPERATIONAL, in which they take no process data."""
        fallen = [
            f"{axis} is in {slave.state.name}"
            for axis, slave in zip(self._axes, self._master.slaves, strict=False)
            if slave.state != AlState.OPERATIONAL
        ]
        return f"; {', '.join(fallen)}: {HELD_UP}" if fallen else ""

    def awake(self) -> None:
        """Return slaves to OPERATIONAL whose watchdog expired while no frame was exchanged."""
        self._master.recover()

    def arm(self, on: bool) -> list[str]:
        """Do nothing: the watchdog of the sync managers is always active."""
        return []

    def send(self) -> None:
        """See `DriveSide`."""
        self.port.send()

    def sample(self, patience: float) -> bool:
        """See `DriveSide`; reads the inputs alone, and again where a frame is lost."""
        pace, attempts = self.pace, 1
        end = pace.now() + patience
        while not self._master.look():
            if attempts >= READ_ATTEMPTS or (pace.real and pace.now() >= end):
                return False
            attempts += 1
        return True
