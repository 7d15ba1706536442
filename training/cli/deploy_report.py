"""What `servogym deploy` prints and writes."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

Values = Sequence[Mapping[str, float]]  # metrics of each episode


def rows(what: str, one: Values, other: Values) -> Iterator[dict[str, Any]]:
    """Compare the means of two series of the same episodes, metric by metric.

    The interval of a difference is that of episodes resampled in pairs.
    """
    import numpy as np

    from ..evaluate.metrics import difference

    n = min(len(one), len(other))
    for metric in one[0] if n else ():
        pair = [np.array([[row[metric] for row in own[:n]]]) for own in (one, other)]
        apart = difference(*pair, share=True)
        yield {
            "what": what, "metric": metric, "episodes": n, "here": float(pair[0].mean()),
            "there": float(pair[1].mean()), "difference": apart.value, "low": apart.low,
            "high": apart.high,
        }


def tell_compared(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the comparisons, a table each."""
    from rich.table import Table

    for what in dict.fromkeys(row["what"] for row in rows):
        own = [row for row in rows if row["what"] == what]
        table = Table(title=f"{what}, {own[0]['episodes']} episodes")
        for name in ("metric", "mean", "of the other", "difference", "95 % interval"):
            table.add_column(name, justify="left" if name == "metric" else "right")
        for row in own:
            table.add_row(
                row["metric"], *(f"{row[key]:.4g}" for key in ("here", "there", "difference")),
                f"{row['low']:.3g} .. {row['high']:.3g}",
            )
        console.print(table)


def tell_times(timing: Any, console: Console) -> None:
    """Print how late the steps were, as percentiles and as a histogram."""
    from rich.table import Table

    rows = timing.rows()
    if not rows:
        return
    edges = timing.EDGES
    table = Table(title=f"{len(timing.waking)} steps of {1e3 * timing.period:g} ms, times in µs")
    for name in ("", *(row.what for row in rows)):
        table.add_column(name, justify="right")
    for name, key in (("median", "median"), ("99 %", "p99"), ("99.9 %", "p999"), ("most", "most")):
        table.add_row(name, *(f"{getattr(row, key):.0f}" for row in rows))
    table.add_section()
    for n, name in enumerate([*(f"<{edge:g}" for edge in edges[1:-1]), "more"]):
        table.add_row(name, *(f"{row.counts[n] or ''}" for row in rows))
    console.print(table)
    console.print(
        f"{timing.missed} set-points a step late, {timing.lost} steps without all answers, "
        f"{timing.stale} actions not in time, at most {timing.in_a_row} in a row; the policy took "
        f"{timing.share:.0%} of the time", highlight=False,
    )


class StepLog:
    """Writes a line for each step: the last commands and the answers of the drives.

    Args:
        path: of the file, .csv.
        line: the connection to the drives.
    """

    def __init__(self, path: Path, line: Any):
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._file)
        self._line, self._headed = line, False
        line.on_step = self._write

    def _write(self, images: Any) -> None:
        if self._line.sent is None:  # before the first command
            return
        both = self._line.sent, images
        if not self._headed:
            heads = [f"{axis}:{name}" for each in both for axis in self._line.guards
                     for name in each.dtype.names]
            self._rows.writerow(["time (s)", *heads])
            self._headed = True
        values = [row[name].item() for each in both for row in each for name in each.dtype.names]
        self._rows.writerow([f"{self._line.time:.6f}", *values])

    def close(self) -> None:
        """Close the file."""
        self._file.close()
