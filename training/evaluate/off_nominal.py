"""`servogym compare --conditions`: a matrix, a heat map, and a curve for each disturbance."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ..pictures import heat_map
from ..policies import label
from ..report import GRID, kept_folder, markdown, number, origin, write_json, write_page
from ..scale.work import ALONE, Work
from .comparison import Request
from .conditions import NOMINAL, TABLES, VERSION, Condition, chosen, suiting
from .episodes import Evaluation
from .grid import played
from .matrix import matrix
from .metrics import Difference, Summary, difference, metrics
from .parts import warm
from .tables import ahead, best, column_of, summaries

GAP = "gap"


class Entry(NamedTuple):
    """The result of a policy in a condition; a gap if it has no summary."""

    summary: Summary | None = None  # of the task's metric
    difference: Difference | None = None  # from the best baseline
    success: float = np.nan

    def shown(self, better: str) -> str:
        """Return the result as the page shows it."""
        s = self.summary
        if s is None:
            return GAP
        text = f"{number(s.iqm)} [{number(s.low)}, {number(s.high)}]"
        sure = self.difference is not None and ahead(self.difference, better)
        text = f"**{text}**" if sure else text
        return f"{text}, {100 * self.success:.0f} %" if np.isfinite(self.success) else text

    @property
    def data(self) -> dict[str, Any]:
        """Return the result as the JSON file holds it."""
        return {
            "summary": self.summary and self.summary._asdict(), "success": self.success,
            "difference": self.difference and self.difference._asdict(),
        }


def entry(metric: str, result: Evaluation | None, base: Evaluation | None) -> Entry:
    """Return the result of an evaluation in a condition; `base` is the best baseline's."""
    if result is None:
        return Entry()
    found = summaries([result])
    own = result.by_training(metric)
    other = base.by_training(metric) if base else None
    apart = None if result is base or own is None or other is None else difference(own, other)
    summary, success = (found.get(name, [None])[0] for name in (metric, "success"))
    return Entry(summary, apart, success.mean if success else np.nan)


def run(
    request: Request, names: str, out: Path | None, console: Console, work: Work = ALONE
) -> int:
    """Evaluate, and write conditions.md, .json, .png and _curves.png; -> exit status."""
    setup, metric = request.setup, request.setup.task.METRIC
    rows = chosen(list(suiting(setup, TABLES.get(names, TABLES["all"]))), names)
    heading, better, _ = metrics(setup.task)[metric]
    source = origin(request.command("compare", f" --conditions {names}"))
    out = kept_folder(out, f"conditions-{setup.stem}", "conditions.json", source["command"])
    grid, policies = matrix(request, rows), request.each
    labels = [label(policy) for policy in policies]
    shown = [column_of(policy) for policy in labels]
    with played(grid, work, console, out, warm=[warm(setup)]) as found:
        first = [entry(metric, found.get((rows[0].name, p)), None).summary for p in policies]
        against = best({metric: first}, labels, metric, better)
        table: dict[str, list[Entry]] = {}
        for row in rows:
            results = [found.get((row.name, policy)) for policy in policies]
            base = results[labels.index(against)]
            table[row.name] = [entry(metric, result, base) for result in results]
            console.print(f"{row.name}: " + ", ".join(
                f"{column} {number(e.summary.iqm) if e.summary else GAP}"
                for column, e in zip(shown, table[row.name], strict=True)
            ), highlight=False)
        _write(out, request, rows, table, against, source, grid.gaps)
        title = f"{setup.name} off nominal, drive {setup.drive}"
        values = np.array(
            [[e.summary.iqm if e.summary else np.nan for e in table[n]] for n in table]
        )
        failures = np.array([[e.success < 1.0 for e in table[name]] for name in table])
        panels, framed, places = _panels(rows, values, failures, heading)
        heat_map.draw(out / "conditions.png", title, places, shown, panels, framed)
        drawn = curves(out / "conditions_curves.png", title, rows, table, shown, heading)
        console.print(f"{out / 'conditions'}.md, .json, .png{' and _curves.png' if drawn else ''}")
    return 0


def _write(
    out: Path, request: Request, rows: Sequence[Condition], table: Mapping[str, Sequence[Entry]],
    against: str, source: Mapping[str, Any], gaps: Mapping[tuple[str, Any], str],
) -> None:
    """Return the page and the data."""
    setup, metric = request.setup, request.setup.task.METRIC
    heading, better, _ = metrics(setup.task)[metric]
    labels = [label(policy) for policy in request.each]
    cells = [[name, *(e.shown(better) for e in entries)] for name, entries in table.items()]
    off = [entries for name, entries in table.items() if name != NOMINAL]
    cells.append(
        [f"ahead of {column_of(against)}, of {len(off)}"]
        + [
            "–" if policy == against else _ahead([entries[i].difference for entries in off], better)
            for i, policy in enumerate(labels)
        ]
    )
    notes = (
        f"Each cell shows {heading} as interquartile mean [95 % interval over trainings and "
        "episodes], and success. It is bold if the interval of the paired difference from "
        f"{column_of(against)} lies on the better side of 0. The conditions are those of table "
        f"{VERSION}. Policies know the data sheet of the drive and the mechanics they meet, and "
        "nothing else about the condition."
    )
    if gaps:
        lines = (f"- {name}, {policy}: {reason}\n" for (name, policy), reason in gaps.items())
        notes += f"\n\nA {GAP} is a condition that a policy does not support:\n\n{''.join(lines)}"
    title = f"{setup.name} off nominal, drive {setup.drive}"
    columns = ["condition", *map(column_of, labels)]
    write_page(out / "conditions.md", title, markdown(columns, cells), source, notes)
    write_json(out / "conditions.json", {
        **source, "env": setup.name, "drive": setup.drive, "version": VERSION, "metric": metric,
        "against": against,
        "conditions": {
            name: {policy: e.data for policy, e in zip(labels, entries, strict=True)}
            for name, entries in table.items()
        },
        "gaps": [
            {"condition": name, "policy": label(policy), "reason": reason}
            for (name, policy), reason in gaps.items()
        ],
    })


def _ahead(apart: Sequence[Difference | None], better: str) -> str:
    """Return how often a policy is better, and of how many conditions if there are gaps."""
    known = [found for found in apart if found is not None]
    wins = sum(found.value > 0.0 if better == "high" else found.value < 0.0 for found in known)
    sure = sum(ahead(found, better) for found in known)
    of = f" of {len(known)}" if len(known) < len(apart) else ""
    return f"{wins}{of}, by the interval {sure}"


def _panels(
    rows: Sequence[Condition], values: np.ndarray, failures: np.ndarray, heading: str
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], list[str]]:
    """Return the panels of the heat map with their rows; one per disturbance of machines."""
    if not all(row.drive and row.arguments for row in rows):
        return {heading: values}, {heading: failures}, [row.name for row in rows]
    places = [*dict.fromkeys(row.axis for row in rows)]
    panels, framed = {}, {}
    for value in dict.fromkeys(row.value for row in rows):
        of = [i for i, row in enumerate(rows) if row.value == value]
        panels[str(value) or heading], framed[str(value) or heading] = values[of], failures[of]
    return panels, framed, places


def curves(
    path: Path, title: str, rows: Sequence[Condition],
    table: Mapping[str, Sequence[Entry]], policies: Sequence[str], heading: str,
) -> bool:
    """Draw the metric over each numeric disturbance in a panel; -> whether there is any."""
    from matplotlib.figure import Figure

    axes = [*dict.fromkeys(row.axis for row in rows if not isinstance(row.value, str))]
    if not axes:
        return False
    figure = Figure((3.0 * len(axes) + 1.0, 3.0), layout="constrained")
    panels = figure.subplots(1, len(axes), squeeze=False)
    for panel, axis in zip(panels[0], axes, strict=True):
        own = [row for row in rows if row.axis == axis]
        for i, policy in enumerate(policies):
            line = [(row.value, s) for row in own if (s := table[row.name][i].summary) is not None]
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
    return True
