"""The test stand: one drive of a machine that travels at a constant speed while it is excited.

The excitation is the torque offset (60B2h; of a model without the object, the same field of its
record, as the measuring function of a maker's own tool has it). It is added before the torque
limit, so everything it does goes through the drive's own cascade and limits. While the axis
travels, friction keeps its sign.
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
ROOM = 0.9  # share of the free way that a run may use
CYCLES_OF_A_RAMP = 20  # at least, so that a change of speed has ended
BEHIND = 0.2  # of the speed asked for, at most, when it has come
PATIENCE, WAITING = 5.0, 0.3  # s, and share of the free way, until it is given up
# what is sampled after each position cycle
OFFSET, TORQUE, VELOCITY, POSITION, LIMITED, TURNED = range(6)


class Stand:
    """Runs of one drive of a machine. The machine is as it was after `put_back`.

    Two drives that move one beam run together: alike, or one against the other.

    Args:
        machine: powered on; the drive may be enabled or not.
        name: of the drive; the first of the machine if not given.

    Raises:
        ValueError: no such drive, or one without a position and velocity controller.
    """

    def __init__(self, machine: Machine, name: str | None = None):
        if not isinstance(machine, Machine):
            raise ValueError(
                f"machine = {machine!r}: give a Machine, as linear_axis() makes one; of an "
                "environment it is env.machine"
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
        """Let the machine be what it was when the stand was made."""
        self.machine.restore(self._kept)

    def keep(self) -> None:
        """Put back to what the machine is now, from now on."""
        self._kept = self.machine.snapshot()

    def start(self) -> None:
        """Enable all drives; those that do not travel hold their position."""
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
        """Raise RuntimeError where I²t holds a drive back: what then is measured is the limit."""
        for name in self.movers:
            axis = self.machine.drives[name].axis
            if int(axis.od.active_limits) & Limit.I2T:
                raise RuntimeError(
                    f"I²t limits the torque of drive {name!r}, {axis.od.i2t_level / 10:g} % of it "
                    "are used up: let the axis rest until it has recovered, then measure again"
                )

    def commission(self, objects: dict[str, int]) -> None:
        """Set objects of the drive, and of one that moves the same beam."""
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
        """Free way to the left and to the right (m or rad), to the limits of drive and joint."""
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
        """Highest travel speed for that long (s) at the joint, by motor and room (m/s or rad/s)."""
        motor = float(self.drive.axis.max_speed) / abs(self.gear)
        return min(motor, ROOM * max(self.room) / duration)

    def speed(self, duration: float, share: float = 0.1) -> float:
        """Travel speed at the joint: a share of 6081h, less if there is no room (m/s or rad/s)."""
        wanted = share * float(self.drive.axis.profile_speed) / abs(self.gear)
        free = max(self.room)
        if free * ROOM < wanted * duration * 0.02:
            raise ValueError(
                f"drive {self.name!r} stands where only {free:.3g} {self.unit} are free: "
                "move the axis to the middle of its range first"
            )
        return min(wanted, ROOM * free / duration)

    def direction(self, way: float) -> float:
        """Where there is room for `way` (m or rad), the wider side first; 1 or -1."""
        left, right = self.room
        return 1.0 if right >= max(left, way) or right >= way > left else -1.0

    def travel(self, speed: float) -> None:
        """Ask for a speed of the joint (m/s or rad/s)."""
        self._heading = math.copysign(1.0, speed * self.gear)
        for name in self.movers:
            axis = self.machine.drives[name].axis
            gear, _ = self.machine.joint(name)
            value = round(speed * gear / float(axis.rad_s_per_velocity_unit))
            self.master[name].write("target_velocity", value)

    def settle(self, speed: float) -> None:
        """Wait until the ramp to a speed has ended, half as long again, and for a soft loop."""
        axis, wanted = self.drive.axis, self._heading * abs(speed * self.gear)
        ramp = 2 * abs(wanted) / max(float(axis.acceleration), 1e-9)
        count = CYCLES_OF_A_RAMP + math.ceil(1.5 * ramp / self.period)
        patience = min(PATIENCE, WAITING * max(self.room) / max(abs(speed), 1e-9))
        for _ in range(math.ceil(patience / (count * self.period)) or 1):
            velocity = self.run(np.zeros(count))[-CYCLES_OF_A_RAMP:, VELOCITY]
            if abs(np.mean(velocity) - wanted) < BEHIND * abs(wanted):
                break

    def run(self, offsets: np.ndarray, against: bool = False) -> np.ndarray:
        """Excite with torque offsets (Nm), one a step; -> samples of shape ``(n, 6)``.

        Columns: torque offset (Nm), torque command (Nm), measured velocity (rad/s), position
        (rad), whether the torque was limited, whether a drive turned round.

        Of two drives that move one beam the columns are half the sum. Are they excited `against`
        one another, the second with the offsets turned, they are half the difference.

        Raises:
            RuntimeError: a drive has left OPERATION_ENABLED, with its fault.
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
        """Velocity cycle (s), and how many make a position cycle."""
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
