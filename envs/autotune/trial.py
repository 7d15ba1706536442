"""What gains are worth in motion: a step of the velocity, the user's move; and friction."""

import math
from dataclasses import dataclass

import numpy as np

from ...drive.kernel.words import Mode
from ...drive.master import Master, ServoError
from ..masters.port import MachinePort
from .stand import TORQUE, VELOCITY, Stand

STEP_TORQUE = 0.4  # of the rated torque, that a step of the velocity asks for at once, at most
STEP_TIME = 0.12  # s
SHARE_OF_ROOM = 0.4  # of the free way, for a move that is not given
LONGEST_TURN = 2 * math.pi  # rad, of an axis without ends
RIDE = 0.3  # s, at each speed
SPEEDS = (0.1, 0.2, 0.4)  # of 6081h, for friction


@dataclass(frozen=True)
class Trial:
    """A step and a move. Times in s, positions and velocities at the joint (m, m/s or rad)."""

    step_time: np.ndarray
    step_velocity: np.ndarray  # share of the step
    time: np.ndarray
    demand: np.ndarray
    error: np.ndarray  # demand minus position
    torque: np.ndarray  # Nm
    following_error: float  # greatest of the move; inf: it was not made
    settling: float  # s from the beginning of the move until it stays in the position window
    note: str = ""


@dataclass(frozen=True)
class Friction:
    """Least squares of the mean torque at the shaft over direction and speed."""

    coulomb: float  # Nm
    viscous: float  # Nm·s/rad
    load: float  # Nm, in one direction: gravity

    def __str__(self) -> str:
        return (
            f"Coulomb friction {self.coulomb:.3g} Nm, viscous {self.viscous:.3g} Nm·s/rad, "
            f"load {self.load:.3g} Nm"
        )


def friction(stand: Stand) -> Friction:
    """Ride to and fro at three speeds; the drive is enabled and calm."""
    count = math.ceil(RIDE / stand.period)
    mean = np.hanning(count + 2)[1:-1]
    mean /= mean.sum()
    rows, torques = [], []
    for share in SPEEDS:
        speed = stand.speed(2 * RIDE, share)
        direction = stand.direction(speed * RIDE)
        for sign in (direction, -direction):
            stand.travel(sign * speed)
            stand.settle(speed)
            samples = stand.run(np.zeros(count))
            velocity = float(mean @ samples[:, VELOCITY])
            rows.append([math.copysign(1.0, velocity), velocity, 1.0])
            torques.append(float(mean @ samples[:, TORQUE]))
    solution, *_ = np.linalg.lstsq(np.array(rows), np.array(torques), rcond=None)
    coulomb, viscous, load = solution.tolist()
    return Friction(max(coulomb, 0.0), max(viscous, 0.0), load)


def trial(stand: Stand, distance: float | None) -> Trial:
    """Make a step and a move with the gains in force; the machine is put back before each.

    Args:
        stand: of the drive.
        distance: of the move (m or rad); a share of the free way if not given.
    """
    step, note = _step(stand)
    stand.put_back()
    way = _distance(stand) if distance is None else distance
    rows: list[tuple[float, ...]] = []
    axis = stand.drive.axis

    def look() -> None:
        rows.append((
            stand.machine.time, float(axis.position_demand) / stand.gear,
            int(axis.od.following_error_actual_value) * float(axis.rad_per_position_unit)
            / stand.gear, float(axis.torque_command),
        ))

    others = Master(MachinePort(stand.machine), *stand.master.axes)
    try:
        others.reset_fault()
        others.set_mode(Mode.PROFILE_POSITION)
        others.enable()
        movers = Master(MachinePort(stand.machine, look), *stand.movers)
        movers.move_to(way, relative=True)
        moved = True
    except ServoError as error:
        note, moved = f"{error}", False
    time, demand, error_, torque = np.array(rows or [(0.0,) * 4]).T
    window = float(axis.position_window) / abs(stand.gear)
    away = np.flatnonzero(abs(demand - error_ - demand[-1]) > window)
    return Trial(
        *step, time=time - time[0], demand=demand - demand[0], error=error_, torque=torque,
        following_error=float(np.max(abs(error_))) if moved else math.inf,
        settling=float(time[away].max(initial=time[0]) - time[0]) if moved else math.inf, note=note,
    )


def _distance(stand: Stand) -> float:
    left, right = (min(x, LONGEST_TURN / SHARE_OF_ROOM) for x in stand.room)
    return SHARE_OF_ROOM * right if right >= left else -SHARE_OF_ROOM * left


def _step(stand: Stand) -> tuple[tuple[np.ndarray, np.ndarray], str]:
    """A step of the velocity demand in motion: mode pv with the steepest ramp there is."""
    drive, gear = stand.drive, stand.gear
    try:
        stand.start()
        base = stand.speed(0.6)
        direction = stand.direction(0.3 * base)
        stand.travel(direction * base)
        stand.settle(base)
    except (RuntimeError, ServoError) as error:
        return (np.zeros(1), np.zeros(1)), str(error)
    gain = max(float(drive.axis.velocity_gain), 1e-12)
    step = min(STEP_TORQUE * float(drive.axis.rated_torque) / gain / abs(gear), 0.2 * base)
    for name in ("profile_acceleration", "profile_deceleration", "max_acceleration"):
        row = drive.model.names.get(name)
        if row is not None and row.access == "rw":
            stand.commission({name: int(min(row.maximum, 2**31 - 1))})
    before = stand.run(np.zeros(max(round(0.02 / stand.period), 2)))
    stand.travel(direction * (base + step))
    try:
        after = stand.run(np.zeros(round(STEP_TIME / stand.period)))
    except RuntimeError as error:
        return (np.zeros(1), np.zeros(1)), str(error)
    velocity = np.concatenate([before, after])[:, VELOCITY] / gear
    time = (np.arange(len(velocity)) - len(before)) * stand.period
    return (time, (direction * velocity - base) / step), ""
