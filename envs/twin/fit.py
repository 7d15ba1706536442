"""Fits twins to experiments: regression, search, choice of the family, intervals, verdict."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...drive.model.model import DriveModel
from ..engine import parameters
from ..plants.tuning import inertia_at_shaft
from .candidates import LAG, Candidates, Simulated
from .estimate import Estimate, FreeParameter, Noise, Search
from .experiment import Experiment, Unusable
from .families import AUTO, GAINS, Family, family
from .reconstruction import expected, restored, timed
from .regression import Rough, regress

HELD_OUT = 0.35  # share of a single log, at its end; of several logs the last one is held out
GOOD, FAIR = 1.3, 2.0  # limits of the position error over the noise floor
STIFFNESS, PER_DECADE = (2e3, 4e6), 11  # N/m, range of the grid of springs, and its density
TURNING = (1 / 30, 30)  # the same range for a rotary axis, in multiples of the nominal value
MASSES = (0.5, 1.0, 2.0)  # multiples of the closed form's mass, which ignores the spring
DAMPINGS = (0.03, 0.1)  # damping ratios of the grid
BEST = 3  # start points that are followed
FOLLOWED = 12  # further steps of the best one
VALLEY = (0.7, 0.8, 0.86, 0.91, 0.95, 0.98, 1.02, 1.05, 1.1, 1.16, 1.25)  # factors of the mass
GAIN_GRID = [(v, p) for v in (0.45, 0.7, 1.0, 1.5, 2.4) for p in (0.5, 0.75, 1.0, 1.4)]
PID = ("pid_gain", "pid_integral_gain", "pid_derivative_gain")
KEPT = {  # parameter that a drive stores rounded -> its object
    "velocity_gain": "velocity_control_gain", "integral_time": "velocity_control_time",
    "position_gain": "position_control_gain", **{name: name for name in PID},
}
PID_GRID = [(p, i, d) for p in (0.7, 1.2, 2.0) for i in (0.1, 0.3, 1.0) for d in (0.7, 1.1, 1.6)]
LATE = (-1.5e-3, 0.0, 1.5e-3)  # s, start values about the lag of the first run
GAP = 2e-6  # m or rad, step of a backlash in the search
SLIGHT = 0.02  # least friction over the highest force, for the step of the search
UNEXPLAINED = 0.3  # least share of the torque that inertia and friction have to explain
NOTHING = 0.1  # the same if the resulting inertia is plausible
SELDOM = 4e-3  # s between samples, above which the closed form cannot refuse a log
STEEP = 2.0  # N/kg along the axis, above which its holding torque gives the payload
LIGHT = 0.85  # least inertia over that of the motor and the known parts on its shaft


@dataclass(frozen=True)
class Fitted:
    """The fit of one family to the logs."""

    family: Family
    values: dict[str, float]  # parameters, and `LAG`
    estimate: Estimate  # from all samples, held-out ones included
    rough: Rough
    held_position: float  # rms, m or rad
    held_torque: float  # rms, Nm
    floor_position: float  # residual of encoder noise and rounding alone
    floor_torque: float
    share: float  # share of the motion that is explained, 0..1
    noise: float  # standard deviation of the encoder, m or rad
    fitted_ratio: float  # error of the fitted part over its noise floor
    unit: str
    runs: int
    increment: float = 0.0  # of a coarse encoder (m or rad), which is the floor; otherwise 0
    complete: bool = True  # False if the fit was interrupted
    candidates: Candidates | None = field(default=None, compare=False, repr=False)
    simulated: list[Simulated] = field(default_factory=list, compare=False, repr=False)
    whole: list[Experiment] = field(default_factory=list, compare=False, repr=False)
    cuts: list[float] = field(default_factory=list)  # s, begin of the held-out part of each log

    @property
    def ratio(self) -> float:
        """Held-out position error over the noise floor."""
        return self.held_position / max(self.floor_position, 1e-12)

    @property
    def misfit(self) -> float:
        """The larger one of the held-out and the fitted position error, over the noise floor.

        A model that does not reproduce the fitted part is wrong, however quiet the held-out part.
        """
        return max(self.ratio, self.fitted_ratio)

    def shares(self, held: bool = True) -> dict[str, float]:
        """Residuals of position (rms, m or rad), following error and torque (shares).

        Args:
            held: evaluate the held-out part, otherwise the fitted part.
        """
        left: list[list[np.ndarray]] = [[], [], [], []]
        for experiment, run, cut in zip(self.whole, self.simulated, self.cuts, strict=True):
            at = (experiment.time >= cut) == held
            of_position, of_torque = experiment.residuals(run.position[0], run.torque[0]).T
            found = (
                of_position, run.demand[0] - experiment.position, of_torque, experiment.torque,
            )
            for column, values in zip(left, found, strict=True):
                column.append(values[at])
        position, error, torque, whole = (
            math.sqrt(float(np.mean(np.concatenate(column) ** 2))) for column in left
        )
        return {
            "position_rms": position, "following_error": position / max(error, 1e-12),
            "torque": torque / max(whole, 1e-12),
        }

    @property
    def verdict(self) -> str:
        """The verdict: ``good``, ``fair``, ``refused`` or ``interrupted``."""
        if not self.complete:
            return "interrupted"
        return "good" if self.misfit <= GOOD else "fair" if self.misfit <= FAIR else "refused"


def fit(
    experiments: Sequence[Experiment], drive: str | DriveModel, chosen: Family,
    *, gains_known: bool = False, progress: Callable[[str], object] = lambda text: None,
) -> Fitted:
    """Fit one family.

    Args:
        experiments: experiments of one axis; the last of several is held out, or the end of one.
        drive: drive model.
        chosen: family to fit.
        gains_known: the machine is commissioned with the gains of the log.
        progress: called with a line about the progress.

    Raises:
        Unusable: the logs do not contain enough information.
    """
    candidates = Candidates(lambda: chosen.make(drive), chosen.axis)
    joint = candidates.joint
    loss = float(joint.mechanics.gear_loss)
    rough = regress(list(experiments), joint.gear, _own(joint), loss)
    refuse(experiments, rough, joint, chosen)
    start = _start(chosen, joint, rough, experiments)
    start[LAG] = best_lag(candidates, experiments[0], start)
    experiments = [timed(candidates, each, start) for each in experiments]
    training, cuts = _split(experiments)
    search = Search(candidates, training)
    if candidates.fault:
        raise Unusable(
            f"{training[0].name}: the twin ends in fault {candidates.fault:04X}h, where the log "
            "runs on: its limits or its supply are others, give them with --read-gains or --set"
        )
    inertia = rough.inertia
    if not _plausible(rough):
        place = joint.model, joint.machine.data, int(joint.coupling.dof), joint.gear
        inertia = inertia_at_shaft(*place)
    strongest = max(float(np.abs(each.torque).max()) for each in training) * abs(joint.gear)
    free = _free(chosen, joint, start, gains_known, strongest, inertia)
    search.progress = lambda values, cost: progress(
        f"{chosen.name}: {_shown(values, chosen)}, misfit {math.sqrt(cost):.3g}"
    )
    best: dict[str, float] = dict(start)
    estimate, complete = None, True
    try:
        noise = search.start_noise()
        starts = _starts(search, chosen, joint, start, noise, gains_known)
        trials = [search.descend(free, each, noise, 5 if len(starts) > 1 else 8) for each in starts]
        estimate = min(trials, key=lambda each: each.cost)
        if len(starts) > 1:  # along the valley, in which mass and stiffness grow together
            estimate = search.descend(free, estimate.values, noise, FOLLOWED)
        best = estimate.values
        experiments = [timed(candidates, each, best) for each in experiments]
        search.experiments = _split(experiments)[0]
        for steps in () if candidates.coarse else (4, 8):
            experiments = [expected(candidates, each, best) for each in experiments]
            search.experiments = _split(experiments)[0]
            noise = search.noise(best)
            experiments = [restored(candidates, each, best, noise) for each in experiments]
            search.experiments = _split(experiments)[0]
            best = _along_valley(search, chosen, joint, best, noise)
            estimate = search.descend(estimate.finer(candidates.smooth), best, noise, steps,
                                      close=True)
            best = estimate.values
    except KeyboardInterrupt:
        complete = False
        if estimate is None:
            raise
    experiments = [expected(candidates, each, best) for each in experiments]
    held = _judge(candidates, experiments, cuts, best)
    inside = _judge(candidates, experiments, cuts, best, held_out=False)
    worse = _worse(search, Search(candidates, experiments), cuts, best, noise)
    worse = max(worse, (held[0] / max(held[2], 1e-12)) ** 2)  # errors that are no noise
    if complete:
        try:
            all_of_it = Search(candidates, experiments, progress=search.progress)
            if not candidates.coarse:
                noise = all_of_it.noise(best)
            best = _along_valley(all_of_it, chosen, joint, best, noise)
            estimate = all_of_it.descend(
                estimate.finer(candidates.smooth), best, noise, 6, close=True
            )
            if not candidates.coarse:
                estimate = all_of_it.bootstrapped(estimate)
            estimate = replace(estimate, covariance=estimate.covariance * worse)
        except KeyboardInterrupt:
            complete = False
    simulated = [candidates.simulate(each, [estimate.values]) for each in experiments]
    return Fitted(
        chosen, estimate.values, estimate, rough, *held, inside[0] / max(inside[2], 1e-12),
        joint.unit, candidates.runs,
        candidates.increment if candidates.coarse else 0.0, complete, candidates, simulated,
        list(experiments), cuts,
    )


def choose(
    experiments: Sequence[Experiment], drive: str | DriveModel, names: Sequence[str] = AUTO,
    built: Mapping[str, Any] | None = None, objects: Mapping[str, float] | None = None,
    *, gains_known: bool = False, progress: Callable[[str], object] = lambda text: None,
    free: Sequence[str] = (),
) -> tuple[Fitted, list[Fitted]]:
    """Fit families until one explains the logs; return the one with the least error, and all."""
    tried: list[Fitted] = []
    for name in names:
        try:
            chosen = replace(family(name).given(built, objects), extra=tuple(free))
            tried.append(
                fit(experiments, drive, chosen, gains_known=gains_known, progress=progress)
            )
        except KeyboardInterrupt:
            if not tried:
                raise
            break
        if tried[-1].misfit <= GOOD or not tried[-1].complete:
            break
    return min(tried, key=lambda each: each.misfit), tried


def refuse(
    experiments: Sequence[Experiment], rough: Rough, joint: parameters.Joint, chosen: Family
) -> None:
    """Raise Unusable for logs with too little information or with values that do not match."""
    name = experiments[0].name
    if rough.one_way:
        raise Unusable(
            f"{name}: the axis moves in one direction only, so friction and a constant load look "
            "alike: record moves there and back"
        )
    if experiments[0].sampling > SELDOM:
        return  # torque and acceleration between samples are unknown; the replay decides
    if rough.explained < NOTHING or (rough.explained < UNEXPLAINED and rough.inertia <= 0.0):
        raise Unusable(
            f"{name}: torque and motion do not belong together (inertia and friction explain "
            f"{100 * max(rough.explained, 0):.0f} % of the torque): is it the torque of this "
            "axis, are --drive and the units right, and are the signs those of the drive? Record "
            "6064h and 6077h of one node"
        )
    if not rough.accelerates and rough.inertia <= 0.0:
        raise Unusable(
            f"{name}: there is hardly an acceleration in it, so the mass cannot be told: record "
            "moves with at least half the usual acceleration"
        )
    if rough.inertia <= 0.0:
        raise Unusable(
            f"{name}: more torque goes with less acceleration: the sign of torque or position is "
            "turned (polarity 607Eh), or they are of two axes: record 6064h and 6077h of one node"
        )
    own = _own(joint)
    if chosen.mass != "rotor_inertia" and rough.inertia < LIGHT * own:
        raise Unusable(
            f"{name}: the inertia at the shaft comes out as {rough.inertia:.2g} kg·m², the motor's "
            f"own is {own:.2g} kg·m²: the units of position or torque do not fit, or the motor is "
            "another (--set rotor_inertia=...)"
        )


def _own(joint: parameters.Joint) -> float:
    """Return the inertia of the motor and of the known parts on its shaft (kg·m²)."""
    return parameters.PARAMETERS["rotor_inertia"].get(joint)


def _plausible(rough: Rough) -> bool:
    """Whether the closed form found an inertia, which samples far apart may prevent."""
    return rough.inertia > 0.0 and rough.explained >= UNEXPLAINED


def _split(experiments: Sequence[Experiment]) -> tuple[list[Experiment], list[float]]:
    """Return the fitted part, and the time from which each log is held out (s)."""
    if len(experiments) > 1:
        return list(experiments[:-1]), [math.inf] * (len(experiments) - 1) + [0.0]
    only = experiments[0]
    cut = (1 - HELD_OUT) * only.duration
    return [only.until(cut)], [cut]


def _start(
    chosen: Family, joint: parameters.Joint, rough: Rough, experiments: Sequence[Experiment]
) -> dict[str, float]:
    """Return the start values of the search at the joint, from the regression."""
    gear = joint.gear
    row = parameters.PARAMETERS[chosen.mass]
    nominal = row.get(joint)
    inertia = inertia_at_shaft(joint.model, joint.machine.data, int(joint.coupling.dof), gear)
    mass = nominal + (rough.inertia - inertia) * (1 if chosen.mass == "rotor_inertia" else gear**2)
    if not _plausible(rough):
        mass = nominal
    elif chosen.mass == "payload" and (per := _weight(joint)):  # from the holding torque
        body = joint.model.dof_bodyid[joint.coupling.dof]
        mass = nominal + rough.load * gear / per - float(joint.model.body_subtreemass[body])
    values = {
        chosen.mass: max(mass, 0.05 * nominal),
        "coulomb_friction": max(rough.coulomb * abs(gear), 0.05),
        "viscous_friction": max(rough.viscous * gear**2, 0.01),
        "load_force": 0.0,
    }
    for name in (*(chosen.spring or ()), *chosen.extra, *GAINS):
        values[name] = parameters.PARAMETERS[name].get(joint)
    if "supply_voltage" in values:
        values["supply_voltage"] = _voltage(experiments, joint) or values["supply_voltage"]
    return values


def _weight(joint: parameters.Joint) -> float:
    """Return the force (N) along the axis that holds a kilogram; 0 for a level axis."""
    model = joint.model
    axis = joint.machine.data.xaxis[model.dof_jntid[joint.coupling.dof]]
    force = -float(axis @ model.opt.gravity)
    return force if joint.unit == "m" and abs(force) > STEEP else 0.0


def _voltage(experiments: Sequence[Experiment], joint: parameters.Joint) -> float:
    """Return the winding voltage at the highest speed (V), which may be what limits the speed."""
    axis, found = joint.drive.axis, []
    constant = float(axis.torque_constant)
    if float(axis.resistance) <= 0.0 or constant <= 0.0:
        return 0.0
    for each in experiments:
        speed = np.gradient(each.position, each.time) * joint.gear
        fast = np.abs(speed) > 0.95 * np.percentile(np.abs(speed), 98)
        drop = float(axis.resistance) * each.torque[fast] / constant
        found.append(np.abs(float(axis.voltage_constant) * speed[fast] + drop))
    return float(np.median(np.concatenate(found)))


def best_lag(candidates: Candidates, experiment: Experiment, start: Mapping[str, float]) -> float:
    """Return the lag (s, whole cycles) at which simulated and measured positions agree best."""
    cycle, period = experiment.cycle, experiment.period
    first, last = -round(period / cycle) - 2, 6 * round(period / cycle) + 6
    shifts = np.arange(first, last + 1) * cycle
    run = candidates.simulate(experiment, [start])
    inside = (experiment.time > 2 * abs(shifts).max()) & experiment.moving
    times = experiment.time[inside]
    errors = [
        float(np.mean((np.interp(times - s, experiment.time, run.position[0])
                       - experiment.position[inside]) ** 2))
        for s in shifts
    ]
    return float(shifts[int(np.argmin(errors))])


def _free(
    chosen: Family, joint: parameters.Joint, start: Mapping[str, float], gains_known: bool,
    strongest: float, inertia: float,
) -> list[FreeParameter]:
    """Return the free parameters; the highest force and the inertia determine their steps."""
    names = [*chosen.unknown, LAG]
    if not gains_known:
        names += [*GAINS]
    found, od = [], joint.drive.axis.od
    whole = max(inertia, 1e-12) * (1.0 if chosen.mass == "rotor_inertia" else joint.gear**2)
    friction = max(start["coulomb_friction"], SLIGHT * strongest, 1e-9)
    for name in names:
        if name == LAG:
            found.append(FreeParameter(LAG, start[LAG], -0.02, 0.2, 2e-5))
            continue
        row = parameters.PARAMETERS[name]
        low, high = row.low, row.high
        if name == chosen.mass:  # a small mass in shares of the total, motor included
            found.append(FreeParameter(name, start[name], max(low, 1e-9), high, 0.05 * whole))
        elif name in ("coulomb_friction", "load_force"):
            found.append(FreeParameter(name, start[name], low, high, 0.05 * friction))
        elif name == "backlash":
            found.append(FreeParameter(name, start[name], low, high, GAP))
        elif name == "viscous_friction":
            found.append(FreeParameter(name, start[name], low, high, max(0.1 * start[name], 1e-3)))
        else:
            grain = 1 / max(float(getattr(od, KEPT[name])), 1.0) if name in KEPT else 0.0
            found.append(FreeParameter(name, start[name], max(low, 1e-9), high, 0.02, True, grain))
    return found


def _starts(
    search: Search, chosen: Family, joint: parameters.Joint, start: dict[str, float],
    noise: Noise, gains_known: bool,
) -> list[dict[str, float]]:
    """Return several start points, if there are local minima."""
    starts = [start]
    if "pid_gain" in chosen.extra:
        grid = [
            start | {name: start[name] * share for name, share in zip(PID, shares, strict=True)
                     if name in chosen.extra} | {LAG: start[LAG] + late}
            for shares in PID_GRID for late in LATE
        ]
        starts = [grid[n] for n in np.argsort(search.cost(grid, noise))[:2]]
    elif not gains_known:
        grid = [
            start | {"velocity_gain": start["velocity_gain"] * v,
                     "position_gain": start["position_gain"] * p}
            for v, p in GAIN_GRID
        ]
        starts = [grid[int(np.argmin(search.cost(grid, noise)))]]
    if chosen.spring:
        stiffness, damping = chosen.spring
        nominal = parameters.PARAMETERS[stiffness].get(joint)
        low, high = STIFFNESS if joint.unit == "m" else [nominal * share for share in TURNING]
        mass = max(start[chosen.mass], 1e-6)
        fastest = mass * (0.7 / joint.model.opt.timestep) ** 2
        count = round(PER_DECADE * math.log10(high / low)) + 1
        grid = [
            starts[0] | {
                chosen.mass: float(mass), stiffness: float(k),
                damping: 2 * ratio * math.sqrt(k * mass),
            }
            for mass in mass * np.array(MASSES)
            for k in np.geomspace(low, min(high, fastest), count)
            for ratio in DAMPINGS
        ]
        costs = search.cost(grid, noise)
        starts = []
        for n in np.argsort(costs):  # one from each valley
            if all(not 0.6 < grid[n][stiffness] / each[stiffness] < 1.6 for each in starts):
                starts.append(grid[n])
            if len(starts) == BEST:
                break
    return starts


def _along_valley(
    search: Search, chosen: Family, joint: parameters.Joint, values: dict[str, float],
    noise: Noise,
) -> dict[str, float]:
    """Return the best values on a line along which the axis moves in nearly the same way.

    A load on a spring keeps its natural frequency and damping ratio if mass, stiffness and damping
    change by one factor. A vertical axis needs the same holding torque if a constant force balances
    a change of the payload's weight. The position at which an axis sticks changes abruptly across
    such a valley and smoothly along it, so a search with derivatives by single parameters stops.
    """
    weight = _weight(joint) if chosen.mass == "payload" else 0.0
    if not chosen.spring and not weight:
        return values
    line = [values]
    for share in VALLEY:
        mass = share * values[chosen.mass]
        moved = values | {chosen.mass: mass}
        if chosen.spring:
            moved |= {name: share * values[name] for name in chosen.spring}
        if weight:
            moved["load_force"] = values["load_force"] + weight * (mass - values[chosen.mass])
        line.append(moved)
    return line[int(np.argmin(search.cost(line, noise)))]


def _worse(
    fitted: Search, whole: Search, cuts: Sequence[float], values: Mapping[str, float], noise: Noise
) -> float:
    """Return the ratio of held-out to fitted squares of white residuals, at least 1."""
    inside = float(fitted.cost([values], noise)[0])
    parts = [
        white[0][each.time[each.moving] >= cut]
        for white, each, cut in zip(
            whole.white([values], noise), whole.experiments, cuts, strict=True
        )
    ]
    outside = np.concatenate(parts)
    return max(float(np.mean(outside**2)) / max(inside, 1e-12), 1.0) if len(outside) else 1.0


def _judge(
    candidates: Candidates, experiments: Sequence[Experiment], cuts: Sequence[float],
    values: Mapping[str, float], held_out: bool = True,
) -> tuple[float, float, float, float, float, float]:
    """Return position and torque error, their floors, the share explained, and the noise."""
    left, spread, wave, sizes = [], [], [], []
    for experiment, cut in zip(experiments, cuts, strict=True):
        held = (experiment.time >= experiment.known) & ((experiment.time >= cut) == held_out)
        if not held.any():
            continue
        run = candidates.simulate(experiment, [values])
        left.append(experiment.residuals(run.position[0], run.torque[0])[held])
        wave.append(experiment.position[held] - experiment.position[held].mean())
        replicas = experiment.replicas
        spread.append(np.zeros_like(left[-1]) if replicas is None else replicas.spread[held])
        sizes.append(0.0 if replicas is None else replicas.deviation)
    quantum = np.square(experiments[0].quanta) / 12
    if candidates.coarse:  # a log and its twin may each be off by half an increment
        quantum[0] = max(quantum[0], candidates.increment**2)
    position, torque = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)).tolist()
    floor = np.sqrt(np.mean(np.concatenate(spread) ** 2, axis=0) + quantum).tolist()
    moved = float(np.std(np.concatenate(wave)))
    return (
        position, torque, floor[0], floor[1], 1.0 - position / max(moved, 1e-12),
        float(np.mean(sizes)),
    )


def _shown(values: Mapping[str, float], chosen: Family) -> str:
    names = [chosen.mass, "coulomb_friction", *((chosen.spring or ())[:1])]
    return ", ".join(f"{name} {values[name]:.4g}" for name in names if name in values)
