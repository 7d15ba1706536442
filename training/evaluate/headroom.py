"""`servogym benchmark headroom`: every row of every task compared with what is possible.

Nothing is played: the values are those of comparisons, the JSON files of `servogym compare`. For
each task the page shows the bound, the best result that any row played in each episode, and
each row as a share of both. It says which rows keep the limits of following error, I²t and jerk.
Over all tasks it shows performance profiles and probabilities of improvement (Agarwal et al. 2021,
Deep reinforcement learning at the edge of the statistical precipice).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from ...envs.environment.registry import short
from ...envs.environment.servo_env import ServoEnv
from ...envs.view.about import Metric
from ..policies import LEARNED, POLICIES
from ..policies.bound import INFERRED
from ..policies.numbers import tuned
from ..report import markdown, number, origin, write_page
from .compare import read
from .episodes import Evaluation
from .metrics import metrics, summarise

BOUND = "bound"
STEPS = (0.2, 0.4, 0.6, 0.8, 0.9)  # shares of what is possible, in the performance profile
ROUGHER = 1.3  # times the jerk of the task's reference, the limit of a row
HEADING = (
    "row", "of", "metric", "of what is possible", "of the best played", "success",
    "rms jerk (m/s³)", "rms torque / rated", "keeps the limits",
)
NOTES = f"""Each row shows the interquartile mean [95 % interval] of the metric of the task. *Of
what is possible* is the mean of the bound over the mean of the row (the inverse for a return). *Of
the best played* is the same ratio with the best result that any row, informed or not, reached in
each episode; this result is known to be attainable, because it was played. Whether anything between
the bound and the best played is attainable is not known. Rows marked *told* are given the drawn
parameters or rehearse, and do not compete. *Keeps the limits* is the share of the episodes without
a fault, within the rated torque (rms, I²t) and with at most {ROUGHER} times the mean jerk of the
reference of the task; a following error beyond its window ends in a fault."""


class Row(NamedTuple):
    """A row of a task's table."""

    name: str
    found: Evaluation
    share: np.ndarray  # of what is possible, by training and episode; empty without a bound


def run(
    files: Sequence[Path], out: Path, console: Console, *, run_code: bool = False
) -> int:
    """Write the page from comparisons; -> exit status.

    Args:
        files: JSON files of `servogym compare`, one for each task.
        out: folder of the page.
        console: prints the name of the page.
        run_code: whether a comparison may name a task of another module.

    Raises:
        ValueError: there is no file, one is damaged, or two are of one task.
    """
    if not files:
        raise ValueError("name one compare.json or several, as `servogym compare` writes them")
    compared: dict[str, tuple[type[ServoEnv], dict[str, Evaluation]]] = {}
    for path in files:
        env, found = read(path, run_code=run_code)
        if short(env.ID) in compared:
            raise ValueError(f"{path}: there is a comparison of {short(env.ID)} already")
        if env.REFERENCE not in found:
            raise ValueError(
                f"{path} lacks {env.REFERENCE!r}, whose jerk counts: compare with it as well"
            )
        compared[short(env.ID)] = env, found
    text, shares = "", {}
    for name, (env, found) in compared.items():
        lines, shares[name] = section(env, found)
        text += lines
    text += across(shares) + gained(list(compared))
    source = origin(f"servogym benchmark headroom {' '.join(path.as_posix() for path in files)}")
    path = out / "headroom.md"
    write_page(path, "What is possible", text, source, NOTES)
    console.print(f"{path}", soft_wrap=True)
    return 0


def _values(found: Evaluation, metric: str) -> np.ndarray:
    values = found.by_training(metric)
    assert values is not None
    return values


def share_of(values: np.ndarray, limit: np.ndarray, metric: Metric) -> np.ndarray:
    """Return the share of what is possible for each episode; 1 is all of it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = limit / values if metric.better == "low" else values / limit
    return np.where((values == limit) | (values == 0.0), 1.0, parts)


def _mean_share(values: np.ndarray, limit: np.ndarray, metric: Metric) -> str:
    one, other = float(np.mean(values)), float(np.mean(limit))
    if metric.better == "high":
        one, other = other, one
    return f"{100 * other / one:.0f} %" if one > 0.0 else "–"


def section(env: type[ServoEnv], found: Mapping[str, Evaluation]) -> tuple[str, list[Row]]:
    """Return the section of a task and its rows, the best first."""
    name, known = env.METRIC, metrics(env)
    metric = known[name]
    limit = found[BOUND].by_training(name) if BOUND in found else None
    rivals = {n: one for n, one in found.items() if n != BOUND}
    sign = -1.0 if metric.better == "high" else 1.0
    every = [row for one in rivals.values() for row in sign * _values(one, name)]
    best = sign * np.min(every, axis=0)
    jerk = np.mean(rivals[env.REFERENCE].values["rms_jerk"])
    rows = []
    for n, one in rivals.items():
        share = np.empty(0) if limit is None else share_of(_values(one, name), limit[0], metric)
        rows.append(Row(n, one, share))
    rows.sort(key=lambda row: sign * summarise(_values(row.found, name), metric.better).iqm)
    lines = []
    for row in rows:
        values, faults = _values(row.found, name), row.found.values["faults"]
        rough, heat = row.found.values["rms_jerk"], row.found.values["rms_torque"]
        with np.errstate(invalid="ignore"):
            keeps = (faults == 0.0) & ~(heat > 1.0) & ~(rough > ROUGHER * jerk)
        informed = row.name in POLICIES and POLICIES[row.name].informed
        kind = "told" if informed else "learned" if row.name == LEARNED else "row"
        summary = summarise(values, metric.better)
        success = float(np.mean(row.found.values["success"]))
        lines.append([
            row.name, kind,
            f"{number(summary.iqm)} [{number(summary.low)}, {number(summary.high)}]",
            "–" if limit is None else _mean_share(values, limit, metric),
            _mean_share(values, best, metric),
            f"{100 * success:.0f} %" if np.isfinite(success) else "–",
            number(float(np.nanmean(rough))) if np.isfinite(rough).any() else "–",
            number(float(np.nanmean(heat))) if np.isfinite(heat).any() else "–",
            f"{100 * np.mean(keeps):.0f} %",
        ])
    task = short(env.ID)
    sure = "inferred" if env.BOUND in INFERRED else "proven"
    whole = "" if limit is None else _mean_share(best[None], limit, metric)
    where = (
        f"Mean bound ({sure}): {number(float(np.mean(limit)))}; mean of the best played in each "
        f"episode: {number(float(np.mean(best)))} ({whole} of what is possible)."
        if limit is not None
        else "No bound is known for this metric; mean of the best played in each episode: "
        f"{number(float(np.mean(best)))}."
    )
    return f"## {task}: {metric.heading}\n\n{where}\n\n{markdown(HEADING, lines)}\n", rows


def across(shares: Mapping[str, Sequence[Row]]) -> str:
    """Return performance profiles over the tasks, and the probability that `learned` improves."""
    groups: dict[str, list[np.ndarray]] = {"best row": [], LEARNED: [], "best told": []}
    improvement = []
    for rows in shares.values():
        if not all(row.share.size for row in rows):
            continue
        informed = [row for row in rows if row.name in POLICIES and POLICIES[row.name].informed]
        others = [row for row in rows if row not in informed and row.name != LEARNED]
        learned = [row for row in rows if row.name == LEARNED]
        for key, own in (("best row", others), (LEARNED, learned), ("best told", informed)):
            groups[key] += [own[0].share.ravel()] if own else []
        if learned:
            a, b = learned[0].share.ravel(), others[0].share.ravel()
            order = np.sign(a[:, None] - b[None, :])
            improvement.append(0.5 + 0.5 * float(np.mean(order)))
    heading = ["share of the episodes", *(f"≥ {100 * step:.0f} %" for step in STEPS), "tasks"]
    lines = [
        [key, *(
            f"{100 * np.mean([np.mean(one >= step) for one in parts]):.0f} %" for step in STEPS
        ), str(len(parts))]
        for key, parts in groups.items() if parts
    ]
    text = (
        "## Over the tasks\n\nThe table shows the share of episodes that reach at least the given "
        "fraction of what is possible, averaged over the tasks, each with its best row:\n\n"
    )
    text += f"{markdown(heading, lines)}\n"
    if improvement:
        text += (
            f"The probability of improvement of `{LEARNED}` over the best row, averaged over "
            f"{len(improvement)} tasks, is {np.mean(improvement):.2f}.\n"
        )
    return text


def gained(tasks: Sequence[str]) -> str:
    """Return the table of what the tuner gained in some tasks, from the file that it wrote."""
    heading = ("row", "task", "metric", "untuned", "tuned", "steps", "chosen by hand")
    lines = [
        [f"`{policy}`", task, one["metric"], number(one["untuned"]), number(one["tuned"]),
         f"{one['steps']:,}", one["choices"]]
        for policy, found in tuned().items()
        for task, one in found.items() if task in tasks
    ]
    if not lines:
        return ""
    return (
        "\n## What the tuner gained\n\nThe table shows the interquartile mean on the 48 training "
        "episodes by which `servogym tune-policy` judges, with the untuned and with the tuned "
        f"numbers:\n\n{markdown(heading, lines)}"
    )
