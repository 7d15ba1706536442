"""`servogym benchmark homing`: every homing method of a drive on every axis of the family.

Each method searches from several starts, with the switches answering elsewhere each time as far as
the mechanics let them. Repeatability is three standard deviations of the errors over the starts.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ...drive.kernel.homing import HERE
from ...drive.model.model import load
from ...envs import FAMILY, Machine, linear_axis
from ...envs.masters.homing_figures import built_in
from ..pictures.heat_map import draw
from ..pictures.homing_gallery import fit_home_switch, home_switch
from ..report import markdown, number, origin, write_csv, write_page
from ..scale.job import Job, Result
from ..scale.work import ALONE, Work

STARTS = (0.033, 0.127, 0.217, 0.364, 0.473)  # m, none on an index pulse, one on the home switch
QUICK_STARTS = (0.033, 0.217)
QUICK_METHODS = (1, 17, 23, -17)
QUICK_FAMILY = ("rigid", "ball_screw")
ON_A_STOP = (-1, -2, -17, -18)
STOP_SPEED = 50_000  # µm/s, all the way to a stop
TIMEOUT = 20.0  # s
SEED = 1  # of where the switches answer

Row = dict[str, Any]


def searches(
    drive: str, mechanics: str, method: int, starts: Sequence[float], seeds: Sequence[int]
) -> Result:
    """The job: one method on one axis, from every start."""
    machine = linear_axis(load(drive), mechanics=mechanics)
    fit_home_switch(machine, method, home_switch(machine))
    rows = []
    for start, seed in zip(starts, seeds, strict=True):
        machine.mechanics["switch_seed"] = seed
        rows.append({"mechanics": mechanics, **_run(machine, method, start)})
    return {"rows": rows}


def jobs(drive: str, quick: bool) -> list[Job]:
    """One for each axis and method. Raises ValueError for a drive without such methods."""
    model = load(drive)
    methods = [method for method in model.homing_methods if method not in HERE]
    if quick:
        methods = [method for method in methods if method in QUICK_METHODS]
    if not methods:
        raise ValueError(f"drive {model.name!r} has no homing method that searches")
    generator = np.random.default_rng(SEED)
    starts = QUICK_STARTS if quick else STARTS
    return [
        Job(
            f"method {method} on {mechanics}", searches,
            {"drive": drive, "mechanics": mechanics, "method": method, "starts": starts,
             "seeds": [int(generator.integers(1, 2**63)) for _ in starts]},
            (drive,),
        )
        for mechanics in (QUICK_FAMILY if quick else FAMILY)
        for method in methods
    ]  # fmt: skip


def _run(machine: Machine, method: int, start: float) -> Row:
    objects = {"speed_during_search_for_zero": STOP_SPEED} if method in ON_A_STOP else {}
    row: Row = {"method": method, "start_m": start}
    try:
        figures = built_in(machine, method, start, timeout=TIMEOUT, objects=objects)
    except (RuntimeError, TimeoutError) as error:
        return row | {
            "attained": 0, "time_s": None, "error_um": None, "peak_torque_share": None,
            "impact_J": None, "index_near": None, "failure": str(error),
        }  # fmt: skip
    return row | {
        "attained": int(figures.attained),
        "time_s": round(figures.time, 6),
        "error_um": round(1e6 * figures.error, 3) if figures.attained else None,
        "peak_torque_share": round(figures.greatest_torque, 4),
        "impact_J": round(figures.impact_energy, 6),
        "index_near": int(figures.index_near),
        "failure": "" if figures.attained else f"no reference after {figures.time:g} s",
    }


def _of(rows: list[Row], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows if row["attained"]], float)


def repeatability(errors: np.ndarray) -> float:
    """Three standard deviations; not a number for fewer than two."""
    return float(3.0 * errors.std(ddof=1)) if len(errors) > 1 else np.nan


def run(drive: str, quick: bool, out: Path, console: Console, work: Work = ALONE) -> int:
    """Measure, and write homing.csv, homing.md and homing.png to `out`; -> exit status."""
    todo = jobs(drive, quick)
    results = work.map(todo, folder=out, console=console, warm=todo[:1])
    rows: list[Row] = [row for result in results for row in result["rows"]]
    source = origin(f"servogym benchmark homing --drive {drive}{' --quick' if quick else ''}")
    methods = list(dict.fromkeys(row["method"] for row in rows))
    family = list(dict.fromkeys(row["mechanics"] for row in rows))
    shape = len(methods), len(family)
    time, spread, bias, impact = (np.full(shape, np.nan) for _ in range(4))
    failures, near = np.zeros(shape, int), np.zeros(shape, int)
    for i, method in enumerate(methods):
        for k, mechanics in enumerate(family):
            runs = [r for r in rows if (r["method"], r["mechanics"]) == (method, mechanics)]
            errors = _of(runs, "error_um")
            failures[i, k] = len(runs) - len(errors)
            near[i, k] = sum(bool(r["index_near"]) for r in runs)
            spread[i, k] = repeatability(errors)
            if len(errors):
                bias[i, k] = errors[np.abs(errors).argmax()]
                time[i, k] = _of(runs, "time_s").mean()
                impact[i, k] = _of(runs, "impact_J").max()
    table = [
        [
            str(method), mechanics, number(time[i, k]), number(bias[i, k]), number(spread[i, k]),
            number(impact[i, k]), str(failures[i, k]), str(near[i, k]),
        ]
        for i, method in enumerate(methods)
        for k, mechanics in enumerate(family)
    ]  # fmt: skip
    heading = [
        "method", "axis", "time (s)", "worst error (µm)", "3σ (µm)", "largest impact (J)",
        "failures", "index warnings",
    ]  # fmt: skip
    starts = sorted({row["start_m"] for row in rows})
    notes = (
        f"From {len(starts)} starts ({', '.join(f'{1e3 * s:g}' for s in starts)} mm): mean time, "
        "error of the largest size, repeatability as three standard deviations, impacts on the end "
        "stops. The error is the home found minus the true edge, index pulse or stop; the drive "
        "sees its motor, so what is elastic in between counts. Index warnings: runs in which the "
        "drive found the index pulse so near to the edge that home may jump by a turn (warning "
        "FF10h of `generic`); then the switch belongs half a pitch farther."
    )
    write_csv(out / "homing.csv", source, rows)
    write_page(out / "homing.md", f"Homing, drive {drive}", markdown(heading, table), source, notes)
    panels = {"time (s)": time, "3σ (µm)": spread, "largest impact (J)": impact}

    def why(panel: str, i: int, k: int) -> str:
        if panel == "3σ (µm)" and near[i, k]:
            return "the index pulse lies near the edge, so home may jump by a turn (index warning)"
        if failures[i, k]:
            some = next(r for r in rows if r["failure"]
                        and (r["method"], r["mechanics"]) == (methods[i], family[k]))  # fmt: skip
            return str(some["failure"])
        if methods[i] in ON_A_STOP:
            return "it pushes against the stop, and the transmission gives way"
        if panel == "time (s)":
            return "all the way at the slower speed"
        return f"worst error {number(bias[i, k])} µm; what is elastic or plays lies in between"

    title = f"homing methods, drive {drive}"
    draw(out / "homing.png", title, methods, family, panels, failures, why)
    done = sum(row["attained"] for row in rows)
    console.print(f"{done} of {len(rows)} runs found a reference; {out / 'homing'}.csv, .md, .png")
    work.clear(todo, out)
    return 0
