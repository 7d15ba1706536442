"""A trace as an oscilloscope shows it: a panel for each channel over the time."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...drive.trace import Trace


def draw(trace: Trace, path: Path) -> None:
    """Draw the channels of a trace to `path`, a PNG. Needs no display."""
    data = trace.arrays()
    figure = Figure(figsize=(11, 1.0 + 1.7 * len(trace.channels)), layout="constrained")
    panels = figure.subplots(len(trace.channels), sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, trace.channels, strict=True):
        axes.plot(data["time"], data[name], lw=1.0, color="#1f5fa8", drawstyle="steps-post")
        axes.set_title(f"{name} ({trace.units[name]})" if trace.units[name] else name, fontsize=9)
        axes.grid(alpha=0.3)
    panels[-1].set_xlabel("time (s)")
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
