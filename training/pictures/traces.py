"""A recording drawn like on an oscilloscope: a panel for each channel over time."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ...drive.kernel.words import State, state_of
from ...drive.trace import Edge, Recording
from ...envs.view.overlay import STATE_COLOUR
from .scope import runs

LINE, MARK = "#1f5fa8", "#c0561a"


def draw(recording: Recording, path: Path) -> None:
    """Draw the channels of a recording to `path`, a PNG. Needs no display.

    The picture shows the time and level of the trigger, and the states behind the statusword.
    """
    data = recording.arrays()
    rows = len(recording.channels)
    figure = Figure(figsize=(11, 1.0 + 1.7 * rows), layout="constrained")
    panels = figure.subplots(rows, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, recording.channels, strict=True):
        unit = recording.units[name]
        axes.set_title(f"{name} ({unit})" if unit else name, fontsize=9)
        axes.grid(alpha=0.3)
        if name == "statusword":
            _states(axes, data["time"], data[name])
        else:
            axes.plot(data["time"], data[name], lw=1.0, color=LINE, drawstyle="steps-post")
            axes.ticklabel_format(axis="y", useOffset=False)
        _trigger(axes, recording, name)
    panels[-1].set_xlabel("time (s)")
    figure.savefig(path, dpi=110)


def _trigger(axes: Axes, recording: Recording, name: str) -> None:
    trigger = recording.trigger
    if trigger is None or recording.trigger_time is None:
        return
    axes.axvline(recording.trigger_time, color=MARK, lw=0.9)
    if trigger.channel == name != "statusword" and trigger.edge != Edge.CHANGE:
        axes.axhline(trigger.level, color=MARK, lw=0.8, ls="--")


def _states(axes: Axes, time: np.ndarray, words: np.ndarray) -> None:
    """Draw each statusword that occurs as a level, with its state in the background."""
    valid = np.isfinite(words)
    seen, level = np.unique(words[valid].astype(int), return_inverse=True)
    if not len(seen):
        return
    levels = np.full(len(words), np.nan)
    levels[valid] = level
    axes.plot(time, levels, lw=1.0, color=LINE, drawstyle="steps-post")
    axes.set_yticks(range(len(seen)), [f"{word:04X}h" for word in seen], fontsize=8)
    axes.set_ylim(-0.5, len(seen) - 0.5)
    state = np.full(len(words), -1)
    states = [state_of(word) for word in seen.tolist()]
    state[valid] = np.array([-1 if each is None else each for each in states])[level]
    ends = np.append(time, time[-1])
    for first, behind in runs(state):
        if state[first] >= 0:
            colour = STATE_COLOUR[State(state[first])]
            axes.axvspan(ends[first], ends[behind], color=colour, alpha=0.45, lw=0)
    key = [
        Patch(color=STATE_COLOUR[s], alpha=0.45, label=s.name.lower().replace("_", " "))
        for s in map(State, np.unique(state[state >= 0]))
    ]
    axes.figure.legend(
        handles=key, loc="outside lower center", ncols=min(max(len(key), 1), 5), frameon=False,
        fontsize=8,
    )
