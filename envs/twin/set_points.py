"""The set-points of a master, row by row: cyclic ones, and ones that are written on occasion.

A row is a position cycle of the drive. Before the log begins, the machine is enabled and brought to
the speed with which the log begins.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...drive.kernel.record import OD
from ...drive.kernel.words import Mode
from ...drive.wire.recording import Signal

OFFSETS = ("position_offset", "velocity_offset", "torque_offset")
# parameters of a move that a master may write in the log itself, between moves too
PROFILE = ("profile_velocity", "profile_acceleration", "profile_deceleration", "end_velocity")
SI = ("m", "rad", "m/s", "rad/s", "Nm")  # units of tables, not of drives
ENABLE = (0x0006, 0x0007, 0x000F)  # controlwords
NEW_SET_POINT = INTERPOLATE = 0x10  # in pp, in ip
MIDDLE = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0  # middle of five minus the cubic of the others
APART = 5e-3  # s between the controlwords that enable the drive


@dataclass(frozen=True)
class Events:
    """The writes of a master that are not cyclic, and the position cycles in which they arrive.

    The time stamps of a logger are accurate to a cycle or two. A frame that begins a motion may
    therefore be moved, with all writes up to the next such frame; see `moved`.
    """

    at: np.ndarray  # row of each, shape (k,)
    columns: Mapping[str, np.ndarray]  # what is written then, by variable, each of shape (k,)
    begins: np.ndarray  # whether a motion begins, shape (k,)

    def rows(self, count: int) -> dict[str, np.ndarray]:
        """Return the values by row. A process image arrives in each row, as some drives expect."""
        last = np.searchsorted(self.at, np.arange(count), "right") - 1
        return {name: values[last] for name, values in self.columns.items()}

    def moved(self, cycles: np.ndarray) -> "Events":
        """Return the events with each motion, and what follows it, some rows later."""
        motion = np.cumsum(self.begins)
        at = self.at + np.concatenate([[0], cycles])[motion]
        return replace(self, at=np.maximum.accumulate(at))


@dataclass(frozen=True)
class LostSetPoints:
    """Cyclic set-points that the logger missed, and the error of their interpolation.

    Each is interpolated by a cubic through its neighbours. The error of the cubic is estimated from
    the logged set-points, each of them left out in turn.
    """

    at: np.ndarray  # first row of each, shape (k,)
    per: int  # rows that it holds
    target: str  # variable
    error: float  # of the cubic, rms (drive units)

    def rows(self, rows: Mapping[str, np.ndarray], off: np.ndarray) -> dict[str, np.ndarray]:
        """Return the rows with an amount (drive units) added to each lost one, shape ``(k,)``."""
        column = rows[self.target].copy()
        for at, more in zip(self.at, off, strict=True):
            column[at : at + self.per] += more
        return {**rows, self.target: column}


def cyclic_rows(signals, raw, even, target, mode, clock, step, per, lead, count):
    """Return cyclic set-points by position cycle, the rows of process images, and the lost ones."""
    written = {
        "controlword": np.full(count, ENABLE[-1] | INTERPOLATE * (mode == 7)),
        "modes_of_operation": np.full(count, mode),
    }
    arrives = np.zeros(count, np.uint8)
    bus = np.arange(0, count - lead + per, per)
    have = np.round(even / (per * step)).astype(int)
    inside = (have >= -3) & (have * per < count - lead + 3 * per)
    number, at = np.unique(have[inside], return_index=True)
    values = raw.value[inside][at]
    cycles = np.arange(len(bus))
    every, missing, error = _between(number, values, cycles)
    every[cycles > number[-1]] = values[-1]
    every[cycles < number[0]] = values[0]
    column = np.repeat(every, per)[: count - lead]
    speed = (values[1] - values[0]) / ((number[1] - number[0]) * per * step)
    column = np.concatenate([_lead(every[0], speed, lead, per, step), column])
    arrives[::per] = 1
    written[target] = np.round(column).astype(int)
    _control(signals, written, arrives, clock, step, lead, count, per)
    for name in OFFSETS:
        if name in signals and np.any(signals[name].value):
            written[name] = _held_rows(signals[name], clock, step, lead, count)
    for n, word in enumerate(ENABLE):
        at = n * per * max(round(APART / (per * step)), 1)
        written["controlword"][at : at + max(per, 1) * max(round(APART / (per * step)), 1)] = word
        arrives[at] = 1
    written["controlword"][: arrives.nonzero()[0][1]] = ENABLE[0]
    return written, arrives, LostSetPoints(lead + missing * per, per, target, error)


def occasional(signals, target, mode, clock, step, lead, drive) -> Events:
    """Return the non-cyclic writes of a master, after those that enable the drive."""
    names = [name for name in (target, *PROFILE, *OFFSETS)
             if name in signals and signals[name].unit not in SI and name in (OD.names or ())]
    now = {"controlword": ENABLE[0], "modes_of_operation": int(mode)}
    now |= {name: 0 if name == target else int(getattr(drive.axis.od, name)) for name in names}
    heard = sorted(
        (float(at), n, name, round(float(value)))
        for n, name in enumerate([*names, "controlword"]) if name in signals
        for at, value in zip(clock(signals[name].time), signals[name].value, strict=True)
        if name != "controlword" or value.astype(int) & 0x0F == 0x0F
    )
    word, held, begins = ENABLE[-1], 0, [False] * len(ENABLE)
    for at, _, name, value in heard:
        if at > 0.0:
            break
        if name == "controlword":
            word, held = value & ~NEW_SET_POINT, value & NEW_SET_POINT
        else:
            now[name] = value
    apart = max(round(APART / step), 1)
    words = (*ENABLE[:-1], word)
    found = [(n * apart, now | {"controlword": each}) for n, each in enumerate(words)]
    for at, _, name, value in heard:
        if at <= 0.0:
            continue
        row = math.ceil(at / step - 1e-6) + lead
        before = found[-1][1]
        if name == "controlword":  # a bit that was set before the log is no edge in it
            held &= value
            value &= ~held
        if before[name] == value:
            continue
        edge = name == "controlword" and bool(value & ~before[name] & NEW_SET_POINT)
        starts = edge if mode == Mode.PROFILE_POSITION else name == target
        if row == found[-1][0]:
            found[-1][1][name] = value
            begins[-1] |= starts
        else:
            found.append((row, before | {name: value}))
            begins.append(starts)
    columns = {name: np.array([each[name] for _, each in found]) for name in now}
    return Events(np.array([row for row, _ in found]), columns, np.array(begins))


def filled(signal: Signal, even: np.ndarray, cycle: float, hold: bool) -> Signal:
    """Rebuild an undersampled cyclic set-point: steps, or a curve through the samples."""
    at = np.arange(even[0], even[-1] + 0.5 * cycle, cycle)
    if hold:
        last = np.clip(np.searchsorted(even, at + 1e-9, "right") - 1, 0, None)
        return Signal(at, signal.value[last], signal.unit)
    return Signal(at, _curve(even, signal.value, at), signal.unit)


def _curve(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate by cubics whose slopes do not overshoot (Fritsch, Carlson 1980)."""
    if len(x) < 4:
        return np.interp(at, x, y)
    from ..autotune.needs import scipy

    return scipy("interpolate").PchipInterpolator(x, y, extrapolate=True)(np.clip(at, x[0], x[-1]))


def _between(
    number: np.ndarray, values: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Interpolate the missing cyclic set-points by a cubic through four others.

    Returns:
        The set-points, the numbers of the missing ones, and the rms error of the cubic.
    """
    every = np.interp(at, number, values)
    missing = np.setdiff1d(at[(at > number[0]) & (at < number[-1])], number)
    for k in missing:
        right = int(np.searchsorted(number, k))
        four = slice(max(right - 2, 0), right + 2)
        x, y = number[four].astype(float), values[four]
        if len(x) == 4 and x[-1] - x[0] <= 8:
            every[k] = np.polynomial.polynomial.polyval(
                0.0, np.linalg.solve(np.vander(x - k, 4, increasing=True), y)
            )
    if len(values) < len(MIDDLE):
        return every, missing, 0.0
    five = np.lib.stride_tricks.sliding_window_view(values, len(MIDDLE))
    known = (np.ptp(five, axis=1) > 0) & (number[4:] - number[:-4] == 4)
    off = five[known] @ MIDDLE
    return every, missing, float(np.sqrt(np.mean(off**2))) if len(off) else 0.0


def _lead(first: float, speed: float, lead: int, per: int, step: float) -> np.ndarray:
    """Return set-points before the log: at rest, or up to the speed with which it begins."""
    time = np.repeat(np.arange(-(lead // per), 0) * per * step, per)
    if abs(speed) * per * step < 1e-9:
        return np.full(lead, first)
    ramp, even = 0.06, 0.06  # s, of rising speed and of constant one
    moved = np.where(time > -even, speed * time, 0.0)
    rising = (time <= -even) & (time > -even - ramp)
    moved = np.where(
        rising, -speed * even + speed * (time + even) + speed * (time + even) ** 2 / (2 * ramp),
        moved,
    )
    moved = np.where(time <= -even - ramp, -speed * even - 0.5 * speed * ramp, moved)
    return first + moved


def _held_rows(signal: Signal, clock, step: float, lead: int, count: int) -> np.ndarray:
    column = np.zeros(count, int)
    at = np.maximum(np.ceil(clock(signal.time) / step - 1e-6).astype(int), 0) + lead
    for row, value in zip(at, signal.value, strict=True):
        column[row:] = round(float(value))
    return column


def _control(signals, written, arrives, clock, step, lead, count, per) -> None:
    """Add the controlwords of the log that keep the drive enabled."""
    if "controlword" not in signals:
        return
    word = signals["controlword"]
    at = np.maximum(np.ceil(clock(word.time) / step - 1e-6).astype(int), 0) + lead
    changed = np.concatenate([[True], np.diff(word.value) != 0])
    for row, value in zip(at[changed], word.value[changed].astype(int), strict=True):
        if row >= count or value & 0x0F != 0x0F:
            continue
        row += -row % per
        if row < count:
            written["controlword"][row:] = value
            arrives[row] = 1
