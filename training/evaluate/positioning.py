"""`servogym benchmark positioning`: ways to move from point to point, on tuned axes.

The benchmark plays LinearAxis-v0 with fixed moves; its axes are commissioned as by `linear_axis`
(``tuned=True``). The settling time is that of the carriage itself, including the elasticity between
carriage and motor. CompliantAxis-v0 provides one more axis: its payload swings on a spring, a
sensor measures it, and torque can be fed forward, so state feedback and feed-forward can act. Each
strategy moves each payload under the conditions for which it was planned. It also moves one payload
with half and twice the friction, with a resonance 20 % lower and higher than planned, and on a weak
supply.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...envs import FAMILY, POINT_TO_POINT, SWINGING_LOAD, ServoEnv
from ..policies.file import SUFFIX, from_file
from ..report import number
from ..scale.job import Result
from ..setup import Setup
from .benchmark import Benchmark, Report, Row, known_mechanics
from .episodes import fixed
from .grid import Grid
from .parts import Episodes, warm

STRATEGIES = (
    "trapezoid", "jerk_limited", "s_curve", "ruckig", "ruckig+zv", "ruckig+zvd", "ruckig+ei",
    "ruckig+notch", "ruckig+ff", "lqr", "adaptive_lqr", "proportional", "learned",
    "informed_ruckig", "informed_lqr",
)
PAYLOADS = (1.0, 5.0, 20.0)  # kg
DISTANCES = (0.01, 0.05, 0.2)  # m
STARTS = (0.15, 0.35)  # m; the move goes to the side that has room
QUICK_FAMILY, QUICK_PAYLOADS, QUICK_DISTANCES = ("rigid", "toothed_belt"), (5.0,), (0.01,)
NOMINAL = "nominal"
CHANGED: dict[str, dict[str, float]] = {  # changes that a strategy does not know
    "friction ×0.5": {"friction": 0.5},
    "friction ×2": {"friction": 2.0},
    "frequency −20 %": {"stiffness": 0.64},
    "frequency +20 %": {"stiffness": 1.44},
}
# the motor behind its voltage: a link of 200 V instead of 325 V, which sags by 10 Ohm (inferred)
WEAK_SUPPLY, WEAK = "weak supply", {
    "speed_torque_curve": True, "dc_link_voltage": 200.0, "supply_resistance": 10.0,
}
CONDITIONS = (NOMINAL, *CHANGED, WEAK_SUPPLY)
TROUBLES = {  # in sentences: conditions
    "A resonance that is off by 20 %": ("frequency −20 %", "frequency +20 %"),
    "Half or twice the friction": ("friction ×0.5", "friction ×2"),
    "A weak supply": (WEAK_SUPPLY,),
}
CHANGED_PAYLOAD = 5.0  # kg
SPRING = "spring_load"  # the axis of the task with a swinging load
INFORMED = "informed_"  # prefix of strategies that do not compete
TOLERANCE = 50e-6  # m
NEAREST, FARTHEST = 0.001, 0.35  # m, far beyond the tolerance, and within the stroke
NOTED = 1e-3  # s, the least difference of a settling time that is worth a sentence
FIGURES = {  # name in the CSV: metric
    "settling_s": "settling_time",
    "overshoot_um": "overshoot",
    "peak_following_error_um": "peak_error",
    "residual_vibration_um": "vibration",
    "rms_jerk_m_s3": "rms_jerk",
    "rms_torque_share_of_rated": "rms_torque",
    "peak_torque_share_of_rated": "peak_torque",
    "energy_J": "energy",
    "at_a_limit": "limited",
    "fault": "faults",
}
# of the motor's continuous torque (rms, squared), if the move is repeated as soon as it has settled
DUTY = "i2t_duty"
SHOWN = (
    "settling_s", "overshoot_um", "residual_vibration_um", "peak_torque_share_of_rated",
    "rms_torque_share_of_rated", DUTY, "rms_jerk_m_s3", "energy_J",
)

Key = tuple[str, float, str, str]  # axis, payload (kg), condition, strategy
Means = Mapping[Key, Mapping[str, float]]  # of the figures, over the moves of a cell


class Moves:
    """A cell: the moves of one strategy on one axis in one condition.

    Raises ValueError where the strategy does not suit: no spring to shape for, not enough torque.
    """

    def __init__(
        self, drive: str, key: Key, ways: Sequence[tuple[float, float]],
        parameter_file: str | None,
    ):
        mechanics, payload, condition, strategy = key
        self._key, self._ways = key, ways
        options = [{"start": start, "goal": goal} for start, goal in ways]
        task: type[ServoEnv] = SWINGING_LOAD if mechanics == SPRING else POINT_TO_POINT
        axis = SWINGING_LOAD().datasheet if mechanics == SPRING else FAMILY[mechanics]
        weak: dict[str, Any] = WEAK if condition == WEAK_SUPPLY else {}
        setup = Setup(
            task, drive,
            {
                "parameters": replace(axis, payload=payload, **weak), "tolerance": TOLERANCE,
                "tuned": True, "randomise": CHANGED.get(condition, {}),
            },
            parameter_file=parameter_file,
        )
        self._episodes = Episodes(setup, strategy, fixed(0, len(ways)), options=options)
        self.jobs = self._episodes.jobs

    def results(self, found: Sequence[Result]) -> list[Row]:
        """Return one row per move."""
        values, longest = self._episodes.results(found).values, self._episodes.duration
        mechanics, payload, condition, strategy = self._key
        return [
            {
                "strategy": strategy, "mechanics": mechanics, "payload_kg": payload,
                "condition": condition, "start_m": start, "goal_m": goal,
                "settled": int(values["settling_time"][i] < longest),
                **{name: round(float(values[metric][i]), 6) for name, metric in FIGURES.items()},
                DUTY: _duty(values, i, longest),
            }
            for i, (start, goal) in enumerate(self._ways)
        ]


def _duty(values: Mapping[str, np.ndarray], i: int, longest: float) -> float:
    """I²t of a move over the rated torque's, until it has settled; at rest the motor holds on."""
    share = float(values["rms_torque"][i]) ** 2 * longest
    return round(share / float(values["settling_time"][i]), 6)


def cells(
    drive: str, quick: bool, strategies: Sequence[str] = (), mechanics: Sequence[str] = (),
    payloads: Sequence[float] = (), distances: Sequence[float] = (),
    parameter_file: Path | None = None,
) -> Grid[Key, list[Row]]:
    """Return a cell for each axis, strategy and condition. Raises ValueError as the task does."""
    file = str(parameter_file) if parameter_file else None
    Setup(POINT_TO_POINT, drive, parameter_file=file).make().close()
    for asked in strategies:
        if asked.partition(":")[0].endswith(SUFFIX):
            from_file(asked)  # refused at once, not by one axis after the other
    known_mechanics(mechanics, (SPRING,))
    for distance in distances:
        if not NEAREST <= distance <= FARTHEST:
            raise ValueError(f"--distance = {distance:g} m: {NEAREST:g}..{FARTHEST:g} m will do")
    ways = [
        (start, start + (distance if start < 0.25 else -distance))
        for distance in distances or (QUICK_DISTANCES if quick else DISTANCES)
        for start in STARTS
    ]
    conditions = [NOMINAL] if quick else CONDITIONS
    grid = Grid[Key, list[Row]]()
    for key in (
        (name, payload, condition, strategy)
        for name in mechanics or (QUICK_FAMILY if quick else (*FAMILY, SPRING))
        for payload in payloads or (QUICK_PAYLOADS if quick else PAYLOADS)
        for condition in conditions  # of each its strategies: they play in the same environments
        if condition == NOMINAL or payload == CHANGED_PAYLOAD or payloads
        for strategy in dict.fromkeys((*STRATEGIES, *strategies))
    ):
        with grid.tried(key):
            try:
                grid.cells[key] = Moves(drive, key, ways, file)
            except ValueError as error:
                raise ValueError(f"{key[0]}, {key[1]:g} kg: {error}") from None
    for asked in strategies:
        if not any(strategy == asked for *_, strategy in grid.cells):
            raise ValueError(next(why for key, why in grid.gaps.items() if key[-1] == asked))
    return grid


def sentences(means: Means) -> list[str]:
    """Sum up the table in sentences, with the numbers that support them."""
    said = []
    strategies = list(dict.fromkeys(strategy for *_, strategy in means))
    plants = list(dict.fromkeys((mechanics, payload) for mechanics, payload, *_ in means))
    rivals = [s for s in strategies if not s.startswith(INFORMED)]

    def of(name: str, *key: Any) -> float:
        return means.get(key, {}).get(name, math.nan)

    for mechanics, payload in plants:
        times = {s: of("settling_s", mechanics, payload, NOMINAL, s) for s in rivals}
        times = {s: t for s, t in times.items() if math.isfinite(t)}
        if len(times) < 2:
            continue
        best, plain = min(times, key=lambda s: times[s]), times.get("jerk_limited", math.nan)
        text = f"On {mechanics} with {payload:g} kg `{best}` settles first, in {times[best]:.3f} s"
        if best != "jerk_limited" and math.isfinite(plain):
            text += (
                f", {100 * (1 - times[best] / plain):.0f} % sooner than the drive's own "
                f"jerk-limited profile ({plain:.3f} s)"
            )
        torque = of("rms_torque_share_of_rated", mechanics, payload, NOMINAL, best)
        duty = of(DUTY, mechanics, payload, NOMINAL, best)
        said.append(
            f"{text}; it takes {100 * torque:.0f} % of the rated torque (rms, over the episode). "
            f"Repeated without a pause, it uses {100 * duty:.0f} % of the motor's continuous rating"
            + (
                f": the motor has to rest {_rest(duty, times[best]):.2f} s after each move."
                if duty > 1
                else "."
            )
        )
    for mechanics, payload in plants:
        for what, conditions in TROUBLES.items():
            costs = {}
            for s in rivals:
                here, *there = (
                    of("settling_s", mechanics, payload, c, s) for c in (NOMINAL, *conditions)
                )
                settles = of("settled", mechanics, payload, NOMINAL, s) == 1.0
                if settles and np.all(np.isfinite([*there, here])):
                    costs[s] = max(there) - here
            if len(costs) > 1 and max(costs.values()) >= NOTED:
                calm, touchy = (
                    min(costs, key=lambda s: costs[s]),
                    max(costs, key=lambda s: costs[s]),
                )
                said.append(
                    f"{what} costs `{touchy}` on {mechanics} with {payload:g} kg up to "
                    f"{round(1e3 * costs[touchy])} ms, and `{calm}` {round(1e3 * costs[calm])} ms."
                )
    return said


def _rest(duty: float, settling: float) -> float:
    """Return how long a motor must stand still after a move (s)."""
    return (duty - 1.0) * settling


def report(found: Mapping[Key, list[Row]]) -> Report:
    """Prepare page and picture from the moves of each cell."""
    means = {
        key: {name: float(np.mean([row[name] for row in rows])) for name in (*SHOWN, "settled")}
        for key, rows in found.items()
    }
    strategies = list(dict.fromkeys(strategy for *_, strategy in found))
    axes = list(dict.fromkeys(key[:3] for key in found))
    columns = [
        f"{m}, {p:g} kg" + ("" if condition == NOMINAL else f", {condition}")
        for m, p, condition in axes
    ]
    late = {key: sum(not row["settled"] for row in rows) for key, rows in found.items()}
    table = [
        [column, s, *(number(means[*axis, s][name]) for name in SHOWN), str(late[*axis, s])]
        for axis, column in zip(axes, columns, strict=True)
        for s in strategies
        if (*axis, s) in found and np.isfinite(means[*axis, s]["settling_s"])
    ]
    heading = [
        "axis", "strategy", "settling (s)", "overshoot (µm)", "residual vibration (µm)",
        "peak torque / rated", "rms torque / rated", "I²t duty", "rms jerk (m/s³)", "energy (J)",
        "not settled",
    ]
    rows = [row for own in found.values() for row in own]
    ways = sorted({round(1e3 * abs(row["goal_m"] - row["start_m"])) for row in rows})
    notes = (
        f"Values are means over moves of {', '.join(map(str, ways))} mm in both directions, on "
        "axes as commissioned. The settling time ends when the carriage stays within "
        f"±{1e6 * TOLERANCE:g} µm; if it does not settle within an episode (1 s, {SPRING} 2 s), "
        "the whole episode counts. The I²t duty is the mean square of the torque over that of the "
        "rated torque if the move is repeated as soon as it has settled; above 1 the motor has to "
        "rest in between. The residual vibration is half the peak-to-peak elastic deflection in "
        "the last quarter of the episode, when only the resonance moves the load. `informed_` "
        "strategies are given the drawn parameters; "
        "`learned` was trained on the softer loops of the environments of version 0. "
        f"*{WEAK_SUPPLY.capitalize()}* means a winding on a DC link of 200 V behind 10 Ohm, with a "
        "profile that it can follow. Strategies without a row do not suit the axis."
    )

    def panel(name: str) -> np.ndarray:
        return np.array(
            [[means.get((*axis, s), {}).get(name, np.nan) for s in strategies] for axis in axes]
        )

    failures = np.array([[late.get((*axis, s), 0) for s in strategies] for axis in axes])
    swing = panel("residual_vibration_um")

    def why(name: str, k: int, i: int) -> str:
        said = f"it oscillates by {number(swing[k, i])} µm afterwards"
        return said + (f", and {failures[k, i]} moves did not settle" if failures[k, i] else "")

    panels = {
        "settling (s)": panel("settling_s"), "overshoot (µm)": panel("overshoot_um"),
        "rms torque / rated": panel("rms_torque_share_of_rated"),
    }
    return Report(
        heading, table, notes, sentences(means), columns, strategies, panels, failures, why,
        f"{len(rows)} moves",
    )


POSITIONING = Benchmark(
    "positioning", "Positioning", "positioning strategies", cells, report,
    lambda drive, jobs: [warm(Setup.of(POINT_TO_POINT, drive))],
)
