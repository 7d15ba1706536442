"""A picture of many figures: a panel for each quantity, with named rows and columns."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..report import number

FAR, MOST = 10.0, 6  # an outlier is above FAR times the median; MOST of them are explained


def outliers(values: np.ndarray) -> list[tuple[int, int]]:
    """Rows and columns of the values far above the median of all, the largest first."""
    known = values[np.isfinite(values) & (values > 0)]
    if not len(known):
        return []
    far = np.argwhere(np.nan_to_num(values) > FAR * np.median(known))
    return sorted(((int(i), int(k)) for i, k in far), key=lambda place: -values[place])


def _explained(rows, columns, panels, why) -> list[str]:
    """A line for each outlier, and one for the number of those left out."""
    lines = []
    for name, values in panels.items():
        found = outliers(values)
        for i, k in found[:MOST]:
            reason = why(name, i, k)
            lines.append(
                f"{name} {number(float(values[i, k]))}, {rows[i]} on {columns[k]}: {reason}"
            )
        if len(found) > MOST:
            lines.append(f"{name}: {len(found) - MOST} more above {FAR:g} times the median")
    return lines


def draw(
    path: Path, title: str, rows: Sequence[object], columns: Sequence[str],
    panels: Mapping[str, np.ndarray], failures: np.ndarray | Mapping[str, np.ndarray],
    why: Callable[[str, int, int], str] | None = None,
) -> None:
    """Draw panels with a coloured cell for each value.

    Args:
        path: path of the PNG.
        title: title of the picture.
        rows: names of the rows.
        columns: names of the columns.
        panels: values by quantity with unit, shape ``(rows, columns)``.
        failures: number of failed runs, same shape, for all panels or by panel; a cell with a
            failed run has a red frame.
        why: returns the reason of an outlier by panel, row and column; the reasons are printed
            below the picture, the largest value first.
    """
    from matplotlib.colors import LogNorm  # imported here because it is slow to load
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    width = 1.0 + 0.85 * len(columns)
    figure = Figure((1.0 + width * len(panels), 2.2 + 0.27 * len(rows)), layout="constrained")
    places = figure.subplots(1, len(panels), sharey=True, squeeze=False)
    for panel, (name, values) in zip(places[0], panels.items(), strict=True):
        positive = values[np.isfinite(values) & (values > 0)]
        low, high = (positive.min(), positive.max()) if len(positive) else (0.1, 1.0)
        framed = failures if isinstance(failures, np.ndarray) else failures[name]
        norm = LogNorm(low, max(high, 1.001 * low))
        shown = np.where(values > 0, values, low)
        panel.imshow(shown, cmap="Blues", norm=norm, aspect="auto", alpha=0.85)
        for i, k in np.ndindex(values.shape):
            dark = np.isfinite(shown[i, k]) and norm(shown[i, k]) > 0.6
            panel.text(
                k, i, number(float(values[i, k])), ha="center", va="center", fontsize=7,
                color="white" if dark else "black",
            )
            if framed[i, k]:
                panel.add_patch(
                    Rectangle((k - 0.46, i - 0.44), 0.92, 0.88, fill=False, ec="#c0392b", lw=1.4)
                )
        panel.set_title(name, fontsize=10)
        panel.set_xticks(range(len(columns)), columns, rotation=40, ha="right", fontsize=8)
        panel.set_yticks(range(len(rows)), [str(row) for row in rows], fontsize=8)
    heading = f"{title}; red frame: at least one run failed"
    figure.suptitle(textwrap.fill(heading, int(10 * figure.get_figwidth())), fontsize=11)
    if why and (lines := _explained(rows, columns, panels, why)):
        lines = [textwrap.fill(line, int(13 * figure.get_figwidth())) for line in lines]
        figure.set_figheight(figure.get_figheight() + 0.16 * sum(t.count("\n") + 1 for t in lines))
        figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})
