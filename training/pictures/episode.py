"""One fixed episode under several policies, drawn like on an oscilloscope: panels over time."""

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from ...envs.view.channels import Channel
from ..report import GRID, write_bytes
from .recording import Recording
from .scope import DEMAND, FORBIDDEN, show_both

COLOURS = (  # of the policies, in turn; red marks windows and limits
    "#1f5fa8", "#e08214", "#2e8b57", "#8e44ad", "#16a2b8", "#d65db1", "#8a6d3b", "#9aa51b",
)
STYLES = ("-", (0, (4, 1, 1, 1)))  # of the first and of the second use of a colour
SHADES = 16  # of each colour towards white, in the picture
DASHED = (0, (5, 2))


def draw(path: Path, title: str, traces: Sequence[Recording]) -> None:
    """Draw a panel for each channel and a colour for each policy to `path`, for one task."""
    write_bytes(path, drawn(title, traces))


def drawn(title: str, traces: Sequence[Recording]) -> bytes:
    """Draw an episode and return the bytes of a PNG."""
    shown = traces[0].channels
    figure = Figure((9.5, 0.9 + 0.22 * len(traces) + 1.35 * len(shown)), 110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(len(shown), sharex=True, squeeze=False)[:, 0]
    colours = [COLOURS[i % len(COLOURS)] for i in range(len(traces))]
    for i, (panel, channel) in enumerate(zip(panels, shown, strict=True)):
        _panel(panel, channel, [trace.samples[:, i] for trace in traces], traces, colours)
    panels[0].set_xlim(0.0, 1.01 * max(trace.time[-1] for trace in traces))
    panels[-1].set_xlabel("time (s)")
    figure.align_ylabels(panels)
    keys = [
        Line2D([], [], color=colours[i], ls=_style(i), lw=1.6, label=f"{one.policy}{outcome(one)}")
        for i, one in enumerate(traces)
    ]
    keys += [
        Line2D([], [], color=DEMAND, lw=1.0, ls="--", label="goal or reference"),
        Line2D([], [], color=FORBIDDEN, lw=1.0, ls=DASHED, label="window or limit"),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    figure.suptitle(title, fontsize=11)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    file = io.BytesIO()
    image.quantize(palette=_palette(), dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
    return file.getvalue()


def _style(i: int) -> Any:
    return STYLES[i // len(COLOURS) % len(STYLES)]


def _palette() -> Image.Image:
    """A palette of all colours with their shades, which saves three quarters of the bytes."""
    ink = np.array([to_rgb(colour) for colour in (*COLOURS, DEMAND, FORBIDDEN, "#000000")])
    white = np.linspace(0.0, 1.0, SHADES)[:, None]
    shades = ink[:, None] * (1.0 - white) + white
    image = Image.new("P", (1, 1))
    image.putpalette(np.rint(255.0 * shades).astype(np.uint8).tobytes())
    return image


def outcome(trace: Recording) -> str:
    """How the episode ended, in words; empty for a task without a goal that ends it."""
    if trace.ended:
        return f": {trace.ended} after {trace.time[-1]:.3f} s (cross)"
    done, not_done = trace.words
    if math.isfinite(trace.done):
        return f": {done} after {trace.done:.3f} s (dot)"
    return f": {not_done}" if not_done else ""


def _panel(panel: Axes, channel: Channel, samples, traces, colours) -> None:
    times = [trace.time for trace in traces]
    aims = [one[:, 1] for one in samples]
    _reference_lines(panel, times, aims, colours, DEMAND, "--")
    for sign in (-1.0, 1.0):
        edges = [np.nan_to_num(one[:, 1]) + sign * one[:, 2] for one in samples]
        _reference_lines(panel, times, edges, colours, FORBIDDEN, DASHED)
    for i, (one, trace, colour) in enumerate(zip(samples, traces, colours, strict=True)):
        panel.plot(trace.time, one[:, 0], color=colour, lw=1.3, ls=_style(i))
        if trace.ended:
            panel.plot(trace.time[-1], one[-1, 0], "X", color=colour, ms=8, mec="white", zorder=4)
        elif math.isfinite(trace.done):
            at = min(int(np.searchsorted(trace.time, trace.done, "right")), len(one) - 1)
            panel.plot(trace.time[at], one[at, 0], "o", color=colour, ms=6, mec="white", zorder=4)
    _scale(panel, channel, np.concatenate(samples))
    panel.set_ylabel(channel.label, fontsize=8.5)
    panel.tick_params(labelsize=8)
    panel.grid(**GRID)


def _scale(panel: Axes, channel: Channel, samples: np.ndarray) -> None:
    """Set the range of a panel; `samples` are those of all policies, shape ``(n, 3)``."""
    away, windows = np.abs(samples[:, 0]), samples[np.isfinite(samples[:, 2]), 2]
    window = float(windows.max()) if len(windows) else math.inf
    near = channel.nearest * window
    if near < math.inf and away.min() < near < away.max():
        panel.set_ylim(-near, near)
    elif channel.wide and window < math.inf:
        show_both(panel, float(away.max()), window)
    else:
        panel.margins(y=0.08)


def _reference_lines(panel: Axes, times, lines, colours, colour: str, style: Any) -> None:
    """Draw a line once if it is the same for all policies, otherwise in the colour of each."""
    longest = max(range(len(lines)), key=lambda i: len(lines[i]))
    same = all(np.array_equal(line, lines[longest][: len(line)], equal_nan=True) for line in lines)
    for i in [longest] if same else range(len(lines)):
        own = colour if same else colours[i]
        panel.plot(times[i], lines[i], color=own, lw=1.0, ls=style, zorder=1.5)
