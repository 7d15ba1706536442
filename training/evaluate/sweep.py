"""`servogym sweep`: policies or trainings over tasks, drives, conditions, seeds and values.

A cell combines one of each; all cells form one list of jobs. Values come from a grid or from an
Optuna study. The study proposes a fixed number of trials at a time, so its proposals do not depend
on how the jobs are distributed.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ...drive.model.model import load
from ...envs.environment.registry import short
from ..report import markdown, number, origin, table, write_csv, write_json, write_page
from ..scale.job import Job, Result
from ..scale.work import Work
from ..setup import ArgumentError, Setup
from . import conditions
from .comparison import Comparison, Request
from .episodes import Evaluation
from .grid import Grid
from .metrics import metrics
from .parts import warm
from .tables import SCORE, column_of, summaries

AT_A_TIME = 8  # trials of a study that run before the first of them is reported
SAMPLER_SEED = 0
EVALUATIONS = 8  # of a training; the best policy is kept
TRAINED, POLICY = "trained", "best"  # folders: of the policies in --out, of one in its training
FIXED = ("task", "drive", "condition", "seed")

Row = dict[str, Any]


class Range(NamedTuple):
    """Range of a value that a study searches."""

    low: float
    high: float
    log: bool

    def suggested(self, trial: Any, name: str) -> float:
        """Return a value proposed by a study; a whole number if both ends are."""
        ints = isinstance(self.low, int) and isinstance(self.high, int)
        suggest = trial.suggest_int if ints else trial.suggest_float
        return suggest(name, self.low, self.high, log=self.log)


@dataclass(frozen=True)
class Sweep:
    """The axes of a sweep.

    Args:
        setups: tasks, with the arguments of every environment.
        policies: by name; none if each cell trains its own.
        drives: models.
        conditions: names of the table of conditions, separated by commas; empty: nominal.
        seeds: of the episodes, or of the trainings.
        vary: values or a range by name: arguments of the environment, or hyper-parameters.
        episodes: of each cell.
        algorithm: the training algorithm; empty for no training.
        steps: of each training.
    """

    setups: Sequence[Setup]
    policies: Sequence[str]
    drives: Sequence[str]
    conditions: str
    seeds: Sequence[int]
    vary: Mapping[str, Any]
    episodes: int
    algorithm: str = ""
    steps: int = 0

    def __post_init__(self):
        if bool(self.policies) == bool(self.algorithm):
            raise ValueError("give either --policies, to play, or --train, to train and play")
        for drive in self.drives:
            load(drive)

    def grid(self) -> Iterator[dict[str, Any]]:
        """Return all combinations of the values. Raises ValueError for a range of a study."""
        for name, values in self.vary.items():
            if isinstance(values, Range):
                raise ValueError(f"--vary {name} is a range: give values, or --trials for a study")
        for each in itertools.product(*self.vary.values()):
            yield dict(zip(self.vary, each, strict=True))


class _Cell(NamedTuple):
    """A row of the sweep, in which policies play or a policy is trained."""

    drive: str  # as asked for; a condition may have another one
    condition: str
    seed: int
    values: dict[str, Any]
    setup: Setup
    settings: dict[str, Any]  # hyper-parameters

    @property
    def name(self) -> str:
        parts = [self.setup.name.rpartition("/")[2], Path(self.drive).name, self.condition]
        parts += [str(self.seed), *(f"{name}={value}" for name, value in self.values.items())]
        return "-".join(parts).replace("/", "_")


def _cells(sweep: Sweep, values: Mapping[str, Any], left_out: list[str]) -> Iterator[_Cell]:
    for task, drive in itertools.product(sweep.setups, sweep.drives):
        arguments = dict(task.arguments)
        settings: dict[str, Any] = {}
        hyper: Mapping[str, Any] = {}
        if sweep.algorithm:
            from ..learn import hyperparameters

            hyper = hyperparameters.of(task.task, sweep.algorithm)
        for name, value in values.items():
            (settings if name in hyper else arguments)[name] = value
        setup = task.having(arguments, drive)
        try:
            known = list(conditions.suiting(setup))
            rows = conditions.chosen(known, sweep.conditions or conditions.NOMINAL)
            each = [conditions.applied(setup, row) if sweep.conditions else setup for row in rows]
        except ArgumentError as error:
            raise ValueError(f"--vary, {error}: see the arguments of {setup.name}") from None
        except ValueError as error:
            left_out.append(f"{setup}: {error}")
            continue
        for row, own in zip(rows, each, strict=True):
            for seed in sweep.seeds:
                yield _Cell(drive, row.name, seed, dict(values), own, settings)


def trained(
    setup: Setup, algorithm: str, settings: Mapping[str, Any], seed: int, steps: int
) -> Result:
    """Train a policy as a job; return its best files, each as an array of bytes."""
    from tempfile import TemporaryDirectory

    from ..learn.train import Training, train

    with TemporaryDirectory() as folder:
        asked = Training(
            setup.task, steps, Path(folder, "run"), drive=setup.drive, algorithm=algorithm,
            seed=seed, arguments=setup.arguments, settings=settings,
            evaluate_every=max(steps // EVALUATIONS, 1),
        )
        train(asked)
        files = sorted(Path(folder, "run", POLICY).iterdir())
        return {path.name: np.frombuffer(path.read_bytes(), np.uint8) for path in files}


def measure(
    sweep: Sweep, several: Sequence[Mapping[str, Any]], out: Path, console: Console, work: Work,
    left_out: list[str],
) -> tuple[list[list[Row]], list[Job]]:
    """Return rows for each set of values, and the jobs that were done for them."""
    cells = [(k, c) for k, values in enumerate(several) for c in _cells(sweep, values, left_out)]
    ready = [warm(s) for s in {(c.setup.name, c.setup.drive): c.setup for _, c in cells}.values()]
    names: dict[str, list[str]] = {cell.name: list(sweep.policies) for _, cell in cells}
    done: list[Job] = []
    if sweep.algorithm:
        done = [
            Job(f"training {cell.name}", trained, {
                "setup": cell.setup, "algorithm": sweep.algorithm, "settings": cell.settings,
                "seed": cell.seed, "steps": sweep.steps,
            })
            for _, cell in cells
        ]
        found = work.map(done, folder=out, console=console, warm=ready)
        for (_, cell), files in zip(cells, found, strict=True):
            folder = out / TRAINED / cell.name
            folder.mkdir(parents=True, exist_ok=True)
            for name, data in files.items():
                (folder / name).write_bytes(data.tobytes())
            names[cell.name] = [str(folder)]
        work = replace(work, ray=None)  # other nodes do not have these folders
    grid = Grid[int, list[Evaluation]]()
    for i, (_, cell) in enumerate(cells):
        seed = 0 if sweep.algorithm else cell.seed
        with grid.tried(i):
            grid.cells[i] = Comparison(Request(cell.setup, names[cell.name], sweep.episodes, seed))
    left_out += [f"{cells[i][1].name}: {reason}" for i, reason in grid.gaps.items()]
    if not grid.cells:
        raise ValueError(left_out[0] if left_out else "there is no environment to sweep over")
    played = grid.results(work.map(grid.jobs, folder=out, console=console, warm=ready))
    rows: list[list[Row]] = [[] for _ in several]
    for i, results in played.items():
        rows[cells[i][0]] += _rows(cells[i][1], results)
    return rows, done + grid.jobs


def _rows(cell: _Cell, results: Sequence[Evaluation]) -> Iterator[Row]:
    kind, table = cell.setup.task, summaries(results)
    known = metrics(kind)
    for i, result in enumerate(results):
        row: Row = {"task": short(kind.ID), "drive": Path(cell.drive).name}
        row |= {"condition": cell.condition, "seed": cell.seed, **cell.values}
        row |= {"policy": column_of(result.policy), "metric": kind.METRIC}
        row["better"] = known[kind.METRIC].better
        for name, metric in (("", kind.METRIC), ("score", "score"), ("success", "success")):
            summary = table.get(metric, [None] * len(results))[i]
            value = None if summary is None else summary.mean if name == "success" else summary.iqm
            row |= {name or "value": value}
            if not name:
                row |= {end: summary and getattr(summary, end) for end in ("low", "high")}
        yield row


def worth(rows: Sequence[Row]) -> tuple[float, str]:
    """Return mean metric (mean score for several tasks) of a set of values, and which is better."""
    name = "value" if len({row["task"] for row in rows}) == 1 else "score"
    values = [row[name] for row in rows]
    better = rows[0]["better"] if name == "value" and rows else SCORE.better
    finite = bool(values) and all(value is not None and np.isfinite(value) for value in values)
    return float(np.mean(values)) if finite else np.nan, better


def study(
    sweep: Sweep, trials: int, out: Path, console: Console, work: Work, left_out: list[str]
) -> tuple[list[Row], list[Job]]:
    """Return rows of the trials of an Optuna study. Raises ImportError without Optuna."""
    if not sweep.vary:
        raise ValueError("--trials has nothing to look for: give --vary NAME=LOW..HIGH")
    try:
        import optuna
    except ImportError as error:
        raise ImportError(f"{error}: --trials needs pip install 'servogym[sweep]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    one = sweep.setups[0].task
    better = metrics(one)[one.METRIC].better if len(sweep.setups) == 1 else SCORE.better
    directions = optuna.study.StudyDirection
    found = optuna.create_study(
        direction=directions.MAXIMIZE if better == "high" else directions.MINIMIZE,
        sampler=optuna.samplers.TPESampler(seed=SAMPLER_SEED),
    )
    rows: list[Row] = []
    jobs: list[Job] = []
    for begin in range(0, trials, AT_A_TIME):
        asked = [found.ask() for _ in range(min(AT_A_TIME, trials - begin))]
        several = [
            {
                name: values.suggested(trial, name) if isinstance(values, Range)
                else trial.suggest_categorical(name, values)
                for name, values in sweep.vary.items()
            }
            for trial in asked
        ]
        measured, done = measure(sweep, several, out, console, work, left_out)
        jobs += done
        for trial, its in zip(asked, measured, strict=True):
            value, _ = worth(its)
            if np.isfinite(value):
                found.tell(trial, value)
            else:
                found.tell(trial, state=optuna.trial.TrialState.FAIL)
            rows += [{"trial": trial.number, **row} for row in its]
    return rows, jobs


def run(
    sweep: Sweep, trials: int | None, command: str, out: Path, console: Console, work: Work
) -> int:
    """Run the sweep, and write sweep.csv, .json and .md to `out`; -> exit status."""
    left_out: list[str] = []
    if trials is None:
        measured, jobs = measure(sweep, list(sweep.grid()), out, console, work, left_out)
        rows = [row for its in measured for row in its]
    else:
        rows, jobs = study(sweep, trials, out, console, work, left_out)
    sets: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        key = (row.get("trial"), *(repr(row[name]) for name in sweep.vary), row["policy"])
        key = key[:-1] if sweep.algorithm else key
        sets.setdefault(key, []).append(row)
    known = [(value, its) for its in sets.values() for value, _ in [worth(its)]]
    finite = [(value, its) for value, its in known if np.isfinite(value)]
    sign = -1.0 if rows and worth(rows)[1] == "high" else 1.0
    first = min(finite, key=lambda found: sign * found[0], default=None)
    trial = ["trial"] if trials is not None else []
    heading = [*trial, *FIXED, *sweep.vary, "policy", "metric", "value", "score", "success"]
    cells = [[_shown(row[name]) for name in heading] for row in rows]
    source = origin(command)
    notes = f"Interquartile mean of the metric over {sweep.episodes} episodes a cell, and score. "
    if first:
        value, its = first
        which = ", ".join(f"{name} = {_shown(its[0][name])}" for name in (*sweep.vary, "policy"))
        of = its[0]["metric"] if worth(its)[1] == its[0]["better"] else "score"
        notes += f"Best in the mean over its cells: {which}, {of} {number(value)}."
    notes += "".join(f"\n\nLeft out: {reason}" for reason in dict.fromkeys(left_out))
    differ = [i for i, name in enumerate(heading)
              if name in ("policy", "value") or len({line[i] for line in cells}) > 1]
    shown = [[line[i] for i in differ] for line in cells[:40]]
    console.print(table([heading[i] for i in differ], shown, "sweep"))
    if len(cells) > 40:
        console.print(f"and {len(cells) - 40} more rows in {out / 'sweep.csv'}", highlight=False)
    write_csv(out / "sweep.csv", source, rows)
    write_json(out / "sweep.json", source | {"rows": rows, "left_out": [*dict.fromkeys(left_out)]})
    write_page(out / "sweep.md", "Sweep", markdown(heading, cells), source, notes)
    console.print(f"{out / 'sweep'}.csv, .json, .md", highlight=False)
    work.clear(jobs, out)
    return 0


def _shown(value: Any) -> str:
    return "–" if value is None else number(value) if isinstance(value, float) else str(value)
