"""The port through which a master commands the drives of a machine in this process."""

from collections.abc import Callable, Mapping

from ...drive.master.port import Units
from ...drive.model.model import DriveModel
from ..engine.machine import Machine
from ..engine.touch import hindrances


class MachinePort:
    """Port to all drives of a machine; an exchange runs its next position cycles.

    Positions are m or rad of the joint, counted from the reference of the drive.

    Args:
        machine: the machine, which is stepped while a master waits.
        on_step: called after every exchange, for traces and displays.
        cycles: position cycles per exchange.
    """

    latency = 0.0

    def __init__(
        self, machine: Machine, on_step: Callable[[], object] | None = None, cycles: int = 1
    ) -> None:
        if not isinstance(machine, Machine):
            raise ValueError(
                f"machine = {machine!r}: give a Machine, such as linear_axis(), or env.machine of "
                "an environment"
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
        """Read an object (drive units). Raises SdoAbort if refused."""
        return self._drives[axis].read(name)

    read = upload

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Set an object (drive units). Raises SdoAbort if refused."""
        self._drives[axis].write(name, value)

    def exchange(self) -> None:
        """Run the position cycles of an exchange."""
        self.machine.step(self.cycles)
        if self.on_step is not None:
            self.on_step()

    def obstacles(self, axis: str) -> list[str]:
        """Return what stops the joint of a drive: contacts, the strongest first, or forces."""
        machine = self.machine
        coupling = machine.coupling(axis)
        with machine.turn:
            return hindrances(
                machine.model, machine.data, int(machine.model.dof_jntid[coupling.dof])
            )

    def units(self, axis: str) -> Units:
        """Return the size of a drive unit at the joint, by the factors and the gear."""
        record, gear, name = self._drives[axis].axis, *self.machine.joint(axis)
        return Units(
            float(record.rad_per_position_unit) / gear,
            float(record.rad_s_per_velocity_unit) / gear, name,
        )
