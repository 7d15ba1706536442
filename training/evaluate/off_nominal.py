"""`servogym compare --conditions`: a matrix, a heat map, and a curve for each disturbance."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ...envs.environment.registry import task
from ..pictures import heat_map
from ..policies import label
from ..report import GRID, kept_folder, markdown, number, origin, write_json, write_page
from ..scale.work import ALONE, Work
from .compare import folder_of
from .conditions import NOMINAL, TABLES, VERSION, Condition, chosen, suiting
from .matrix import Matrix
from .metrics import Difference, Summary, difference, metrics
from .parts import warm
from .tables import ahead, best, column_of, summaries

GAP = "gap"


def run(
    env: str, policies: Sequence[str], drive: str, episodes: int, seed: int, out: Path | None,
    console: Console, arguments: Mapping[str, Any], names: str, work: Work = ALONE,
) -> int:  # fmt: skip
    """Evaluate, and write conditions.md, .json, .png and _curves.png; -> exit status."""
    kind, table_of = task(env), TABLES.get(names, TABLES["all"])
    rows = chosen(list(suiting(kind, drive, arguments, table_of)), names)
    metric, row_of = kind.METRIC, metrics(kind)
    source = origin(
        f"servogym compare {env} --policies {','.join(policies)} --drive {drive} "
        f"--episodes {episodes} --seed {seed} --conditions {names}"
    )
    name = "-".join(["conditions", folder_of(env), Path(drive).name])
    out = kept_folder(out, name, "conditions.json", source["command"])
    matrix = Matrix(env, policies, drive, seed, episodes, arguments, rows)
    jobs = matrix.jobs
    played = matrix.results(work.map(jobs, folder=out, console=console, warm=[warm(env, drive)]))
    labels = [label(policy) for policy in matrix.policies]
    table: dict[str, list[Summary | None]] = {}
    apart: dict[str, list[Difference | None]] = {}
    successes: dict[str, list[float]] = {}
    against = ""
    for name, results in played.items():
        found = [result and summaries([result]) for result in results]
        table[name] = [each[metric][0] if each and metric in each else None for each in found]
        successes[name] = [
            s[0].mean if each and (s := each.get("success")) and s[0] else np.nan for each in found
        ]
        against = against or best({metric: table[name]}, labels, metric, row_of[metric].better)
        base = results[labels.index(against)]
        other = None if base is None else base.by_training(metric)
        apart[name] = [
            None
            if other is None
            or result is None
            or result is base
            or (values := result.by_training(metric)) is None
            else difference(values, other)
            for result in results
        ]
        console.print(f"{name}: " + ", ".join(
            f"{column_of(policy)} {number(s.iqm) if s else GAP}"
            for policy, s in zip(labels, table[name], strict=True)
        ), highlight=False)  # fmt: skip
    shown = [column_of(policy) for policy in labels]
    better = row_of[metric].better
    cells = [
        [name, *(_cell(*each, better) for each in zip(
            table[name], apart[name], successes[name], strict=True))]
        for name in table
    ]  # fmt: skip
    off = [name for name in table if name != NOMINAL]
    cells.append(
        [f"ahead of {column_of(against)}, of {len(off)}"]
        + [
            "–" if policy == against else _ahead([apart[name][i] for name in off], better)
            for i, policy in enumerate(labels)
        ]
    )
    notes = (
        f"{row_of[metric].heading}, interquartile mean [95 % interval over trainings and "
        "episodes], and success. In bold: the paired difference from "
        f"{column_of(against)} is on the better side of 0 with its interval. Table of conditions "
        f"{VERSION}. Policies know the data sheet of the drive and the mechanics they meet, and "
        "nothing else of the condition."
    )
    if matrix.gaps:
        notes += f"\n\nA {GAP} is a condition that a policy does not fit:\n\n{matrix.told()}"
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
        "gaps": [
            {"condition": condition, "policy": label(policy), "reason": reason}
            for (condition, policy), reason in matrix.gaps.items()
        ],
    })  # fmt: skip
    values = np.array([[s.iqm if s else np.nan for s in table[name]] for name in table])
    failures = np.array([[share < 1.0 for share in successes[name]] for name in table])
    panels, framed, places = _panels(rows, values, failures, row_of[metric].heading)
    heat_map.draw(out / "conditions.png", title, places, shown, panels, framed)
    heading = row_of[metric].heading
    drawn = curves(out / "conditions_curves.png", title, rows, table, shown, heading)
    console.print(f"{out / 'conditions'}.md, .json, .png{' and _curves.png' if drawn else ''}")
    work.clear(jobs, out)
    return 0


def _ahead(apart: Sequence[Difference | None], better: str) -> str:
    """How often a policy is the better one, and of how many where there are gaps."""
    known = [found for found in apart if found is not None]
    wins = sum(found.value > 0.0 if better == "high" else found.value < 0.0 for found in known)
    sure = sum(ahead(found, better) for found in known)
    of = f" of {len(known)}" if len(known) < len(apart) else ""
    return f"{wins}{of}, by the interval {sure}"


def _cell(summary: Summary | None, found: Difference | None, success: float, better: str) -> str:
    if summary is None:
        return GAP
    text = f"{number(summary.iqm)} [{number(summary.low)}, {number(summary.high)}]"
    text = f"**{text}**" if found is not None and ahead(found, better) else text
    return f"{text}, {100 * success:.0f} %" if np.isfinite(success) else text


def _panels(
    rows: Sequence[Condition], values: np.ndarray, failures: np.ndarray, heading: str
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], list[str]]:
    """Of the heat map, and its rows: a panel a disturbance where machines are the rows."""
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
    table: Mapping[str, Sequence[Summary | None]], policies: Sequence[str], heading: str,
) -> bool:  # fmt: skip
    """The metric over each disturbance that is a number; a panel an axis; -> whether any is."""
    import matplotlib.pyplot as plt

    axes = [*dict.fromkeys(row.axis for row in rows if not isinstance(row.value, str))]
    if not axes:
        return False
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
    return True
