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
from rich.console import Console

from ...envs import FAMILY, POINT_TO_POINT
from ..pictures.heat_map import draw
from ..report import markdown, number, write_csv, write_page
from ..scale.job import Job, Result
from ..scale.work import ALONE, Work
from .episodes import Evaluator
from .homing import made_by
from .parts import warm

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

Row = dict[str, Any]


def moves(
    drive: str, mechanics: str, payload: float, strategy: str, ways: Any, condition: str,
    parameter_file: str | None,
) -> Result:  # fmt: skip
    """The job: one strategy on one axis in one condition; no rows where it does not suit."""
    try:
        evaluator = Evaluator(
            POINT_TO_POINT.ID, drive=drive, episodes=len(ways), traced=None,
            options=[{"start": start, "goal": goal} for start, goal in ways],
            parameters=replace(FAMILY[mechanics], payload=payload), tolerance=TOLERANCE,
            tuned=True, randomise=CHANGED.get(condition),
        )  # fmt: skip
    except ValueError as error:
        return {"rows": [], "refused": f"{mechanics}, {payload:g} kg: {error}"}
    try:
        if parameter_file is not None:
            for env in evaluator.vector.envs:
                env.machine.drives["x"].use_parameter_file(parameter_file)
        found = evaluator.run(strategy)
    except ValueError as error:  # no spring to shape for, or not enough torque
        return {"rows": [], "refused": f"{strategy} on {mechanics}, {payload:g} kg: {error}"}
    finally:
        evaluator.close()
    rows = [
        {
            "strategy": strategy, "mechanics": mechanics, "payload_kg": payload,
            "condition": condition, "start_m": start, "goal_m": goal,
            "settled": int(found.values["settling_time"][i] < evaluator.duration),
            **{
                name: round(float(found.values[metric][i]), 6)
                for name, metric in FIGURES.items()
            },
        }
        for i, (start, goal) in enumerate(ways)
    ]  # fmt: skip
    return {"rows": rows, "refused": ""}


def jobs(
    drive: str, quick: bool, strategies: Sequence[str] = (), mechanics: Sequence[str] = (),
    payloads: Sequence[float] = (), distances: Sequence[float] = (),
    parameter_file: Path | None = None,
) -> list[Job]:  # fmt: skip
    """One for each axis, strategy and condition. Raises ValueError as the environment does."""
    POINT_TO_POINT(drive=drive).close()
    for name in mechanics:
        if name not in FAMILY:
            raise ValueError(f"--mechanics = {name!r}: choose of {', '.join(FAMILY)}")
    ways = [
        (start, start + (distance if start < 0.25 else -distance))
        for distance in distances or (QUICK_DISTANCES if quick else DISTANCES)
        for start in STARTS
    ]
    for start, goal in ways:
        if not 0.0 <= goal <= 0.5:
            raise ValueError(f"--distance = {abs(goal - start):g} m: 0.35 m at most")
    plants = [
        (name, payload)
        for name in mechanics or (QUICK_FAMILY if quick else FAMILY)
        for payload in payloads or (QUICK_PAYLOADS if quick else PAYLOADS)
    ]
    file = str(parameter_file) if parameter_file else None
    conditions = [NOMINAL] if quick else [NOMINAL, *CHANGED]
    return [
        Job(
            f"{strategy} on {name}, {payload:g} kg, {condition}", moves,
            {"drive": drive, "mechanics": name, "payload": payload, "strategy": strategy,
             "ways": ways, "condition": condition, "parameter_file": file},
            (drive,),
        )
        for name, payload in plants
        for strategy in dict.fromkeys((*STRATEGIES, *strategies))
        for condition in conditions
        if condition == NOMINAL or payload == CHANGED_PAYLOAD or payloads
    ]  # fmt: skip


def mean(rows: Sequence[Row], name: str, **of: Any) -> float:
    """Of a figure over the rows that are of it; not a number without any."""
    found = [row[name] for row in rows if all(row[key] == value for key, value in of.items())]
    return float(np.mean(found)) if found else math.nan


def sentences(rows: Sequence[Row]) -> list[str]:
    """What the table says, with the numbers that carry it."""
    told = []
    strategies = list(dict.fromkeys(row["strategy"] for row in rows))
    plants = list(dict.fromkeys((row["mechanics"], row["payload_kg"]) for row in rows))
    rivals = [s for s in strategies if s != INFORMED]
    for mechanics, payload in plants:
        of = {"mechanics": mechanics, "payload_kg": payload, "condition": NOMINAL}
        times = {s: mean(rows, "settling_s", strategy=s, **of) for s in rivals}
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
        torque = mean(rows, "rms_torque_share_of_rated", strategy=best, **of)
        told.append(
            f"{text}; it takes {100 * torque:.0f} % of the rated torque (rms), which heats the "
            f"motor by {100 * torque**2:.0f} % of what it bears."
        )
    for mechanics in dict.fromkeys(name for name, _ in plants):
        worst = {}
        for s in rivals:
            of = {"mechanics": mechanics, "payload_kg": CHANGED_PAYLOAD, "strategy": s}
            there = [
                mean(rows, "settling_s", condition=c, **of) for c in CHANGED if c[:9] == "frequency"
            ]
            here = mean(rows, "settling_s", condition=NOMINAL, **of)
            if there and np.all(np.isfinite([*there, here])):
                worst[s] = max(there) - here
        if worst and mechanics not in ("rigid", "linear_motor"):
            calm, touchy = min(worst, key=lambda s: worst[s]), max(worst, key=lambda s: worst[s])
            told.append(
                f"A resonance that is off by 20 % costs `{touchy}` on {mechanics} up to "
                f"{1e3 * worst[touchy]:.0f} ms, `{calm}` {1e3 * worst[calm]:.0f} ms."
            )
    return told


def run(
    drive: str, quick: bool, out: Path, console: Console, work: Work = ALONE,
    chosen: Mapping[str, Any] | None = None,
) -> int:  # fmt: skip
    """Measure, and write positioning.csv, .md and .png to `out`; -> exit status.

    Args:
        drive: drive model.
        quick: a small part.
        out: folder.
        console: where to tell how far it is.
        work: who does the jobs.
        chosen: further arguments of `jobs`.
    """
    todo = jobs(drive, quick, **(chosen or {}))
    results = work.map(todo, folder=out, console=console, warm=[warm(POINT_TO_POINT.ID, drive)])
    rows: list[Row] = [row for result in results for row in result["rows"]]
    if not rows:
        raise ValueError(next(result["refused"] for result in results if result["refused"]))
    source = made_by("positioning", drive, quick, chosen or {})
    strategies = list(dict.fromkeys(row["strategy"] for row in rows))
    cells = list(
        dict.fromkeys((row["mechanics"], row["payload_kg"], row["condition"]) for row in rows)
    )
    columns = [
        f"{m}, {p:g} kg" + ("" if condition == NOMINAL else f", {condition}")
        for m, p, condition in cells
    ]
    shape = len(strategies), len(cells)
    means = {name: np.full(shape, np.nan) for name in SHOWN}
    failures = np.zeros(shape, int)
    for i, strategy in enumerate(strategies):
        for k, (mechanics, payload, condition) in enumerate(cells):
            of = {"strategy": strategy, "mechanics": mechanics, "payload_kg": payload,
                  "condition": condition}  # fmt: skip
            failures[i, k] = sum(
                not row["settled"] for row in rows if all(row[x] == y for x, y in of.items())
            )
            for name in SHOWN:
                means[name][i, k] = mean(rows, name, **of)
    table = [
        [columns[k], strategy, *(number(means[name][i, k]) for name in SHOWN), str(failures[i, k])]
        for k in range(len(cells))
        for i, strategy in enumerate(strategies)
        if np.isfinite(means["settling_s"][i, k])
    ]
    heading = [
        "axis", "strategy", "settling (s)", "overshoot (µm)", "residual vibration (µm)",
        "peak torque / rated", "rms torque / rated", "rms jerk (m/s³)", "energy (J)", "not settled",
    ]  # fmt: skip
    ways = sorted({round(1e3 * abs(row["goal_m"] - row["start_m"])) for row in rows})
    notes = (
        f"Means over moves of {', '.join(map(str, ways))} mm, in both directions, on axes as they "
        "are commissioned. Settling: the carriage stays within "
        f"±{1e6 * TOLERANCE:g} µm; where it does not within the second of an episode, 1 s counts. "
        "Residual vibration: half the span of what is elastic in the last quarter of the episode, "
        "where nothing but its resonance moves it. `informed_ruckig` is told what was drawn. "
        "Strategies without a row do not suit the axis.\n\n"
    ) + "\n".join(f"- {sentence}" for sentence in sentences(rows))
    write_csv(out / "positioning.csv", source, rows)
    title = f"Positioning, drive {drive}"
    write_page(out / "positioning.md", title, markdown(heading, table), source, notes)
    panels = {
        "settling (s)": means["settling_s"].T,
        "overshoot (µm)": means["overshoot_um"].T,
        "rms torque / rated": means["rms_torque_share_of_rated"].T,
    }
    path = out / "positioning.png"

    def why(panel: str, k: int, i: int) -> str:
        swing, late = means["residual_vibration_um"][i, k], failures[i, k]
        said = f"it swings by {number(swing)} µm afterwards"
        return said + (f", and {late} moves did not settle" if late else "")

    title = f"positioning strategies, drive {drive}"
    draw(path, title, columns, strategies, panels, failures.T, why)
    console.print(f"{len(rows)} moves; {out / 'positioning'}.csv, .md, .png")
    work.clear(todo, out)
    return 0
