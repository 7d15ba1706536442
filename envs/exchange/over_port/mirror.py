"""What a task reads of its machine, kept up to date from the answers of drives on a bus."""

from collections.abc import Mapping, Sequence

from ....drive.kernel.words import Mode
from ....drive.kernel.words import Statusword as S
from ...engine.machine import Machine

REFERENCED = S.MODE_12  # in homing mode: homing attained (CiA 402-2)


class Mirror:
    """Writes the positions that drives report into the machine of an environment.

    Args:
        machine: of the environment.
        axes: names of the drives.
        units: position units per m or rad.
        period: of the agent's steps (s).
    """

    def __init__(self, machine: Machine, axes: Sequence[str], units: float, period: float):
        self._machine, self._axes = machine, [*axes]
        self._units, self._period = units, period
        couplings = dict(zip(machine.drives, machine.couplings, strict=True))
        self._qpos = {axis: int(couplings[axis].qpos) for axis in self._axes}
        self._home: float | None = None  # where homing drives find it (m or rad)
        self._shift = dict.fromkeys(self._axes, 0.0)  # of positions, by a reference taken since
        self._last = dict.fromkeys(self._axes, (0.0, 0.0))  # position and velocity, a step ago

    def begin(self, positions: Mapping[str, float], home: float | None) -> None:
        """Begin an episode.

        Args:
            positions: of the drives at rest (m or rad).
            home: where the drives, which have no reference, find their home (m or rad).
        """
        self._home = home
        for axis in self._axes:
            self._shift[axis], self._last[axis] = 0.0, (positions[axis], 0.0)

    def show(self, answers: Sequence[Mapping[str, float]]) -> None:
        """Take the answers of a step (drive units by object), in the order of the drives."""
        machine, limited = self._machine, 0
        for axis, values in zip(self._axes, answers, strict=True):
            if self._home is not None:
                self._take_reference(axis, values, self._home)
            position = values["position_actual_value"] / self._units + self._shift[axis]
            machine._coordinates[0][self._qpos[axis]] = position
            limited |= int(values["statusword"]) & S.INTERNAL_LIMIT_ACTIVE
        machine.data.qpos[:] = machine._coordinates[0]
        machine.world["step_ticks"], machine.world["limited_ticks"] = 1, bool(limited)

    def _take_reference(self, axis: str, values: Mapping[str, float], home: float) -> None:
        """Record the torque of a homing drive, and where it has found its home."""
        n = [*self._machine.drives].index(axis)
        record, coupling = self._machine.axes[n], self._machine.couplings[n]
        record.torque = 1e-3 * values["torque_actual_value"] * record.rated_torque
        position, velocity = (
            values[f"{name}_actual_value"] / self._units for name in ("position", "velocity")
        )
        homing = values["modes_of_operation_display"] == Mode.HOMING
        if homing and int(values["statusword"]) & REFERENCED and not record.homed:
            before, speed = self._last[axis]
            moved = before + 0.5 * (speed + velocity) * self._period
            self._shift[axis] = moved - position
            place = (home + self._shift[axis]) * coupling.gear
            record.zero_counts = round((place + record.home_offset) / record.rad_per_increment)
            record.homed = 1
        self._last[axis] = position + self._shift[axis], velocity
