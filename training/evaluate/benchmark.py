"""The common part of the benchmarks of homing and of positioning: a grid, a page, a picture.

A benchmark defines the cells that it plays (`cells`) and how to present their results (`report`).
This module does the rest, from the jobs to the files.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ...envs import FAMILY
from ..pictures.heat_map import draw
from ..report import markdown, origin, write_csv, write_page
from ..scale.job import Job
from ..scale.work import ALONE, Work
from .grid import Grid, played

Row = dict[str, Any]  # of the CSV
OPTIONS = {  # arguments of `cells` that have another name on the command line
    "strategies": "policy", "payloads": "payload", "distances": "distance", "methods": "method",
    "parameter_file": "parameter-file",
}


class Report(NamedTuple):
    """The report of a benchmark: a table, notes below it, and a picture with several panels."""

    heading: Sequence[str]
    table: Sequence[Sequence[str]]
    notes: str
    sentences: Sequence[str]
    rows: Sequence[str]  # of the picture
    columns: Sequence[str]
    panels: Mapping[str, np.ndarray]
    failures: np.ndarray
    why: Callable[[str, int, int], str]
    done: str  # for the terminal


@dataclass(frozen=True)
class Benchmark:
    """A kind of benchmark.

    Args:
        name: of its files.
        title: of the page.
        of: what it compares, for the picture.
        cells: gives the grid for a drive, of all cells or of a small part, and further choices.
        report: makes the report from the rows of each cell.
        warm: makes small jobs that need all compiled code, from the drive and the grid's jobs.
    """

    name: str
    title: str
    of: str
    cells: Callable[..., Grid[Any, list[Row]]]
    report: Callable[[Mapping[Any, list[Row]]], Report]
    warm: Callable[[str, Sequence[Job]], Sequence[Job]]


def run(
    kind: Benchmark, drive: str, quick: bool, out: Path, console: Console, work: Work = ALONE,
    chosen: Mapping[str, Any] | None = None,
) -> int:
    """Measure, and write a CSV, a page and a picture to `out`; -> exit status.

    Args:
        kind: of benchmark.
        drive: drive model.
        quick: play only a small part.
        out: folder.
        console: shows the progress.
        work: runs the jobs.
        chosen: further arguments of `cells`.

    Raises:
        ValueError: an invalid choice, or no cell can be played.
    """
    chosen = chosen or {}
    grid = kind.cells(drive, quick, **chosen)
    source = origin(written(kind.name, drive, quick, chosen))
    path = out / kind.name
    with played(grid, work, console, out, warm=kind.warm(drive, grid.jobs)) as found:
        if not any(found.values()):
            raise ValueError(next(iter(grid.gaps.values())))
        report = kind.report(found)
        notes = report.notes + "\n\n" + "\n".join(f"- {sentence}" for sentence in report.sentences)
        rows = [row for own in found.values() for row in own]
        write_csv(path.with_suffix(".csv"), source, rows)
        page = markdown(report.heading, report.table)
        write_page(path.with_suffix(".md"), f"{kind.title}, drive {drive}", page, source, notes)
        draw(
            path.with_suffix(".png"), f"{kind.of}, drive {drive}", report.rows, report.columns,
            report.panels, report.failures, report.why,
        )
        console.print(f"{report.done}; {path}.csv, .md, .png", markup=False)
    return 0


def known_mechanics(names: Sequence[str], others: Sequence[str] = ()) -> None:
    """Raise ValueError for an axis that is neither in the family nor one of the others."""
    for name in names:
        if name not in (*FAMILY, *others):
            raise ValueError(f"--mechanics = {name!r}: choose from {', '.join((*FAMILY, *others))}")


def written(what: str, drive: str, quick: bool, chosen: Mapping[str, Any]) -> str:
    """Return the command that writes the files again."""
    words = ["servogym benchmark", what, "--drive", drive, *(["--quick"] if quick else [])]
    for name, value in chosen.items():
        values = value if isinstance(value, list | tuple) else [value]
        own = [v for v in values if name == "methods" and isinstance(v, str)]
        rest = [v for v in values if v not in own]
        words += [f"--policy {','.join(own)}"] if own else []
        text = ",".join(f"{v:g}" if isinstance(v, float) else str(v) for v in rest)
        words += [f"--{OPTIONS.get(name, name)} {text}"] if rest else []
    return " ".join(words)
