"""`servogym benchmark positioning`: ways to move from point to point, on tuned axes.

LinearAxis-v0 with fixed moves, its axes commissioned as `linear_axis` does (``tuned=True``). The
settling time is of the carriage itself, with what is elastic between it and the motor. Each
strategy moves each payload as it was planned for; and one payload with half and twice the friction,
and with a resonance 20 % lower and higher than it was planned for.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...envs import FAMILY, POINT_TO_POINT
from ..report import number
from ..scale.job import Result
from ..setup import Setup
from .benchmark import Benchmark, Row, Told, known_mechanics
from .episodes import fixed
from .grid import Grid
from .parts import Episodes, warm

STRATEGIES = (
    "trapezoid", "jerk_limited", "s_curve", "ruckig", "ruckig+zv", "ruckig+zvd", "ruckig+ei",
    "ruckig+notch", "proportional", "learned", "informed_ruckig",
)  # fmt: skip
PAYLOADS = (1.0, 5.0, 20.0)  # kg
DISTANCES = (0.01, 0.05, 0.2)  # m
STARTS = (0.15, 0.35)  # m; the move goes to the side that has room
QUICK_FAMILY, QUICK_PAYLOADS, QUICK_DISTANCES = ("rigid", "toothed_belt"), (5.0,), (0.01,)
NOMINAL = "nominal"
CHANGED: dict[str, dict[str, float]] = {  # what the strategy was not told
    "friction ×0.5": {"friction": 0.5},
    "friction ×2": {"friction": 2.0},
    "frequency −20 %": {"stiffness": 0.64},
    "frequency +20 %": {"stiffness": 1.44},
}
CHANGED_PAYLOAD = 5.0  # kg
INFORMED = "informed_ruckig"  # no rival
TOLERANCE = 50e-6  # m
FIGURES = {  # name in the CSV: metric
    "settling_s": "settling_time",
    "overshoot_um": "overshoot",
    "peak_following_error_um": "peak_error",
    "residual_vibration_um": "vibration",
    "rms_jerk_m_s3": "rms_jerk",
    "rms_torque_share_of_rated": "rms_torque",
    "peak_torque_share_of_rated": "peak_torque",
    "energy_J": "energy",
    "fault": "faults",
}
SHOWN = (
    "settling_s", "overshoot_um", "residual_vibration_um", "peak_torque_share_of_rated",
    "rms_torque_share_of_rated", "rms_jerk_m_s3", "energy_J",
)  # fmt: skip

Key = tuple[str, float, str, str]  # axis, payload (kg), condition, strategy
Means = Mapping[Key, Mapping[str, float]]  # of the figures, over the moves of a cell


class Moves:
    """A cell: the moves of one strategy on one axis in one condition.

    Raises ValueError where the strategy does not suit: no spring to shape for, not enough torque.
    """

    def __init__(
        self, drive: str, key: Key, ways: Sequence[tuple[float, float]],
        parameter_file: Path | None,
    ):  # fmt: skip
        mechanics, payload, condition, strategy = key
        self._key, self._ways = key, ways
        options = [{"start": start, "goal": goal} for start, goal in ways]
        setup = Setup(
            POINT_TO_POINT, drive,
            {
                "parameters": replace(FAMILY[mechanics], payload=payload), "tolerance": TOLERANCE,
                "tuned": True, "randomise": CHANGED.get(condition),
            },
            parameter_file=str(parameter_file) if parameter_file else None,
        )  # fmt: skip
        self._episodes = Episodes(setup, strategy, fixed(0, len(ways)), options=options)
        self.jobs = self._episodes.jobs

    def results(self, found: Sequence[Result]) -> list[Row]:
        """A row a move."""
        values, longest = self._episodes.results(found).values, self._episodes.duration
        mechanics, payload, condition, strategy = self._key
        return [
            {
                "strategy": strategy, "mechanics": mechanics, "payload_kg": payload,
                "condition": condition, "start_m": start, "goal_m": goal,
                "settled": int(values["settling_time"][i] < longest),
                **{name: round(float(values[metric][i]), 6) for name, metric in FIGURES.items()},
            }
            for i, (start, goal) in enumerate(self._ways)
        ]  # fmt: skip


def cells(
    drive: str, quick: bool, strategies: Sequence[str] = (), mechanics: Sequence[str] = (),
    payloads: Sequence[float] = (), distances: Sequence[float] = (),
    parameter_file: Path | None = None,
) -> Grid[Key, list[Row]]:  # fmt: skip
    """One for each axis, strategy and condition. Raises ValueError as the environment does."""
    POINT_TO_POINT(drive=drive).close()
    known_mechanics(mechanics)
    ways = [
        (start, start + (distance if start < 0.25 else -distance))
        for distance in distances or (QUICK_DISTANCES if quick else DISTANCES)
        for start in STARTS
    ]
    for start, goal in ways:
        if not 0.0 <= goal <= 0.5:
            raise ValueError(f"--distance = {abs(goal - start):g} m: 0.35 m at most")
    conditions = [NOMINAL] if quick else [NOMINAL, *CHANGED]
    grid = Grid[Key, list[Row]]()
    for key in (
        (name, payload, condition, strategy)
        for name in mechanics or (QUICK_FAMILY if quick else FAMILY)
        for payload in payloads or (QUICK_PAYLOADS if quick else PAYLOADS)
        for strategy in dict.fromkeys((*STRATEGIES, *strategies))
        for condition in conditions
        if condition == NOMINAL or payload == CHANGED_PAYLOAD or payloads
    ):
        with grid.tried(key):
            try:
                grid.cells[key] = Moves(drive, key, ways, parameter_file)
            except ValueError as error:
                raise ValueError(f"{key[0]}, {key[1]:g} kg: {error}") from None
    return grid


def sentences(means: Means) -> list[str]:
    """What the table says, with the numbers that carry it."""
    told = []
    strategies = list(dict.fromkeys(strategy for *_, strategy in means))
    plants = list(dict.fromkeys((mechanics, payload) for mechanics, payload, *_ in means))
    rivals = [s for s in strategies if s != INFORMED]

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
                f", {100 * (1 - times[best] / plain):.0f} % before the drive's own jerk-limited "
                f"profile ({plain:.3f} s)"
            )
        torque = of("rms_torque_share_of_rated", mechanics, payload, NOMINAL, best)
        told.append(
            f"{text}; it takes {100 * torque:.0f} % of the rated torque (rms), which heats the "
            f"motor by {100 * torque**2:.0f} % of what it bears."
        )
    for mechanics in dict.fromkeys(name for name, _ in plants):
        worst = {}
        for s in rivals:
            here, *there = (
                of("settling_s", mechanics, CHANGED_PAYLOAD, c, s)
                for c in (NOMINAL, *CHANGED) if c == NOMINAL or c[:9] == "frequency"
            )  # fmt: skip
            if np.all(np.isfinite([*there, here])):
                worst[s] = max(there) - here
        if worst and mechanics not in ("rigid", "linear_motor"):
            calm, touchy = min(worst, key=lambda s: worst[s]), max(worst, key=lambda s: worst[s])
            told.append(
                f"A resonance that is off by 20 % costs `{touchy}` on {mechanics} up to "
                f"{1e3 * worst[touchy]:.0f} ms, `{calm}` {1e3 * worst[calm]:.0f} ms."
            )
    return told


def told(found: Mapping[Key, list[Row]]) -> Told:
    """What a page and a picture tell of the moves of each cell."""
    means = {
        key: {name: float(np.mean([row[name] for row in rows])) for name in SHOWN}
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
        "peak torque / rated", "rms torque / rated", "rms jerk (m/s³)", "energy (J)", "not settled",
    ]  # fmt: skip
    rows = [row for own in found.values() for row in own]
    ways = sorted({round(1e3 * abs(row["goal_m"] - row["start_m"])) for row in rows})
    notes = (
        f"Means over moves of {', '.join(map(str, ways))} mm, in both directions, on axes as they "
        "are commissioned. Settling: the carriage stays within "
        f"±{1e6 * TOLERANCE:g} µm; where it does not within the second of an episode, 1 s counts. "
        "Residual vibration: half the span of what is elastic in the last quarter of the episode, "
        "where nothing but its resonance moves it. `informed_ruckig` is told what was drawn. "
        "Strategies without a row do not suit the axis."
    )

    def panel(name: str) -> np.ndarray:
        return np.array(
            [[means.get((*axis, s), {}).get(name, np.nan) for s in strategies] for axis in axes]
        )

    failures = np.array([[late.get((*axis, s), 0) for s in strategies] for axis in axes])
    swing = panel("residual_vibration_um")

    def why(name: str, k: int, i: int) -> str:
        said = f"it swings by {number(swing[k, i])} µm afterwards"
        return said + (f", and {failures[k, i]} moves did not settle" if failures[k, i] else "")

    panels = {
        "settling (s)": panel("settling_s"), "overshoot (µm)": panel("overshoot_um"),
        "rms torque / rated": panel("rms_torque_share_of_rated"),
    }  # fmt: skip
    return Told(
        heading, table, notes, sentences(means), columns, strategies, panels, failures, why,
        f"{len(rows)} moves",
    )  # fmt: skip


POSITIONING = Benchmark(
    "positioning", "Positioning", "positioning strategies", cells, told,
    lambda drive, jobs: [warm(Setup.of(POINT_TO_POINT, drive))],
)  # fmt: skip
