"""Machines that repeat an experiment in parallel, each with its own parameters."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from ...drive.drive import Drive
from ...drive.kernel.words import State
from ..engine import parameters
from ..engine.machine import Machine
from ..engine.replay import Replay
from .experiment import Experiment

LAG = "lag"  # s, from a set-point on the bus to a sample on it; not a parameter of a machine
SEED = "seed"  # of the encoder's noise; not a parameter of a machine either
BESIDE = (LAG, SEED)
READ = ("torque", "position_demand", "shaft_angle", "zero_counts")
COARSE = 2000  # increments a motor revolution, below which the place within one matters
UNWATCHED = {  # the machine of the log kept running, so monitoring must not stop its twin
    "following_error_window": (2**31 - 1,), "undervoltage": (0,), "overvoltage": (2**31 - 1,),
}
SMOOTH = 1 << 24  # increments a revolution; with fewer, rounding makes derivatives noisy
UNITS = ("rad_per_position_unit", "rad_s_per_velocity_unit", "velocity_gain_unit",
         "position_gain_unit")
UNLIMITED = (2**31 - 1, 32767)  # 1/min; the first one that the model accepts is used
MARGIN = 2e-3  # m or rad, distance of an experiment from the ends of the joint


class Simulated(NamedTuple):
    """Simulated values at the samples of an experiment, each of shape ``(candidates, m)``."""

    position: np.ndarray  # m or rad
    torque: np.ndarray  # Nm
    demand: np.ndarray  # m or rad
    # position and torque of the nearest row, whose noise no interpolation has smoothed;
    # shape (candidates, m, 2)
    nearest: np.ndarray


class Candidates:
    """Machines of one kind, and the state in which each experiment begins.

    Args:
        make: builds one commissioned machine.
        drive: name of the drive that moves; the other drives hold their position.
        count: number of machines that run in parallel.
    """

    def __init__(self, make: Callable[[], Machine], drive: str | None = None, count: int = 12):
        self.machines = [make() for _ in range(count)]
        self.drive = next(iter(self.machines[0].drives)) if drive is None else drive
        for machine in self.machines:  # commissioned values take effect in the first cycle
            machine.step()
        self.joints = [parameters.Joint(m, self.drive) for m in self.machines]
        axis = self.joint.drive.axis
        self.increment = float(axis.rad_per_increment) / abs(self.joint.gear)
        self.coarse = 2 * np.pi / float(axis.rad_per_increment) < COARSE
        if not self.coarse:
            _smooth(self.machines[0], self.drive)
        self.smooth = 2 * np.pi / float(axis.rad_per_increment) >= SMOOTH / 2
        self._new = [machine.snapshot() for machine in self.machines]
        self.runs = 0
        self._starts: dict[int, tuple[Experiment, list[bytes], np.ndarray]] = {}

    @property
    def joint(self) -> parameters.Joint:
        """The joint of the first machine."""
        return self.joints[0]

    @property
    def fault(self) -> int:
        """Error code (603Fh) of the first machine if its last run ended in a fault, else 0."""
        axis = self.joint.drive.axis
        stopped = State(int(axis.state)) in (State.FAULT, State.FAULT_REACTION_ACTIVE)
        return int(axis.od.error_code) if stopped else 0

    def _start(self, experiment: Experiment, count: int) -> tuple[list[bytes], np.ndarray]:
        """Return snapshots of machines at rest where the rows begin, and the rows."""
        kept = self._starts.get(id(experiment))
        if kept is None or kept[0] is not experiment:
            images = np.zeros(len(experiment.arrives), self._layout(experiment).written)
            for name, values in experiment.rows.items():
                images[name] = values
            kept = self._starts[id(experiment)] = (experiment, [], images)
        _, starts, images = kept
        begin = self._begin(experiment) if len(starts) < count else 0.0
        for machine, new in zip(self.machines[len(starts) : count], self._new[len(starts) :],
                                strict=False):
            machine.restore(new)  # removes the settings of earlier runs, such as noise
            starts.append(_stand(machine, self.drive, begin, experiment, self.smooth))
        return starts, images

    def _layout(self, experiment: Experiment) -> Replay:
        return Replay(self.drive, [*experiment.rows], READ)

    def _begin(self, experiment: Experiment) -> float:
        """Return the position of the machine before the rows, as the drive counts (m or rad)."""
        target = experiment.rows.get("target_position")
        if target is None or experiment.mode == 1:
            return experiment.start
        from .experiment import Scale

        unit = Scale.of(self.machines[0], self.drive).position
        moved = float(target[0] - target[experiment.begins]) * unit
        return experiment.start + moved

    def simulate(self, experiment: Experiment, values: Sequence[Mapping[str, float]]) -> Simulated:
        """Repeat an experiment with each set of parameter values.

        Args:
            experiment: the experiment to repeat.
            values: parameter values by name, including `LAG`.
        """
        parts = [
            self._some(experiment, values[n : n + len(self.machines)])
            for n in range(0, len(values), len(self.machines))
        ]
        return Simulated(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def _some(self, experiment: Experiment, values: Sequence[Mapping[str, float]]) -> Simulated:
        count = len(values)
        starts, rows = self._start(experiment, count)
        for machine, joint, start, given in zip(
            self.machines, self.joints, starts, values, strict=False
        ):
            machine.restore(start)
            give(joint, given)
        self.runs += count
        found = self._layout(experiment).run(self.machines[:count], rows, experiment.arrives)
        axis = self.joint.drive.axis
        gear, begins = self.joint.gear, experiment.begins
        zero = found["zero_counts"] * (float(axis.rad_per_increment) / gear)
        torque = found["torque"]
        torque = np.concatenate([torque[:, :1], torque[:, :-1]], axis=1)  # as 6077h shows it
        demand = found["position_demand"] / gear
        at = np.array([experiment.time - given.get(LAG, 0.0) for given in values])
        at = at / experiment.cycle + begins - 1.0
        # shaft position between increments; the last sample of a row lies after its first
        fine = found["shaft_angle"] / gear - zero
        if self.coarse:
            fine -= 0.5 * self.increment
        behind = 1.0 - float(axis.velocity_period) / experiment.cycle
        line, last = np.arange(count)[:, None], torque.shape[1] - 1
        nearest = np.stack([
            rows_of[line, np.clip(np.round(places).astype(int), 0, last)]
            for rows_of, places in ((fine, at - behind), (torque, at))
        ], axis=-1)
        return Simulated(_at(fine, at - behind), _at(torque, at), _at(demand, at), nearest)


def give(joint: parameters.Joint, values: Mapping[str, float]) -> None:
    """Set the parameters of one machine; entries in `BESIDE` are not parameters."""
    joint.set({name: value for name, value in values.items() if name not in BESIDE})
    if SEED in values:
        joint.coupling.noise_state = int(values[SEED])


def _stand(
    machine: Machine, drive: str, begin: float, experiment: Experiment, smooth: bool
) -> bytes:
    """Bring a machine to the start of an experiment and return a snapshot of it."""
    low, high = machine.range(drive)
    reach = np.concatenate([[begin], experiment.position])
    least, most = float(reach.min()), float(reach.max())
    shift = 0.0
    if not (low + MARGIN <= least and most <= high - MARGIN):
        shift = 0.5 * (low + high) - 0.5 * (least + most) if np.isfinite(low + high) else 0.0
    x = machine.drives[drive]
    limits = x.axis.position_limit_min, x.axis.position_limit_max
    first, last = sorted(float(limit) / machine.joint(drive)[0] for limit in limits)
    if shift or least < first or most > last:  # the logged axis moved beyond these limits
        x.commission({"min_position_limit": 0, "max_position_limit": 0})
    for name, values in UNWATCHED.items():
        _first(x, name, values)
    if _fastest(experiment, x.axis, machine.joint(drive)[0]) > 0.9 * float(x.axis.max_speed):
        _first(x, "max_motor_speed", UNLIMITED)
    units = round(experiment.period * 1e6)
    if experiment.mode in (7, 8, 9, 10):
        index = -6 if units <= 255 else -4 if units % 1000 else -3
        value = units / 10 ** (6 + index)
        x.commission({"interpolation_time_index": index})
        x.commission({"interpolation_time_period_value": value})
    x.commission(
        {name: value for name, value in experiment.objects.items() if name in x.objects.names}
    )
    machine.reset(positions=_places(machine) | {drive: begin + shift})
    _first(x, "buffer_clear", (1,))  # 60C4h:06, without which 60C1h is locked
    machine.step()
    if smooth:
        _smooth(machine, drive)
    axis: Any = x.axis
    wanted = round(begin * parameters.Joint(machine, drive).gear / float(axis.rad_per_increment))
    axis.zero_counts = int(axis.counts) - wanted
    axis.homed = 1
    machine.step()
    return machine.snapshot()


def _smooth(machine: Machine, drive: str) -> None:
    """Give the drive a fine encoder, unless a unit of the drive depends on its resolution."""
    axis: Any = machine.drives[drive].axis
    before = [float(getattr(axis, name)) for name in UNITS]
    had = axis.od.position_encoder_resolution.copy()
    if 2 * np.pi / float(axis.rad_per_increment) >= SMOOTH:
        return
    for resolution in ((SMOOTH, 1), had):  # in the record, as some models lack the object
        axis.od.position_encoder_resolution[:] = resolution
        axis.parameters_changed, axis.sampled = 1, 0
        machine.step()
        if np.allclose([float(getattr(axis, name)) for name in UNITS], before, rtol=1e-9):
            return


def _first(drive: Drive, name: str, values: Sequence[int]) -> None:
    """Write the first of some values that the drive accepts, if the drive has the object."""
    for value in values:
        with suppress(ValueError, KeyError):
            drive.commission({name: value})
            return


def _fastest(experiment: Experiment, axis: Any, gear: float) -> float:
    """Return the highest shaft speed (rad/s) of the set-points or the measured motion."""
    target = experiment.rows.get("target_position")
    asked = 0.0
    if target is not None and experiment.arrives.mean() > 0.01:  # cyclic
        asked = float(np.abs(np.diff(target)).max()) * float(axis.rad_per_position_unit)
    moved = np.abs(np.diff(experiment.position)) / np.diff(experiment.time)
    return max(asked / experiment.period, float(moved.max()) * abs(gear))


def _places(machine: Machine) -> dict[str, float]:
    """Return the mid-range position of each joint with a limited range."""
    ranges = {name: machine.range(name) for name in machine.drives}
    return {n: 0.5 * (low + high) for n, (low, high) in ranges.items() if np.isfinite(high - low)}


def _at(rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate rows by the cubic through the four nearest; the result has the shape of `at`."""
    last = rows.shape[1] - 3
    left = np.clip(np.floor(at).astype(int), 1, last)
    t = np.clip(at - left, -1.0, 2.0)
    weights = (
        -t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2, (t + 1) * t * (t - 1) / 6,
    )
    line = np.arange(len(rows))[:, None]
    return sum(w * rows[line, left + n - 1] for n, w in enumerate(weights))
