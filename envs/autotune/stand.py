"""The test stand: one drive of a machine travels at a constant speed while it is excited.

The excitation is the torque offset 60B2h. For a model without this object it is the same field of
the record, as in the measuring function of a manufacturer's tool. It is added before the torque
limit, so it passes through the cascade and the limits of the drive. While the axis travels,
friction keeps its sign.
"""

import math

import numpy as np

from ...drive.drive import Drive
from ...drive.kernel.words import Limit, Mode, State
from ...drive.master import Master
from ...drive.model.names import hint
from ..engine.checks import in_range
from ..engine.machine import Machine
from ..engine.replay import Replay
from ..masters.port import MachinePort
from ..plants.gantry import PAIR
from ..plants.loops import Gains, gains_of, in_units

SAMPLED = ("torque_offset", "torque_command", "velocity", "position", "limits")
ROOM = 0.9  # share of the free travel that a run may use
CYCLES_OF_A_RAMP = 20  # shortest wait for a change of speed
BEHIND = 0.2  # largest deviation from the requested speed, as a share of it
PATIENCE, WAITING = 5.0, 0.3  # longest wait for it: s, and share of the free travel
# columns of the samples of a run
OFFSET, TORQUE, VELOCITY, POSITION, LIMITED, TURNED = range(6)


class Stand:
    """Runs of one drive of a machine; `put_back` restores the machine.

    Two drives that move one beam run together, or against each other.

    Args:
        machine: the machine; the drive may be enabled or not.
        name: name of the drive; by default the first one.

    Raises:
        ValueError: an unknown drive, or one without a position and velocity controller.
    """

    def __init__(self, machine: Machine, name: str | None = None):
        if not isinstance(machine, Machine):
            raise ValueError(
                f"machine = {machine!r}: give a Machine, such as linear_axis(), or env.machine of "
                "an environment"
            )
        name = next(iter(machine.drives)) if name is None else name
        if name not in machine.drives:
            remark = hint(str(name), machine.drives)
            raise ValueError(f"drive: there is no drive {name!r}: {remark}")
        self.machine, self.name = machine, name
        self.drive = machine.drives[name]
        model = self.drive.model
        if not model.positions or Mode.PROFILE_VELOCITY not in model.modes:
            raise ValueError(
                f"drive {name!r} ({model.name}) has no velocity and position controller to "
                "tune: choose a servo drive, see `servogym drives`"
            )
        self.gear, self.unit = machine.joint(name)
        together = PAIR if name in PAIR and all(x in machine.drives for x in PAIR) else (name,)
        self.movers = [x for x in together if machine.drives[x].model.positions]
        self._heading = 1.0
        self._replay = Replay(self.movers, ["torque_offset"], SAMPLED)
        self._kept = machine.snapshot()
        servos = [x for x, drive in machine.drives.items() if drive.model.positions]
        self.master = Master(MachinePort(machine), *servos)

    def put_back(self) -> None:
        """Restore the machine to its state when the stand was made, or at the last `keep`."""
        self.machine.restore(self._kept)

    def keep(self) -> None:
        """Make the present state of the machine the one that `put_back` restores."""
        self._kept = self.machine.snapshot()

    def start(self) -> None:
        """Enable all drives; those that do not travel hold their positions."""
        self.master.reset_fault()
        for name in self.master.axes:
            moves = name in self.movers
            self.master[name].set_mode(Mode.PROFILE_VELOCITY if moves else Mode.PROFILE_POSITION)
            if moves:
                self.master[name].write("target_velocity", 0)
        self.master.enable()
        self.machine.step()
        self.refuse_hot()

    def refuse_hot(self) -> None:
        """Raise RuntimeError if I²t limits a drive, since the limit would be measured."""
        for name in self.movers:
            axis = self.machine.drives[name].axis
            if int(axis.od.active_limits) & Limit.I2T:
                raise RuntimeError(
                    f"I²t limits the torque of drive {name!r}, {axis.od.i2t_level / 10:g} % of it "
                    "are used up: let the axis rest until it has recovered, then measure again"
                )

    def commission(self, objects: dict[str, int]) -> None:
        """Set objects of the drive, and of the other drive on the same beam."""
        for name in self.movers:
            self.machine.drives[name].commission(objects)

    @property
    def period(self) -> float:
        """Duration of a step of the machine (s)."""
        return self.machine.cycle_time

    @property
    def place(self) -> float:
        """Position of the joint (m or rad)."""
        return float(self.machine.data.qpos[self.machine.coupling(self.name).qpos])

    @property
    def room(self) -> tuple[float, float]:
        """Free travel to the left and to the right (m or rad), to the limits of drive and joint."""
        here, coupling = self.place, self.machine.coupling(self.name)
        low, high = self.machine.range(self.name)
        for first, last in zip(coupling.switch_from[:2], coupling.switch_to[:2], strict=True):
            if first <= last <= here:
                low = max(low, float(last))
            elif here <= first <= last:
                high = min(high, float(first))
        axis = self.drive.axis
        if axis.homed:
            ends = [
                here + (float(limit) - float(axis.position)) / self.gear
                for limit in (axis.position_limit_min, axis.position_limit_max)
            ]
            low, high = max(low, min(ends)), min(high, max(ends))
        return here - low, high - here

    def fastest(self, duration: float) -> float:
        """Return the highest speed of the joint for a duration (s), in m/s or rad/s."""
        motor = float(self.drive.axis.max_speed) / abs(self.gear)
        return min(motor, ROOM * max(self.room) / duration)

    def speed(self, duration: float, share: float = 0.1) -> float:
        """Return a share of 6081h as the speed of the joint, less without room (m/s or rad/s)."""
        wanted = share * float(self.drive.axis.profile_speed) / abs(self.gear)
        free = max(self.room)
        if free * ROOM < wanted * duration * 0.02:
            raise ValueError(
                f"drive {self.name!r} stands where only {free:.3g} {self.unit} are free: "
                "move the axis to the middle of its range first"
            )
        return min(wanted, ROOM * free / duration)

    def direction(self, way: float) -> float:
        """Return the direction, 1 or -1, with room for `way` (m or rad), the wider side first."""
        left, right = self.room
        return 1.0 if right >= max(left, way) or right >= way > left else -1.0

    def travel(self, speed: float) -> None:
        """Command a speed of the joint (m/s or rad/s)."""
        self._heading = math.copysign(1.0, speed * self.gear)
        for name in self.movers:
            axis = self.machine.drives[name].axis
            gear, _ = self.machine.joint(name)
            value = round(speed * gear / float(axis.rad_s_per_velocity_unit))
            self.master[name].write("target_velocity", value)

    def settle(self, speed: float) -> None:
        """Wait one and a half times the ramp to a speed, and longer for a soft loop."""
        axis, wanted = self.drive.axis, self._heading * abs(speed * self.gear)
        ramp = 2 * abs(wanted) / max(float(axis.acceleration), 1e-9)
        count = CYCLES_OF_A_RAMP + math.ceil(1.5 * ramp / self.period)
        patience = min(PATIENCE, WAITING * max(self.room) / max(abs(speed), 1e-9))
        for _ in range(math.ceil(patience / (count * self.period)) or 1):
            velocity = self.run(np.zeros(count))[-CYCLES_OF_A_RAMP:, VELOCITY]
            if abs(np.mean(velocity) - wanted) < BEHIND * abs(wanted):
                break

    def run(self, offsets: np.ndarray, against: bool = False) -> np.ndarray:
        """Excite with torque offsets (Nm), one per step; -> samples of shape ``(n, 6)``.

        The columns are torque offset (Nm), torque command (Nm), measured velocity (rad/s), position
        (rad), whether the torque was limited, and whether a drive reversed.

        For two drives that move one beam the columns are half the sum. With `against` the second
        drive gets the negative offsets, and the columns are half the difference.

        Raises:
            RuntimeError: a drive has left OPERATION_ENABLED; the message names its fault.
        """
        limited = int(Limit.TORQUE)
        per_mille = float(self.drive.axis.rated_torque) * 1e-3
        signs = np.array([1, -1 if against else 1][: len(self.movers)])
        commanded = np.rint(offsets / per_mille).astype(int)
        rows = self._replay.run([self.machine], commanded[:, None] * signs, delay=0)[0]
        samples = np.zeros((len(offsets), 6))
        for column, name in enumerate(SAMPLED[:LIMITED]):
            samples[:, column] = rows[name] @ signs / len(signs)
        samples[:, LIMITED] = np.sum(rows["limits"] & limited != 0, axis=1)
        samples[:, TURNED] = np.sum(rows["velocity"] * self._heading <= 0.0, axis=1)
        for name in self.movers:
            drive = self.machine.drives[name]
            if drive.state != State.OPERATION_ENABLED:
                why = drive.fault or drive.describe()
                raise RuntimeError(f"drive {name!r} has left the measuring run: {why}")
        return samples

    def rates(self) -> tuple[float, int]:
        """Return the velocity cycle (s), and the number of them in a position cycle."""
        return float(self.drive.axis.velocity_period), int(self.drive.axis.velocity_cycles)


def detune(drive: Drive, factor: float) -> None:
    """Multiply velocity and position gain. Raises ValueError for a factor out of 0.01..100."""
    in_range("factor", factor, 0.01, 100.0, "of the gains")
    gains = gains_of(drive)
    drive.commission(
        in_units(
            drive,
            Gains(gains.velocity_gain * factor, gains.integral_time, gains.position_gain * factor),
        )
    )
