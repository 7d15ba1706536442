"""A log of one drive as an experiment that can be repeated on a machine.

The time stamps of a bus log jitter, are incomplete and follow another clock. Cyclic frames are
moved back to their period: a frame belongs to the nearest cycle, a clock that is fast or slow is
scaled to that of the drive, and a missing cyclic set-point is interpolated from its neighbours. A
frame sent on occasion, such as a set-point of profile position, keeps its time, rounded up to the
next position cycle.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...drive.drive import Drive
from ...drive.kernel.words import Mode
from ...drive.wire.recording import Signal
from ..engine.machine import Machine
from .set_points import PROFILE, SI, Events, LostSetPoints, cyclic_rows, filled, occasional

CYCLIC = {  # mode -> the set-point that comes once a bus cycle
    Mode.CYCLIC_SYNC_POSITION: "target_position", Mode.CYCLIC_SYNC_VELOCITY: "target_velocity",
    Mode.CYCLIC_SYNC_TORQUE: "target_torque",
    Mode.INTERPOLATED_POSITION: "interpolation_data_record",
}
OCCASIONAL = {
    Mode.PROFILE_POSITION: "target_position", Mode.PROFILE_VELOCITY: "target_velocity",
    Mode.PROFILE_TORQUE: "target_torque",
}
STATE, ENABLED = 0x6F, 0x27  # of the statusword: operation enabled
MODES = ("modes_of_operation_display", "modes_of_operation")  # the first one in a log counts
OFF = -1000  # no mode of any drive
LONGEST_GAP = 0.25  # s without a frame, above which a log is refused
SETTLING = 0.25  # s that a machine is enabled before the log begins
SHORTEST = 0.3  # s, minimum duration of a log
REST = 0.02  # s without motion, after which an experiment in profile position may begin
MOTION = 1e-3  # m/s or rad/s, above which an axis moves
ALIKE = 1.6  # largest ratio of the travel of set-points and axis, either way
UNSETTLED = 0.15  # s at the beginning of a log that depend on the previous integrator state
SLIDES = 0.05  # s of motion, after which the integrator no longer holds what friction left in it
SATURATED = 0.25  # share of the motion at the torque limit, above which a log is refused
BEYOND = 1.2  # torque over the limit of the drive, above which its unit must be another
IRREGULAR = 0.15  # jitter over the period, above which a set-point may be in another cycle
DRIFT = 5e-4  # largest relative error of a logger's clock, if nothing is sent cyclically


class Unusable(ValueError):
    """A log is unsuitable for a twin; the message says what is missing and how to record it."""


@dataclass(frozen=True)
class Replicas:
    """Runs of one machine with encoder noise, each minus the run without noise.

    Their mean is not zero. Noise shakes an axis free that dry friction holds, and passes the
    rounding of a drive, so the expected path differs from the path without noise.
    """

    deviation: float  # of the encoder noise (m or rad)
    added: np.ndarray  # to position (m or rad) and torque (Nm), shape (k, m, 2)

    @cached_property
    def mean(self) -> np.ndarray:
        """The expected deviation from the run without noise, shape ``(m, 2)``."""
        mean: np.ndarray = self.added.mean(axis=0)
        return mean

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation of a new run about the mean, shape ``(m, 2)``."""
        count = len(self.added)
        spread: np.ndarray = self.added.std(axis=0, ddof=1)
        spread *= math.sqrt(1 + 1 / count)
        return spread

    def part(self, keep: np.ndarray) -> "Replicas":
        """Return the replicas at some of the samples, given by a mask of shape ``(m,)``."""
        return Replicas(self.deviation, self.added[:, keep])


@dataclass(frozen=True)
class Experiment:
    """The set-points of each position cycle, and the measured values."""

    name: str  # of the log
    mode: int
    cycle: float  # position cycle (s)
    period: float  # of the bus (s)
    rows: Mapping[str, np.ndarray]  # what is written, by variable (drive units), shape (n,)
    arrives: np.ndarray  # a process image comes with the row, shape (n,)
    begins: int  # row of the log's beginning; before it the machine is enabled and settles
    start: float  # position there (m or rad, as the drive counts)
    time: np.ndarray  # of the samples from the beginning (s), shape (m,)
    position: np.ndarray  # as the drive counts (m or rad), shape (m,)
    torque: np.ndarray  # at the shaft (Nm), shape (m,)
    quanta: tuple[float, float]  # of position (m or rad) and torque (Nm)
    objects: Mapping[str, float] = field(default_factory=dict)  # written in the log
    notes: tuple[str, ...] = ()
    lost: float = 0.0  # share of the frames
    events: Events | None = None  # that the rows come from, where set-points are not cyclic
    missed: LostSetPoints | None = None  # cyclic set-points that are not in the log
    replicas: Replicas | None = None  # what encoder noise adds to a run of the machine

    def moved(self, cycles: np.ndarray) -> "Experiment":
        """Return the experiment with each motion of its `events` begun some rows later."""
        if self.events is None:
            return self
        events = self.events.moved(cycles)
        return replace(self, rows=events.rows(len(self.arrives)), events=events)

    def residuals(self, position: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Measured minus expected position and torque, shape ``(..., m, 2)``.

        Args:
            position: of a run without noise (m or rad), shape ``(..., m)``.
            torque: the same (Nm).
        """
        left = np.stack([self.position - position, self.torque - torque], axis=-1)
        return left if self.replicas is None else left - self.replicas.mean

    def even(self, *columns: np.ndarray) -> tuple[float, list[np.ndarray]]:
        """Interpolate the samples that are missing from columns of shape ``(m,)``.

        Returns:
            The sampling period (s), and each column evenly spaced in time.
        """
        period = float(np.median(np.diff(self.time)))
        at = np.arange(self.time[0], self.time[-1], period)
        return period, [np.interp(at, self.time, column) for column in columns]

    @property
    def moving(self) -> np.ndarray:
        """Mask of the samples in motion, shape ``(m,)``.

        At rest, dry friction holds the axis and the integrator where encoder noise has left them.
        Such samples say nothing about the machine and differ from run to run.
        """
        return self._moves & (self.time >= self.known)

    @cached_property
    def _moves(self) -> np.ndarray:
        speed = np.abs(np.gradient(_smooth(self.position, self.time), self.time))
        return speed > max(MOTION, 0.02 * float(np.percentile(speed, 98)))

    @property
    def known(self) -> float:
        """Time from which the state of the drive is known (s).

        A log that begins between two moves shows a torque at rest. Dry friction keeps the
        integrator as the last move has left it, until the axis slides again. At most half the log
        is left out for this reason.

        A profile starts from the position demand. Before the first motion of a log that demand is
        unknown, so the comparison begins with the second motion.
        """
        first = min(UNSETTLED, 0.2 * self.duration)
        at_rest = self.torque[: max(int(np.argmax(self._moves)), 1)]
        if abs(at_rest.mean()) > max(self.quanta[1], 3 * at_rest.std()):
            slid = float(self.time[len(at_rest) - 1]) + SLIDES
            first = max(first, min(slid, 0.5 * self.duration))
        if self.events is None:
            return first
        begins = (self.events.at[self.events.begins] - self.begins) * self.cycle
        return float(begins[1]) if len(begins) > 2 else first

    @property
    def duration(self) -> float:
        """Time from the first sample to the last (s)."""
        return float(self.time[-1] - self.time[0])

    @property
    def sampling(self) -> float:
        """The sampling period (s)."""
        return self.duration / max(len(self.time) - 1, 1)

    def until(self, end: float) -> "Experiment":
        """Return the first part of the experiment, up to a time (s)."""
        keep = self.time <= end
        n = min(len(self.arrives), self.begins + math.ceil(end / self.cycle) + 40)
        return replace(
            self, rows={name: values[:n] for name, values in self.rows.items()},
            arrives=self.arrives[:n], time=self.time[keep], position=self.position[keep],
            torque=self.torque[keep],
            replicas=None if self.replicas is None else self.replicas.part(keep),
        )


@dataclass(frozen=True)
class Scale:
    """Factors that convert the values of a log to SI units."""

    position: float  # m or rad a unit
    velocity: float
    torque: float  # Nm per mille

    @classmethod
    def of(cls, machine: Machine, name: str) -> "Scale":
        """Return the scale of a drive as it is commissioned."""
        drive, (gear, _) = machine.drives[name], machine.joint(name)
        axis = drive.axis
        if axis.parameters_changed:  # what was commissioned counts from the next cycle on
            machine.step()
        return cls(
            float(axis.rad_per_position_unit) / gear, float(axis.rad_s_per_velocity_unit) / gear,
            int(axis.od.motor_rated_torque) * 1e-6,
        )


def experiment(
    signals: Mapping[str, Signal], machine: Machine, name: str, *, log: str = "log",
    mode: int | None = None, torque_constant: float | None = None, cycle: float | None = None,
    hold: bool = False, span: tuple[float, float] | None = None,
) -> Experiment:
    """Make an experiment from the part of a log that belongs to one drive.

    Args:
        signals: signals by object name.
        machine: machine whose drive is commissioned as the logged one: units, cycles and limits.
        name: name of its drive.
        log: name of the log, for messages.
        mode: mode of operation; by default that of the log.
        torque_constant: Nm/A, for a log that contains the current in A instead of a torque.
        cycle: bus cycle of the master (s), if the log was sampled less often.
        hold: set-points are steps from sample to sample, not points on a curve.
        span: begin and end (s), one of `spans`; by default the longest.

    Raises:
        Unusable: the log is unsuitable; the message says how to record a better one.
    """
    drive, scale = machine.drives[name], Scale.of(machine, name)
    notes: list[str] = []
    position, quantum_p = _measured_position(signals, scale, log)
    torque, quantum_t = _measured_torque(signals, drive, scale, torque_constant, log)
    begin, end = span or max(spans(signals, log), key=lambda each: each[1] - each[0])
    used = _mode(signals, mode, log, begin, end)
    target = (CYCLIC | OCCASIONAL)[Mode(used)]
    if target not in signals and used == Mode.PROFILE_POSITION and "target_position" not in signals:
        raise Unusable(f"{log}: no set-points of {target} in it: log the RPDOs of the master too")
    if target not in signals:
        known = "position_demand_value"
        if used != Mode.CYCLIC_SYNC_POSITION or known not in signals:
            raise Unusable(
                f"{log}: no set-points ({target}) in it: record what the master sends too, or "
                "the demand 6062h"
            )
        signals = dict(signals) | {target: signals[known]}
        notes.append("set-points: the drive's own demand 6062h")
    raw = _in_units(signals[target], scale, target)
    cyclic = Mode(used) in CYCLIC
    step = machine.cycle_time
    position, torque = (_inside(each, begin, end) for each in (position, torque))
    if cyclic:
        raw = _inside(raw, begin, end)
    samples = _regular(position.time, log)
    if cyclic:
        places = _regular(raw.time, log)
        if cycle is not None and places.period > 1.5 * cycle:
            raw = filled(raw, places.even, cycle, hold)
            places = _regular(raw.time, log)
        if places.jitter > IRREGULAR * places.period:
            places = _by_clock_of(samples, raw.time, places)
        places, samples = _one_clock(places, samples)
        period = _whole_period(places.period, step, log)
    else:
        places, period = samples, _free_period(samples.period, step)
        begin = _first_rest(position, begin, end, quantum_p, log)
    # one clock: the drive's, in which the bus period is a whole number of cycles
    stretch = period / places.period
    origin = float(position.time[np.searchsorted(position.time, begin)])
    end = min(end, float(raw.time[-1]) + (period if cyclic else math.inf))

    def clock(at: np.ndarray) -> np.ndarray:
        return (np.asarray(at) - origin) * stretch

    if cyclic:
        origin = places.nearest(origin)
    inside = (samples.even >= origin - 1e-9) & (samples.even <= end)
    inside &= np.append(np.diff(samples.even) > 0.5 * samples.period, True)  # one a cycle
    time = clock(samples.even[inside])
    if len(time) < 20 or time[-1] - time[0] < SHORTEST:
        raise Unusable(
            f"{log}: only {max(len(time), 0)} samples of an enabled drive in it: record at least "
            f"{SHORTEST:g} s of moves with the drive enabled"
        )
    hole = float(np.diff(time).max())
    if hole > LONGEST_GAP:
        at = float(time[int(np.argmax(np.diff(time)))])
        raise Unusable(
            f"{log}: nothing was recorded for {hole:.2g} s after {at:.3g} s: record it again "
            "without gaps, or give the parts as logs of their own"
        )
    measured = position.value[inside]
    torques = _held(torque, samples.even[inside], samples.period)
    per = round(period / step) if cyclic else 1
    lead = math.ceil((SETTLING + _brake(drive)) / (per * step)) * per
    count = lead + math.ceil((float(time[-1]) + 5 * samples.period) / step) + per
    events = missed = None
    if cyclic:
        if np.count_nonzero((raw.time >= begin) & (raw.time <= end)) < 4:
            raise Unusable(f"{log}: too few set-points while the drive was enabled: record longer")
        rows, arrives, missed = cyclic_rows(
            signals, raw, clock(places.even), target, used, clock, step, per, lead, count
        )
        if places.jitter > IRREGULAR * places.period:
            notes.append(
                f"the set-points are sent irregularly ({1e3 * places.jitter:.2g} ms rms of a bus "
                f"cycle of {1e3 * places.period:.3g} ms): if the master was late, the drive moved "
                "otherwise than the twin; record with a master that keeps its cycle"
            )
    else:
        events = occasional(dict(signals) | {target: raw}, target, used, clock, step, lead, drive)
        rows, arrives = events.rows(count), np.ones(count, np.uint8)
        unknown = [name for name in PROFILE[:3] if name not in signals]
        if used == Mode.PROFILE_POSITION and unknown:
            notes.append(
                f"{', '.join(unknown)} of the moves: not in the log, so those of the machine; "
                "record from before they are written, or give them with --read-gains"
            )
    moving = float(np.ptp(measured))
    if moving < 20 * max(quantum_p, 1e-9):
        raise Unusable(
            f"{log}: the axis does not move in it ({moving:.2g} of travel): record point-to-point "
            "moves to both sides at two accelerations"
        )
    if np.ptp(torques) <= 3 * quantum_t:
        raise Unusable(
            f"{log}: the torque does not change in it: map torque_actual_value (6077h), or "
            "current_actual_value (6078h), into a TPDO and record again"
        )
    low, high = machine.range(name)
    if not (low <= measured.min() and measured.max() <= high):
        notes.append(
            "positions outside the range of the machine: not homed, or its zero is elsewhere"
        )
    lost = 1.0 - len(time) / max(
        round(float(time[-1] - time[0]) / (samples.period * stretch)) + 1, 1
    )
    found = Experiment(
        log, used, step, period, rows, arrives, lead, float(measured[0]), time, measured, torques,
        (quantum_p, quantum_t), _written(signals, drive), tuple(notes), max(lost, 0.0), events,
        missed,
    )
    _within_limits(found, drive)
    if target == "target_position":
        asked = np.interp(time, clock(raw.time), raw.value * scale.position)
        if not cyclic:  # a set-point holds until the next one
            held = np.searchsorted(clock(raw.time), time, "right") - 1
            asked = raw.value[np.clip(held, 0, None)] * scale.position
        _fitting(asked, measured, quantum_p, log)
    return found


def _within_limits(found: Experiment, drive: Drive) -> None:
    """Refuse a log whose torque is at its limit, as the control loops are open there."""
    axis = drive.axis
    limit = 0.995 * min(float(axis.torque_limit_positive), float(axis.torque_limit_negative))
    beyond = float(np.abs(found.torque).max()) / max(limit, 1e-12)
    if beyond > BEYOND:
        raise Unusable(
            f"{found.name}: a torque of {beyond:.2g} times the limit of the drive is in it: give "
            "its rated torque (6076h), or its current with --torque-constant; record again if the "
            "limit itself is another"
        )
    at_limit = float(np.mean(np.abs(found.torque[found.moving]) >= limit))
    if at_limit > SATURATED:
        raise Unusable(
            f"{found.name}: the torque is at its limit in {100 * at_limit:.0f} % of the motion, "
            "so the loops are open there: record moves with less acceleration"
        )


def _fitting(asked: np.ndarray, measured: np.ndarray, quantum: float, log: str) -> None:
    """Refuse a log whose set-points and positions have different axes or units."""
    travel = float(np.ptp(measured))
    ratio = float(np.ptp(asked)) / max(travel, quantum, 1e-12)
    if not 1 / ALIKE < ratio < ALIKE:
        raise Unusable(
            f"{log}: the set-points travel {ratio:.3g} times as far as the axis: their units or "
            "their axis are others; record 607Ah and 6064h of one node, or mend --columns"
        )
    away = float(np.median(measured - asked))
    if abs(away) > 0.5 * travel:
        raise Unusable(
            f"{log}: the axis lies {away:.3g} away from its set-points: home it before, and record "
            "607Ah and 6064h of one node"
        )


@dataclass(frozen=True)
class Cadence:
    """Time stamps of cyclic frames, without their jitter."""

    period: float  # by the clock of the log (s)
    phase: float  # s
    even: np.ndarray  # the stamps without their jitter (s)
    jitter: float = 0.0  # rms of the stamps about them (s)

    def nearest(self, at: float) -> float:
        """Return the stamp without jitter that is nearest to a time (s)."""
        return self.phase + round((at - self.phase) / self.period) * self.period


def _regular(time: np.ndarray, log: str) -> Cadence:
    """Estimate the period of time stamps by least squares over their cycle numbers."""
    if len(time) < 3:
        raise Unusable(f"{log}: fewer than 3 samples: record the moves with the bus running")
    steps = np.diff(time)
    steps = steps[steps > 0]
    period = float(np.median(steps))
    for _ in range(8):
        number = np.zeros(len(time))
        number[1:] = np.cumsum(np.maximum(np.round(np.diff(time) / period), 0))
        slope, first = np.polyfit(number, time, 1)
        if slope <= 0 or abs(slope / period - 1) < 1e-12:
            break
        period = float(slope)
    number = np.round((time - first) / period)
    slope, first = np.polyfit(number, time, 1)
    even = first + slope * number
    jitter = float(np.sqrt(np.mean((time - even) ** 2)))
    return Cadence(float(slope), float(first), even, jitter)


def _by_clock_of(samples: Cadence, time: np.ndarray, places: Cadence) -> Cadence:
    """Number stamps by the clock of the samples, if their own distances are too irregular."""
    period = samples.period / max(round(samples.period / places.period), 1)
    turns = np.exp(2j * np.pi * time / period).mean()
    phase = float(np.angle(turns)) / (2 * np.pi) * period
    number = np.round((time - phase) / period)
    return Cadence(period, phase, phase + number * period, places.jitter)


def _one_clock(places: Cadence, samples: Cadence) -> tuple[Cadence, Cadence]:
    """Give set-points and samples of the same clock a common rate, with phases of their own."""
    ratio = round(samples.period / places.period)
    if ratio < 1 or abs(samples.period / places.period / ratio - 1) > 1e-3:
        return places, samples
    rate = 0.5 * (places.period + samples.period / ratio)
    found = []
    for each, period in ((places, rate), (samples, ratio * rate)):
        number = np.round((each.even - each.phase) / each.period)
        phase = float(np.mean(each.even - number * period))
        found.append(Cadence(period, phase, phase + number * period, each.jitter))
    return found[0], found[1]


def _whole_period(period: float, step: float, log: str) -> float:
    """Round the bus period (s) to whole position cycles of the drive."""
    cycles = max(round(period / step), 1)
    if abs(cycles * step / period - 1) > 0.02:
        raise Unusable(
            f"{log}: a bus cycle of {period * 1e3:.4g} ms is not a multiple of the drive's "
            f"position cycle of {step * 1e3:g} ms: is --drive right?"
        )
    return cycles * step


def _free_period(period: float, step: float) -> float:
    """Return the period of samples (s) that are not tied to set-points.

    A period close to whole position cycles is rounded to them, as the rest is the error of the
    logger's clock. Samples taken by another timer keep their period.
    """
    whole = max(round(period / step), 1) * step
    return whole if abs(whole / period - 1) < DRIFT else period


def _in_units(signal: Signal, scale: Scale, name: str) -> Signal:
    """Convert a set-point to drive units, also from a table in SI."""
    if signal.unit in ("m", "rad"):
        return Signal(signal.time, signal.value / scale.position, "")
    if signal.unit in ("m/s", "rad/s"):
        return Signal(signal.time, signal.value / scale.velocity, "")
    if signal.unit == "Nm":
        return Signal(signal.time, signal.value / scale.torque, "")
    return signal


def _measured_position(
    signals: Mapping[str, Signal], scale: Scale, log: str
) -> tuple[Signal, float]:
    if "position_actual_value" not in signals:
        raise Unusable(
            f"{log}: no position in it: map position_actual_value (6064h) into a TPDO and record "
            "again"
        )
    signal = signals["position_actual_value"]
    si = signal.unit in ("m", "rad")
    value = signal.value if si else signal.value * scale.position
    steps = np.abs(np.diff(np.unique(value)))
    quantum = float(steps.min()) if len(steps) else 0.0
    return Signal(signal.time, value, "m"), max(quantum, abs(scale.position) if not si else 0.0)


def _measured_torque(
    signals: Mapping[str, Signal], drive: Drive, scale: Scale, constant: float | None, log: str
) -> tuple[Signal, float]:
    for name in ("torque_actual_value", "current_actual_value"):
        if name not in signals:
            continue
        signal = signals[name]
        per = scale.torque  # per mille of the rated current too: the motor has a torque constant
        if signal.unit == "Nm":
            per = 1.0
        elif signal.unit == "A":
            if constant is None:
                raise Unusable(f"{log}: the current is in A: say --torque-constant in Nm/A")
            per = constant
        steps = np.abs(np.diff(np.unique(signal.value * per)))
        quantum = float(steps.min()) if len(steps) else 0.0
        return Signal(signal.time, signal.value * per, "Nm"), quantum
    raise Unusable(
        f"{log}: no torque in it: map torque_actual_value (6077h) or current_actual_value (6078h) "
        "into a TPDO and record again"
    )


def spans(signals: Mapping[str, Signal], log: str = "log") -> list[tuple[float, float]]:
    """Return the times (s) between which the drive was enabled in one mode of operation.

    A deployment homes the axis and moves it to the start of each episode in other modes. A cyclic
    mode takes precedence, then the mode in which the drive was enabled longest.

    Raises:
        Unusable: the drive was never enabled.
    """
    if "position_actual_value" not in signals:
        return [(0.0, math.inf)]
    time = signals["position_actual_value"].time
    first, last = float(time[0]), float(time[-1])
    if "statusword" not in signals:
        return [(first, last)]
    word = signals["statusword"]
    on = (word.value.astype(int) & STATE) == ENABLED
    if not on.any():
        raise Unusable(
            f"{log}: the drive is never enabled in it: begin the record, enable, make the moves"
        )
    mode = np.zeros(len(on), int)
    shown = next((signals[name] for name in MODES if name in signals), None)
    if shown is not None:
        mode = _last(shown, word.time)
    if "controlword" in signals:  # up to the command that disables the drive
        on &= _last(signals["controlword"], word.time) & 0x0F == 0x0F
    kind = np.where(on, mode, OFF)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(kind)) + 1, [len(kind)]])
    found: dict[int, list[tuple[float, float]]] = {}
    for a, b in itertools.pairwise(edges):
        if kind[a] == OFF:
            continue
        begin = max(float(word.time[a]), first)
        end = min(float(word.time[b - 1]) if b < len(on) else last, last)
        after = time[(time >= begin) & (time <= end)]
        found.setdefault(int(kind[a]), []).append(
            (float(after[0]) if len(after) else begin, max(begin, end)))
    lengths = {mode: sum(end - begin for begin, end in parts) for mode, parts in found.items()}
    return found[max(found, key=lambda mode: (
        mode in [*CYCLIC, *OCCASIONAL], mode in [*CYCLIC] and lengths[mode] > SHORTEST,
        lengths[mode],
    ))]


def _last(signal: Signal, at: np.ndarray) -> np.ndarray:
    """Return the latest values, as integers, at some times."""
    last = np.searchsorted(signal.time, at, "right") - 1
    return signal.value.astype(int)[np.clip(last, 0, None)]


def _inside(signal: Signal, begin: float, end: float) -> Signal:
    """Return the part of a signal between two times (s)."""
    inside = (signal.time >= begin - 1e-9) & (signal.time <= end + 1e-9)
    return Signal(signal.time[inside], signal.value[inside], signal.unit)


def _mode(
    signals: Mapping[str, Signal], given: int | None, log: str, begin: float, end: float
) -> int:
    if given is not None:
        return given
    for name in MODES:
        if name in signals:
            s = signals[name]
            at = np.searchsorted(s.time, [begin + 0.5 * (end - begin)], "right")[0] - 1
            value = int(s.value[max(at, 0)])
            if value in [*CYCLIC, *OCCASIONAL]:
                return value
            raise Unusable(f"{log}: the drive moves in mode {value}: record moves in csp or pp")
    for name in ("target_position", "position_demand_value"):
        if name in signals:
            changes = np.count_nonzero(np.diff(signals[name].value))
            few = changes < 0.1 * len(signals[name].value) and name == "target_position"
            controlword = "controlword" in signals
            pp = few and controlword
            return int(Mode.PROFILE_POSITION if pp else Mode.CYCLIC_SYNC_POSITION)
    if "target_velocity" in signals:
        return int(Mode.CYCLIC_SYNC_VELOCITY)
    raise Unusable(
        f"{log}: no set-points in it: record what the master sends too (607Ah), or the demand 6062h"
    )


def _first_rest(
    position: Signal, begin: float, end: float, quantum: float, log: str
) -> float:
    """Return the first time at which the axis is at rest (s)."""
    inside = (position.time >= begin) & (position.time <= end)
    time, value = position.time[inside], position.value[inside]
    if len(time) < 3:
        raise Unusable(f"{log}: too few samples of an enabled drive: record longer")
    still = 0.0
    for n in range(1, len(time)):
        step = time[n] - time[n - 1]
        slow = abs(value[n] - value[n - 1]) <= max(MOTION * step, 2e-6, 2 * quantum)
        still = still + step if slow else 0.0
        if still >= REST:
            return float(time[n])
    raise Unusable(
        f"{log}: the axis never stands still, so the state a profile begins in is unknown: begin "
        "the record at rest"
    )


def _held(signal: Signal, at: np.ndarray, period: float) -> np.ndarray:
    """Return the sample of the same cycle at each time; a missing one is interpolated."""
    place = np.clip(np.searchsorted(signal.time, at - 0.5 * period), 0, len(signal.time) - 1)
    near = np.abs(signal.time[place] - at) <= 0.75 * period
    return np.where(near, signal.value[place], np.interp(at, signal.time, signal.value))


def _smooth(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Average over 5 ms, so that encoder increments are not taken for motion."""
    count = 2 * round(2.5e-3 / max(float(np.median(np.diff(time))), 1e-9)) + 1
    padded = np.pad(values, count // 2, mode="edge")
    return np.convolve(padded, np.ones(count) / count, "valid")


def _brake(drive: Drive) -> float:
    od = drive.axis.od
    return 1e-3 * float(od.brake_release_time) if int(od.brake_fitted) else 0.0


def _written(signals: Mapping[str, Signal], drive: Drive) -> dict[str, float]:
    """Return the jerk and the gains that were written in the log."""
    names = ("profile_jerk_1", "velocity_control_gain", "velocity_control_time",
             "position_control_gain", "velocity_feed_forward", "velocity_filter_time")
    return {
        name: float(signals[name].value[-1])
        for name in names
        if name in signals and signals[name].unit not in SI
    }
