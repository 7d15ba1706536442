"""`servogym benchmark homing`: homing methods of a drive on axes, fifty times each.

Runs begin alternately to the left and to the right of the home switch, whose switching point
varies from run to run within the scatter of the mechanics. Repeatability is that of ISO 230-2: R of
the runs from one side (four standard deviations), A of both sides together, each with a bootstrap
interval. Further axes of the table show the effect of a higher approach speed, of a switch that
scatters less or more, of a load and of an inclination.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...drive.kernel.encoder import Event
from ...drive.kernel.homing import HERE
from ...drive.kernel.words import Mode
from ...drive.master import Master, ServoError
from ...drive.model.model import load
from ...envs import FAMILY, Machine, linear_axis
from ...envs.engine.checks import error_line, misfit
from ...envs.masters.homing_figures import FIGURES, built_in, look, prepare, true_home
from ...envs.masters.port import MachinePort
from ..pictures.homing_gallery import fit_home_switch, home_switch
from ..policies.file import from_file
from ..report import number
from ..scale.job import Job, Result
from .benchmark import Benchmark, Report, Row, known_mechanics
from .grid import Grid

RUNS, QUICK_RUNS = 50, 2  # of a cell
SPAN = (0.03, 0.47)  # m, of the starts
DEFAULT_METHODS = (1, 17, 18, 23, 33, -1, -17)  # others with --method
QUICK_METHODS = (1, 17, 23, -17)
QUICK_FAMILY = ("rigid", "ball_screw")
ON_A_STOP = (-1, -2, -17, -18)
STOP_SPEED = 50_000  # µm/s, all the way to a stop
TIMEOUT = 20.0  # s
LONGEST = 120.0  # s of simulated time for a user's method
STRIDE = 40  # position cycles between two checks, so that times are known to 20 ms
SEED = 1  # of starts and switches
RESAMPLED, CONFIDENCE = 1000, 0.95
BESIDE = 23  # the method that is repeated at other speeds, switches, loads and inclinations
BESIDE_ON = ("rigid", "toothed_belt", "ball_screw")  # the axes for it, if none are named
AXES = {  # changed parameters of the axis, and objects (µm/s)
    "as delivered": ({}, {}),
    "approach 20 mm/s": ({}, {"speed_during_search_for_zero": 20_000}),
    "approach 50 mm/s": ({}, {"speed_during_search_for_zero": 50_000}),
    "switch scatter 5 µm": ({"switch_scatter": 5e-6}, {}),
    "switch scatter 60 µm": ({"switch_scatter": 60e-6}, {}),
    "20 kg": ({"payload": 20.0}, {}),
    "inclined 30°": ({"inclination": 30.0, "brake_torque": 4.0}, {}),
}
AS_DELIVERED = "as delivered"
VARIANT = {AS_DELIVERED: ""}  # in the table

Key = tuple[str, int | str, str]  # axis, method, variant


class Searches:
    """A cell: one method on one axis, from every start, in one job."""

    def __init__(self, drive: str, key: Key, **given: Any):
        mechanics, method, variant = key
        self.jobs = [
            Job(f"method {method} on {mechanics}, {variant}", searches,
                {"drive": drive, "mechanics": mechanics, "method": method, "variant": variant,
                 **given}, (drive,))
        ]

    def results(self, found: Sequence[Result]) -> list[Row]:
        """Return one row per run."""
        return [row for result in found for row in result["rows"]]


def searches(
    drive: str, mechanics: str, method: int | str, variant: str, starts: Sequence[float],
    seeds: Sequence[int], payload: float | None, parameter_file: str | None,
) -> Result:
    """Run one method on one axis from every start, as a job."""
    own, objects = AXES[variant]
    values: dict[str, Any] = {**own, **({} if payload is None else {"payload": payload})}
    machine = linear_axis(
        load(drive), parameters=replace(FAMILY[mechanics], **values), parameter_file=parameter_file
    )
    if isinstance(method, int):
        fit_home_switch(machine, method, home_switch(machine))
    rows = []
    for start, seed in zip(starts, seeds, strict=True):
        machine.mechanics["switch_seed"] = seed
        found = _run(machine, method, start, objects)
        rows.append({"mechanics": mechanics, "variant": variant, **found})
    return {"rows": rows}


def cells(
    drive: str, quick: bool, methods: Sequence[int | str] = (), mechanics: Sequence[str] = (),
    payload: float | None = None, parameter_file: Path | None = None, runs: int | None = None,
) -> Grid[Key, list[Row]]:
    """Return a cell for each axis, method and variant. Raises ValueError without searches."""
    model = load(drive)
    known = [method for method in model.homing_methods if method not in HERE]
    if not known:
        raise ValueError(f"drive {model.name!r} has no homing method that searches")
    known_mechanics(mechanics)
    for method in methods:
        if isinstance(method, str):
            own(method, known)
        elif method not in known:
            raise ValueError(f"--method = {method}: drive {model.name!r} has {known}")
    chosen = [m for m in known if m in (QUICK_METHODS if quick else DEFAULT_METHODS)]
    count = runs or (QUICK_RUNS if quick else RUNS)
    generator = np.random.default_rng(SEED)
    places = np.linspace(*SPAN, count) + generator.uniform(-0.004, 0.004, count)
    starts = [round(float(x), 6) for x in places]
    file = str(parameter_file) if parameter_file else None
    family = mechanics or (QUICK_FAMILY if quick else FAMILY)
    keys: list[Key] = [(name, m, AS_DELIVERED) for name in family for m in (*methods, *chosen)]
    if not quick and BESIDE in known:
        keys += [
            (name, BESIDE, variant)
            for name in mechanics or BESIDE_ON
            for variant in AXES
            if variant != AS_DELIVERED
            and not (name == "vertical" and variant.startswith("inclined"))
        ]
    grid = Grid[Key, list[Row]]()
    for key in dict.fromkeys(keys):
        seeds = [int(generator.integers(1, 2**63)) for _ in starts]
        grid.cells[key] = Searches(
            drive, key, starts=starts, seeds=seeds, payload=payload, parameter_file=file
        )
    return grid


def _run(machine: Machine, method: int | str, start: float, objects: Mapping[str, float]) -> Row:
    given = {name: round(value) for name, value in objects.items()}
    if method in ON_A_STOP:
        given |= {"speed_during_search_for_zero": STOP_SPEED}
    row: Row = {"method": str(method), "start_m": start}
    od, distance = machine.axes["od"], [0.0]

    def watch(time: float) -> None:
        distance[0] = float(od["homing_index_distance"][0]) / 1000

    try:
        if isinstance(method, str):
            return row | _own(machine, method, start)
        figures = built_in(
            machine, method, start, timeout=TIMEOUT, objects=given, stride=STRIDE, observer=watch
        )
    except (RuntimeError, TimeoutError) as error:
        return row | FAILED | {"failure": str(error)}
    found = machine.drives["x"].model.search(method)
    by_index = found is not None and any(leg[2] == Event.INDEX for leg in found[2])
    return row | {
        "attained": int(figures.attained),
        "time_s": round(figures.time, 6),
        "error_um": round(1e6 * figures.error, 3) if figures.attained else None,
        "peak_torque_share": round(figures.greatest_torque, 4),
        "impact_J": round(figures.impact_energy, 6),
        "index_near": int(figures.index_near),
        "index_turn": distance[0] if by_index and figures.attained else None,
        "failure": "" if figures.attained else f"no reference after {figures.time:g} s",
    }


FAILED: Row = {
    "attained": 0, "time_s": None, "error_um": None, "peak_torque_share": None, "impact_J": None,
    "index_near": None, "index_turn": None,
}


def own(name: str, known: Sequence[int]) -> tuple[Callable[[Master], object], int]:
    """Load a user's method, ``FILE.py:function``, which is called with a `Master` of the axis.

    It homes the axis and leaves the drive with a reference. It should find the home of the method
    that its attribute ``reference`` names, or of method 23 if it has none.

    Raises:
        ValueError: there is none, it cannot be called so, or the reference is not one of `known`.
    """
    home = from_file(name)
    why = "it is a class" if isinstance(home, type) else misfit(home, "master")
    if why:
        raise ValueError(
            f"--policy {name}: {why}; a homing method is a function that is called with a Master "
            "of the axis, see docs/how-to/homing_method.md"
        )
    reference = getattr(home, "reference", BESIDE)
    if reference not in known:
        raise ValueError(
            f"--policy {name}: reference = {reference!r}: give the method whose home it should "
            f"find, one of {', '.join(map(str, known))}"
        )
    return home, reference


def _own(machine: Machine, name: str, start: float) -> Row:
    """Run a user's method once."""
    home, reference = own(name, machine.drives["x"].model.homing_methods)
    before = machine.snapshot()
    try:
        machine.reset(positions={"x": start})
        figures = np.zeros(1, FIGURES)

        def watch() -> None:
            look(machine.addresses, figures)
            if machine.time - began > LONGEST:
                raise ServoError(
                    f"home within {LONGEST:g} s of the axis's time", "it goes on",
                    "give its waits an end",
                )

        began = machine.time
        master = Master(MachinePort(machine, watch), "x")
        master.enable()
        master.set_mode(Mode.HOMING)
        prepare(machine, figures[0], true_home(machine, reference, start))
        began = machine.time
        try:
            home(master)
        except ServoError as error:
            return FAILED | {"failure": str(error)}
        except (Exception, SystemExit) as error:
            raise ValueError(f"--policy {name} fails: {error_line(error)}") from error
        look(machine.addresses, figures)
        found = figures[0]
        return {
            "attained": int(found.attained), "time_s": round(machine.time - began, 6),
            "error_um": round(1e6 * float(found.error), 3) if found.attained else None,
            "peak_torque_share": round(float(found.greatest_torque), 4),
            "impact_J": round(float(found.impact_energy), 6), "index_near": 0, "index_turn": None,
            "failure": "" if found.attained else "it ended without a reference",
        }
    finally:
        machine.restore(before)


def _of(rows: list[Row], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows if row["attained"]], float)


def repeatability(errors: np.ndarray) -> float:
    """Return R of ISO 230-2 in one direction: four standard deviations; nan below two runs."""
    return float(4.0 * errors.std(ddof=1)) if len(errors) > 1 else np.nan


def one_sided(one: np.ndarray, other: np.ndarray) -> float:
    """Return R of ISO 230-2 of both sides of a switch: the larger one."""
    found = [repeatability(each) for each in (one, other)]
    return float(np.nanmax(found)) if np.isfinite(found).any() else np.nan


def two_sided(one: np.ndarray, other: np.ndarray) -> float:
    """Return A of ISO 230-2: lowest mean minus 2 s to highest mean plus 2 s, of both sides."""
    ends = []
    for errors in (one, other):
        if len(errors) > 1:
            spread = 2.0 * errors.std(ddof=1)
            ends.append((errors.mean() - spread, errors.mean() + spread))
    if not ends:
        return np.nan
    return float(max(high for _, high in ends) - min(low for low, _ in ends))


def interval(of: Callable[..., float], *samples: np.ndarray) -> tuple[float, float]:
    """Return the bootstrap interval of a figure of samples, with `CONFIDENCE`."""
    if any(len(sample) < 3 for sample in samples):
        return np.nan, np.nan
    random = np.random.default_rng(SEED)
    found = [of(*(random.choice(s, len(s)) for s in samples)) for _ in range(RESAMPLED)]
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.percentile(found, [tail, 100 - tail])
    return float(low), float(high)


def sides(rows: list[Row], edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (µm) of the runs from the left and from the right of the switch."""
    left = [row for row in rows if row["start_m"] < edge]
    right = [row for row in rows if row["start_m"] >= edge]
    return _of(left, "error_um"), _of(right, "error_um")


def sentences(cells: Sequence[Row]) -> list[str]:
    """Sum up the table in sentences, with the numbers that support them."""
    said = [
        f"Method {cell['method']} on {cell['mechanics']} does not home in {cell['failures']} of "
        f"{cell['runs']} runs: {cell['failure']}"
        for cell in cells
        if cell["failures"]
    ]
    for mechanics in dict.fromkeys(cell["mechanics"] for cell in cells):
        here = [c for c in cells if c["mechanics"] == mechanics]
        as_is = [c for c in here if c["variant"] == AS_DELIVERED and np.isfinite(c["A"])]
        if len(as_is) > 1:
            best, quick = min(as_is, key=lambda c: c["A"]), min(as_is, key=lambda c: c["time"])
            said.append(
                f"On {mechanics}, method {best['method']} repeats best, with A = "
                f"{number(best['A'])} µm{_between(best)} in {best['time']:.2f} s; method "
                f"{quick['method']} is the quickest, with {quick['time']:.2f} s and "
                f"A = {number(quick['A'])} µm."
            )
        base = next((c for c in as_is if c["method"] == str(BESIDE)), None)
        others = [c for c in here if c["variant"] != AS_DELIVERED and np.isfinite(c["A_low"])]
        if base and others and np.isfinite(base["A_low"]):
            apart = [
                c for c in others if c["A_low"] > base["A_high"] or c["A_high"] < base["A_low"]
            ]
            changed = [f"{number(c['A'])} µm{_between(c)} with {c['variant']}" for c in apart]
            same = [c["variant"] for c in others if c not in apart]
            said.append(
                f"With method {BESIDE} on {mechanics}, A is {number(base['A'])} µm{_between(base)} "
                "as delivered"
                + (f" and {', '.join(changed)}" if changed else "")
                + (f"; with {', '.join(same)} the intervals overlap." if same else ".")
            )
    return said


def _between(cell: Row) -> str:
    """Return the interval of A in words; empty if there are too few runs."""
    if not np.isfinite(cell["A_low"]):
        return ""
    return f" ({number(cell['A_low'])} to {number(cell['A_high'])})"


def figures(key: Key, runs: list[Row]) -> Row:
    """Sum up the runs of a cell."""
    mechanics, method, variant = key
    errors = _of(runs, "error_um")
    left, right = sides(runs, FAMILY[mechanics].home_switch)
    (low, high), (r_low, r_high) = (interval(of, left, right) for of in (two_sided, one_sided))
    turns = _of([r for r in runs if r["index_turn"] is not None], "index_turn")
    return {
        "mechanics": mechanics, "method": str(method), "variant": variant, "runs": len(runs),
        "failures": len(runs) - len(errors), "near": sum(bool(r["index_near"]) for r in runs),
        "time": _of(runs, "time_s").mean() if len(errors) else np.nan,
        "worst": errors[np.abs(errors).argmax()] if len(errors) else np.nan,
        "R": one_sided(left, right), "R_low": r_low, "R_high": r_high,
        "A": two_sided(left, right), "A_low": low, "A_high": high,
        "impact": _of(runs, "impact_J").max() if len(errors) else np.nan,
        "index": histogram(turns),
        "failure": next((r["failure"] for r in runs if r["failure"]), ""),
    }


def histogram(turns: np.ndarray) -> str:
    """Return how often the index came in each fifth of a turn from the edge; - without one."""
    if not len(turns):
        return "-"
    return " ".join(map(str, np.histogram(np.mod(turns, 1.0), 5, (0.0, 1.0))[0]))


def report(found: Mapping[Key, list[Row]]) -> Report:
    """Prepare page and picture from the runs of each cell."""
    cells = [figures(key, runs) for key, runs in found.items()]
    table = [
        [
            c["method"], c["mechanics"] + VARIANT.get(c["variant"], f", {c['variant']}"),
            number(c["time"]), number(c["worst"]),
            *(f"{number(c[x])} ({number(c[f'{x}_low'])}..{number(c[f'{x}_high'])})" for x in "RA"),
            c["index"], number(c["impact"]), str(c["failures"]), str(c["near"]),
        ]
        for c in cells
    ]
    heading = [
        "method", "axis", "time (s)", "worst error (µm)", "R (µm)", "A (µm)",
        "index distance (fifths of a turn)", "largest impact (J)", "failures", "index warnings",
    ]
    notes = (
        f"Each cell has {max(c['runs'] for c in cells)} runs, which start all over the stroke. The "
        "table shows the mean time and the error of largest magnitude: the home found minus the "
        "true edge, index pulse or stop. The drive sees only its motor, so elastic deflection "
        "between motor and load counts as error. R is the repeatability of ISO 230-2 from one side "
        "of the home switch (the larger of both sides, four standard deviations); A is that of "
        f"both sides together; both with their {CONFIDENCE:.0%} bootstrap intervals. The switches "
        "scatter by the standard deviation of their mechanics (none on rigid, 20 µm on the others) "
        "where the row gives no other one. The index distance counts how often the pulse came in "
        "each fifth of a turn from the edge. Index warnings are runs in which the index pulse lay "
        "so close to the edge that home may jump by a turn (warning FF10h of `generic`); move the "
        "switch by half a pitch in this case."
    )
    shown = [c for c in cells if c["variant"] == AS_DELIVERED]
    methods = list(dict.fromkeys(c["method"] for c in shown))
    family = list(dict.fromkeys(c["mechanics"] for c in shown))
    places = {(c["method"], c["mechanics"]): c for c in shown}

    def panel(name: str) -> np.ndarray:
        return np.array([[float(places[m, f][name]) for f in family] for m in methods])

    def why(name: str, i: int, k: int) -> str:
        cell = places[methods[i], family[k]]
        if name == "A (µm)" and cell["near"]:
            return "the index pulse lies near the edge, so home may jump by a turn (index warning)"
        if cell["failures"]:
            return str(cell["failure"])
        if methods[i] in map(str, ON_A_STOP):
            return "it pushes against the stop, and the transmission gives way"
        if name == "time (s)":
            return "it travels all the way at the slower speed"
        return f"worst error {number(cell['worst'])} µm; elasticity or backlash lies in between"

    panels = {
        "time (s)": panel("time"),
        "A (µm)": panel("A"),
        "largest impact (J)": panel("impact"),
    }
    runs = [row for own in found.values() for row in own]
    done = f"{sum(row['attained'] for row in runs)} of {len(runs)} runs found a reference"
    said = sentences(cells)
    done = "\n".join([*said[: sum(bool(c["failures"]) for c in cells)], done])
    return Report(
        heading, table, notes, said, methods, family, panels,
        panel("failures").astype(int), why, done,
    )


HOMING = Benchmark(
    "homing", "Homing", "homing methods", cells, report, lambda drive, jobs: jobs[:1]
)
