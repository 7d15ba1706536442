"""The drives of a machine in this process, as a master reaches them."""

from collections.abc import Callable, Mapping

from ...drive.master.port import Units
from ...drive.model.model import DriveModel
from ..engine.machine import Machine
from ..engine.touch import hindrances


class MachinePort:
    """All drives of a machine; an exchange is its next position cycles.

    Positions are m or rad of the joint, counted from the drive's reference.

    Args:
        machine: is stepped while a master waits.
        on_step: called after every exchange, for traces and displays.
        cycles: position cycles an exchange.
    """

    latency = 0.0

    def __init__(
        self, machine: Machine, on_step: Callable[[], object] | None = None, cycles: int = 1
    ) -> None:
        if not isinstance(machine, Machine):
            raise ValueError(
                f"machine = {machine!r}: give a Machine, as linear_axis() makes one; of an "
                "environment it is env.machine"
            )
        self.machine = machine
        self.on_step = on_step
        self.cycles = cycles
        self._drives = machine.drives

    @property
    def models(self) -> Mapping[str, DriveModel]:
        """Models of the drives by name."""
        return {name: drive.model for name, drive in self._drives.items()}

    def now(self) -> float:
        """Time of the machine (s)."""
        return self.machine.time

    def upload(self, axis: str, name: str) -> int | float:
        """An object (drive units). Raises SdoAbort if refused."""
        return self._drives[axis].read(name)

    read = upload

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Set an object (drive units). Raises SdoAbort if refused."""
        self._drives[axis].write(name, value)

    def exchange(self) -> None:
        """Let the position cycles pass."""
        self.machine.step(self.cycles)
        if self.on_step is not None:
            self.on_step()

    def obstacles(self, axis: str) -> list[str]:
        """What stops a drive's joint: contacts, the strongest first, or forces."""
        machine = self.machine
        coupling = machine.coupling(axis)
        with machine.turn:
            return hindrances(
                machine.model, machine.data, int(machine.model.dof_jntid[coupling.dof])
            )

    def units(self, axis: str) -> Units:
        """What the factors and the mechanics make of a drive unit."""
        record, gear, name = self._drives[axis].axis, *self.machine.joint(axis)
        return Units(
            float(record.rad_per_position_unit) / gear,
            float(record.rad_s_per_velocity_unit) / gear, name,
        )
