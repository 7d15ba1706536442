"""A picture of many figures: a panel a quantity, named rows and columns."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

from ..report import number


def draw(
    path: Path, title: str, rows: Sequence[object], columns: Sequence[str],
    panels: Mapping[str, np.ndarray], failures: np.ndarray | Mapping[str, np.ndarray],
) -> None:  # fmt: skip
    """Draw.

    Args:
        path: of the PNG.
        title: above all.
        rows: their names.
        columns: their names.
        panels: values by quantity with unit, shape ``(rows, columns)``.
        failures: runs that failed, same shape, of all panels or by panel; cells with any have a
            red frame.
    """
    width = 1.0 + 0.85 * len(columns)
    figure, places = plt.subplots(
        1, len(panels), figsize=(1.0 + width * len(panels), 2.2 + 0.27 * len(rows)),
        sharey=True, layout="constrained", squeeze=False,
    )  # fmt: skip
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
            )  # fmt: skip
            if framed[i, k]:
                panel.add_patch(
                    plt.Rectangle(
                        (k - 0.46, i - 0.44), 0.92, 0.88, fill=False, ec="#c0392b", lw=1.4
                    )
                )
        panel.set_title(name, fontsize=10)
        panel.set_xticks(range(len(columns)), columns, rotation=40, ha="right", fontsize=8)
        panel.set_yticks(range(len(rows)), [str(row) for row in rows], fontsize=8)
    heading = f"{title}; red frame: at least one run failed"
    figure.suptitle(textwrap.fill(heading, int(10 * figure.get_figwidth())), fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)
