"""`servogym compare --conditions`: off nominal, a row a condition of a table.

The table has a version: rows are never changed, a new table has a new version. What is drawn at
random in the task stays as it is, but for what the condition sets; in a condition all policies play
the same episodes, from one condition to the next they may differ. Policies know the data sheet of
the machine they meet, and nothing of the condition.
"""

import inspect
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ...drive.model.model import load, model_names
from ...drive.model.near import near
from ...envs import FAMILY
from ...envs.registry import task
from ...envs.servo_env import ServoEnv
from ..pictures import heat_map
from ..report import GRID, kept_folder, markdown, number, origin, write_json, write_page
from ..scale.work import ALONE, Work
from .compare import Comparison, _label, ahead, best, folder_of, summaries
from .metrics import Summary, difference, metrics
from .parts import warm

VERSION = "v1"
NONE: Mapping[str, float] = MappingProxyType({})


class Condition(NamedTuple):
    """A row of the table."""

    axis: str  # of disturbance
    value: float | str  # on it
    randomise: Mapping[str, float] = NONE  # instead of what the task draws
    beyond: Mapping[str, float] = NONE  # the same, in shares of the upper end of its range
    arguments: Mapping[str, str] = MappingProxyType({})  # of the environment
    drive: str = ""

    @property
    def name(self) -> str:
        """``"delay=3"``."""
        return "nominal" if self.axis == "nominal" else f"{self.axis}={self.value}"


CONDITIONS = (
    Condition("nominal", 0),
    *(Condition("delay", n, {"delay": float(n)}) for n in (1, 3, 5)),
    *(Condition("encoder_noise_um", n, {"encoder_noise": n * 1e-6}) for n in (1, 5)),
    *(Condition("friction", n, {"friction": n}) for n in (0.25, 3.0, 5.0)),
    *(Condition("payload_of_range", n, beyond={"payload": n}) for n in (1.25, 1.5)),
    *(Condition("stiffness_of_range", n, beyond={"stiffness": n}) for n in (0.2, 1.5)),
    *(Condition("gains", n, {"gains": n}) for n in (0.6, 0.8, 1.25, 1.5)),
    *(Condition("drive", name, drive=name) for name in model_names()),
    *(Condition("mechanics", name, arguments={"parameters": name}) for name in FAMILY),
)


def suiting(kind: type[ServoEnv], drive: str, arguments: Mapping[str, Any]) -> Iterator[Condition]:
    """The rows that mean something for a task and differ from what it is already."""
    env = kind(drive=drive, **arguments)
    ranges, own = env.randomisation.ranges, inspect.signature(kind.__init__).parameters
    nominal = env.datasheet
    env.close()
    for row in CONDITIONS:
        known = not row.drive or (row.drive != drive and {*kind.MODES} <= {*load(row.drive).modes})
        same = row.axis == "mechanics" and FAMILY[str(row.value)] == nominal
        if (
            known
            and not same
            and row.beyond.keys() <= ranges.keys()
            and row.arguments.keys() <= own.keys()
        ):
            yield row


def chosen(rows: Sequence[Condition], names: str) -> list[Condition]:
    """Those of a list of names or axes, separated by commas; all: every one.

    Raises ValueError for a name that is not in the table or does not suit the task.
    """
    if names == "all":
        return list(rows)
    picked: list[Condition] = []
    for name in filter(None, map(str.strip, names.split(","))):
        found = [row for row in rows if name in (row.name, row.axis)]
        if not found:
            known = [*dict.fromkeys(each for row in rows for each in (row.axis, row.name))]
            raise ValueError(f"--conditions: {name!r} is unknown here: {near(name, known)}")
        picked += [row for row in found if row not in picked]
    return picked


def setting(
    kind: type[ServoEnv], drive: str, arguments: Mapping[str, Any], row: Condition
) -> dict[str, Any]:
    """The arguments of the environment in a condition."""
    nominal = kind(drive=drive, **arguments)
    ranges: dict[str, Any] = dict(nominal.randomisation.ranges)
    nominal.close()
    drawn = ranges | dict(row.randomise)
    drawn |= {name: share * ranges[name][1] for name, share in row.beyond.items()}
    plain = {name: value for name, value in arguments.items() if name != "randomise"}
    return plain | dict(row.arguments) | {"randomise": drawn}


def run(
    env: str, policies: Sequence[str], drive: str, episodes: int, seed: int, out: Path | None,
    console: Console, arguments: Mapping[str, Any], names: str, work: Work = ALONE,
) -> int:  # fmt: skip
    """Evaluate, and write conditions.md, .json, .png and _curves.png; -> exit status."""
    kind = task(env)
    rows = chosen(list(suiting(kind, drive, arguments)), names)
    metric, row_of = kind.METRIC, metrics(kind)
    source = origin(
        f"servogym compare {env} --policies {','.join(policies)} --drive {drive} "
        f"--episodes {episodes} --seed {seed} --conditions {names}"
    )
    name = "-".join(["conditions", folder_of(env), Path(drive).name])
    out = kept_folder(out, name, "conditions.json", source["command"])
    table: dict[str, list[Summary | None]] = {}
    apart, successes, against = {}, {}, ""
    comparisons: list[Comparison] = []
    for row in rows:
        given = setting(kind, drive, arguments, row)
        comparisons.append(Comparison(env, policies, row.drive or drive, episodes, seed, given))
    jobs = [job for comparison in comparisons for job in comparison.jobs]
    left = iter(work.map(jobs, folder=out, console=console, warm=[warm(env, drive)]))
    for row, comparison in zip(rows, comparisons, strict=True):
        results = comparison.results([next(left) for _ in comparison.jobs])
        found = summaries(results)
        labels = [result.policy for result in results]
        against = against or best(found, labels, metric, row_of[metric].better)
        base = results[labels.index(against)].by_training(metric)
        table[row.name] = found.get(metric, [None] * len(results))
        successes[row.name] = [s.mean if s else np.nan for s in found["success"]]
        apart[row.name] = [
            None
            if base is None or result.policy == against or values is None
            else difference(values, base)
            for result in results
            for values in [result.by_training(metric)]
        ]
        console.print(f"{row.name}: " + ", ".join(
            f"{_label(name)} {number(s.iqm) if s else '–'}"
            for name, s in zip(labels, table[row.name], strict=True)
        ), highlight=False)  # fmt: skip
    shown = [_label(policy) for policy in labels]
    better = row_of[metric].better
    cells = [
        [name, *(_cell(*each, better) for each in zip(
            table[name], apart[name], successes[name], strict=True))]
        for name in table
    ]  # fmt: skip
    off = [name for name in table if name != "nominal"]
    wins = [sum(_wins(apart[name][i], better) for name in off) for i in range(len(shown))]
    sure = [
        sum(found is not None and ahead(found, better) for found in (apart[n][i] for n in off))
        for i in range(len(shown))
    ]
    cells.append(
        [f"ahead of {_label(against)}, of {len(off)}"]
        + [
            "–" if policy == against else f"{win}, by the interval {certain}"
            for policy, win, certain in zip(labels, wins, sure, strict=True)
        ]
    )
    notes = (
        f"{row_of[metric].heading}, interquartile mean [95 % interval over trainings and "
        f"episodes], and success. In bold: the paired difference from {_label(against)} is on the "
        f"better side of 0 with its interval. Table of conditions {VERSION}. Policies know the "
        "data sheet of the drive and the mechanics they meet, and nothing else of the condition."
    )
    title = f"{env} off nominal, drive {drive}"
    write_page(out / "conditions.md", title, markdown(["condition", *shown], cells), source, notes)
    write_json(out / "conditions.json", source | {
        "env": env, "drive": drive, "version": VERSION, "metric": metric, "against": against,
        "conditions": {
            name: {
                policy: {
                    "summary": s._asdict() if s else None, "success": success,
                    "difference": d._asdict() if d else None,
                }
                for policy, s, d, success in zip(
                    labels, table[name], apart[name], successes[name], strict=True)
            }
            for name in table
        },
    })  # fmt: skip
    values = np.array([[s.iqm if s else np.nan for s in table[name]] for name in table])
    failures = np.array([[share < 1.0 for share in successes[name]] for name in table])
    heading = {row_of[metric].heading: values}
    heat_map.draw(out / "conditions.png", title, list(table), shown, heading, failures)
    curves(out / "conditions_curves.png", title, rows, table, shown, row_of[metric].heading)
    console.print(f"{out / 'conditions'}.md, .json, .png and _curves.png")
    work.clear(jobs, out)
    return 0


def _wins(found: Any, better: str) -> bool:
    return found is not None and (found.value > 0.0 if better == "high" else found.value < 0.0)


def _cell(summary: Summary | None, found: Any, success: float, better: str) -> str:
    if summary is None:
        return "–"
    text = f"{number(summary.iqm)} [{number(summary.low)}, {number(summary.high)}]"
    text = f"**{text}**" if found is not None and ahead(found, better) else text
    return f"{text}, {100 * success:.0f} %"


def curves(
    path: Path, title: str, rows: Sequence[Condition],
    table: Mapping[str, Sequence[Summary | None]], policies: Sequence[str], heading: str,
) -> None:  # fmt: skip
    """The metric over each disturbance that is a number; a panel an axis."""
    import matplotlib.pyplot as plt

    axes = [*dict.fromkeys(row.axis for row in rows if not isinstance(row.value, str))]
    axes = [axis for axis in axes if axis != "nominal"] or ["nominal"]
    figure, panels = plt.subplots(
        1, len(axes), figsize=(3.0 * len(axes) + 1.0, 3.0), squeeze=False, layout="constrained"
    )
    for panel, axis in zip(panels[0], axes, strict=True):
        own = [row for row in rows if row.axis == axis]
        for i, policy in enumerate(policies):
            line = [(row.value, s) for row in own if (s := table[row.name][i]) is not None]
            at = [float(value) for value, _ in line]
            panel.plot(at, [s.iqm for _, s in line], "o-", label=policy, color=f"C{i}")
            panel.fill_between(
                at, [s.low for _, s in line], [s.high for _, s in line], alpha=0.15, color=f"C{i}"
            )
        panel.set_xlabel(axis)
        panel.grid(**GRID)
    panels[0][0].set_ylabel(heading)
    panels[0][0].legend(fontsize=7)
    figure.suptitle(title, fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)
