"""Trials of gains in motion: a step of the velocity and a move; and the friction."""

import math
from dataclasses import dataclass

import numpy as np

from ...drive.kernel.words import Mode
from ...drive.master import Master, ServoError
from ..masters.port import MachinePort
from .stand import TORQUE, VELOCITY, Stand

STEP_TORQUE = 0.4  # share of the rated torque that a step of the velocity may need
STEP_TIME = 0.12  # s
SHARE_OF_ROOM = 0.4  # share of the free travel, the default distance of a move
LONGEST_TURN = 2 * math.pi  # rad, for an axis without ends
RIDE = 0.3  # s of travel at each speed
SPEEDS = (0.1, 0.2, 0.4)  # shares of 6081h at which friction is measured


@dataclass(frozen=True)
class Trial:
    """Results of a step and a move; positions and velocities are those of the joint."""

    step_time: np.ndarray  # s
    step_velocity: np.ndarray  # share of the step
    time: np.ndarray  # s
    demand: np.ndarray  # m or rad
    error: np.ndarray  # demand minus position (m or rad)
    torque: np.ndarray  # Nm
    following_error: float  # largest of the move (m or rad); inf: it was not made
    settling: float  # s, from the start of the move until the position stays in its window
    note: str = ""


@dataclass(frozen=True)
class Friction:
    """Friction at the shaft, a least-squares fit of mean torques over direction and speed."""

    coulomb: float  # Nm
    viscous: float  # Nm·s/rad
    load: float  # Nm, in one direction, such as gravity

    def __str__(self) -> str:
        return (
            f"Coulomb friction {self.coulomb:.3g} Nm, viscous {self.viscous:.3g} Nm·s/rad, "
            f"load {self.load:.3g} Nm"
        )


def friction(stand: Stand) -> Friction:
    """Measure friction by travel back and forth at three speeds; the drive is enabled."""
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
    """Make a step and a move with the present gains; the machine is restored before each.

    Args:
        stand: the stand of the drive.
        distance: distance of the move (m or rad); by default a share of the free travel.
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
    """Make a step of the velocity demand in motion, in mode pv with the steepest ramp."""
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
