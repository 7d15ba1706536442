"""`servogym benchmark positioning`: ways to move from point to point, on every axis of the family.

LinearAxis-v0 with fixed moves. The settling time is of the carriage itself, with what is elastic
between it and the motor; the profiles are those of `servogym.training.policies.profiles`.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ...envs import FAMILY, POINT_TO_POINT
from ..pictures.heat_map import draw
from ..report import markdown, number, origin, write_csv, write_page
from ..scale.job import Job, Result
from ..scale.work import ALONE, Work
from .episodes import Evaluator
from .parts import warm

STRATEGIES = ("trapezoid", "jerk_limited", "ruckig", "ruckig+zv", "ruckig+zvd")
PAYLOADS = (1.0, 5.0, 20.0)  # kg
MOVES = ((0.2, 0.21), (0.3, 0.29), (0.1, 0.15), (0.35, 0.3), (0.1, 0.3), (0.4, 0.2))  # m
QUICK_FAMILY, QUICK_PAYLOADS, QUICK_MOVES = ("rigid", "toothed_belt"), (5.0,), MOVES[:2]
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

Row = dict[str, Any]


def moves(drive: str, mechanics: str, payload: float, strategy: str, ways: Any) -> Result:
    """The job: one strategy on one axis; no rows where it does not suit."""
    evaluator = Evaluator(
        POINT_TO_POINT.ID, drive=drive, episodes=len(ways), traced=None,
        options=[{"start": start, "goal": goal} for start, goal in ways],
        parameters=replace(FAMILY[mechanics], payload=payload), tolerance=TOLERANCE,
    )  # fmt: skip
    try:
        found = evaluator.run(strategy)
    except ValueError:
        return {"rows": []}  # no spring to shape for, or not enough torque
    finally:
        evaluator.close()
    rows = [
        {
            "strategy": strategy, "mechanics": mechanics, "payload_kg": payload,
            "start_m": start, "goal_m": goal,
            "settled": int(found.values["settling_time"][i] < evaluator.duration),
            **{
                name: round(float(found.values[metric][i]), 6)
                for name, metric in FIGURES.items()
            },
        }
        for i, (start, goal) in enumerate(ways)
    ]  # fmt: skip
    return {"rows": rows}


def jobs(drive: str, quick: bool) -> list[Job]:
    """One for each axis and strategy. Raises ValueError as the environment does."""
    POINT_TO_POINT(drive=drive).close()
    return [
        Job(
            f"{strategy} on {mechanics}, {payload:g} kg", moves,
            {"drive": drive, "mechanics": mechanics, "payload": payload, "strategy": strategy,
             "ways": QUICK_MOVES if quick else MOVES},
            (drive,),
        )
        for mechanics in (QUICK_FAMILY if quick else FAMILY)
        for payload in (QUICK_PAYLOADS if quick else PAYLOADS)
        for strategy in STRATEGIES
    ]  # fmt: skip


def run(drive: str, quick: bool, out: Path, console: Console, work: Work = ALONE) -> int:
    """Measure, and write positioning.csv, .md and .png to `out`; -> exit status."""
    todo = jobs(drive, quick)
    results = work.map(todo, folder=out, console=console, warm=[warm(POINT_TO_POINT.ID, drive)])
    rows: list[Row] = [row for result in results for row in result["rows"]]
    source = origin(f"servogym benchmark positioning --drive {drive}{' --quick' if quick else ''}")
    plants = list(dict.fromkeys((row["mechanics"], row["payload_kg"]) for row in rows))
    columns = [f"{mechanics}, {payload:g} kg" for mechanics, payload in plants]
    means: dict[str, np.ndarray] = {}
    failures = np.zeros((len(STRATEGIES), len(plants)), int)
    shown = ("settling_s", "overshoot_um", "residual_vibration_um", "rms_torque_share_of_rated",
             "energy_J")  # fmt: skip
    for name in shown:
        means[name] = np.full(failures.shape, np.nan)
        for i, strategy in enumerate(STRATEGIES):
            for k, plant in enumerate(plants):
                runs = [
                    row for row in rows
                    if (row["strategy"], row["mechanics"], row["payload_kg"]) == (strategy, *plant)
                ]  # fmt: skip
                failures[i, k] = sum(not row["settled"] for row in runs)
                if runs:
                    means[name][i, k] = np.mean([row[name] for row in runs])
    table = [
        [columns[k], strategy, *(number(means[name][i, k]) for name in shown), str(failures[i, k])]
        for k in range(len(plants))
        for i, strategy in enumerate(STRATEGIES)
        if np.isfinite(means["settling_s"][i, k])
    ]
    heading = [
        "axis", "strategy", "settling (s)", "overshoot (µm)", "residual vibration (µm)",
        "rms torque / rated", "energy (J)", "not settled",
    ]  # fmt: skip
    ways = sorted({round(1e3 * abs(row["goal_m"] - row["start_m"])) for row in rows})
    notes = (
        f"Means over moves of {', '.join(map(str, ways))} mm, there and back. Settling: the "
        f"carriage stays within ±{1e6 * TOLERANCE:g} µm; where it does not within the second of an "
        "episode, 1 s counts. Strategies without a row do not suit the axis."
    )
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
    draw(path, title, columns, STRATEGIES, panels, failures.T, why)
    console.print(f"{len(rows)} moves; {out / 'positioning'}.csv, .md, .png")
    work.clear(todo, out)
    return 0
