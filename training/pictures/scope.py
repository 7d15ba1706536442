"""The standard picture of a motion: position, velocity, torque, following error, states and bits.

Demands are dashed, actual values solid. Below the curves are the state, the mode, and the bits of
the statusword as on a logic analyser, each under the name that it has in that mode.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ...drive.kernel.words import Mode, State, Statusword, mode_words, state_of, statusword_names
from ...envs.view.overlay import STATE_COLOUR

SIZE, DPI = (13.0, 9.4), 125  # inches, dots per inch
EDGES = {"left": 0.165, "right": 0.988, "top": 0.905, "bottom": 0.085, "hspace": 0.09}
HEIGHTS = (2.0, 1.5, 1.5, 1.8, 0.62, 2.2)
DEMAND, ACTUAL, TORQUE, ERROR, FORBIDDEN = "#1a1a1a", "#4d9fd6", "#c0561a", "#6a3d9a", "#d62728"
MODE_COLOUR = ("#fdf0d5", "#efe3f5")  # in turn
# statusword bits drawn as lines, from top to bottom; 10, 12 and 13 have a line for each name
BITS = (Statusword.VOLTAGE_ENABLED, Statusword.WARNING, Statusword.INTERNAL_LIMIT_ACTIVE)
BITS_OF_MODE = (Statusword.TARGET_REACHED, Statusword.MODE_12, Statusword.MODE_13)


def draw(data: dict[str, np.ndarray], phases: list[Any], path: Path, title: str) -> Path:
    """Draw a trace with the channels of the demo, position units being µm, to `path`.

    `phases` have a `name` and `start` and `end`, sample numbers. Needs no display.

    Raises:
        ValueError: the trace is empty.
    """
    if len(data["time"]) == 0:
        raise ValueError("the trace is empty: sample at least once, then draw")
    figure = Figure(SIZE, DPI)
    panels = figure.subplots(
        len(HEIGHTS), sharex=True, height_ratios=HEIGHTS, gridspec_kw=EDGES, squeeze=True
    )
    time = data["time"]
    panels[0].set_xlim(time[0], max(time[-1], time[0] + 1e-6))
    _position(panels[0], data)
    _velocity(panels[1], data)
    _torque(panels[2], data)
    _following_error(panels[3], data)
    _spans(panels[4], data)
    _bits(panels[5], data)
    _phases(panels, time, phases)
    figure.align_ylabels(panels[:4])
    figure.text(EDGES["left"], 0.973, title, fontsize=12, weight="bold")
    figure.savefig(path)
    return path


def _finish(panel: Axes, label: str) -> None:
    """Name the quantity and its unit; the legend is in the margin, where it hides nothing."""
    panel.set_ylabel(label, fontsize=9)
    panel.grid(color="#e4e4e4", lw=0.6)
    panel.tick_params(labelsize=8)
    panel.legend(loc="center right", bbox_to_anchor=(-0.065, 0.5), frameon=False, fontsize=8)


def _pair(panel: Axes, time, demand, actual) -> None:
    panel.plot(time, actual, color=ACTUAL, lw=2.6, label="actual")
    panel.plot(time, demand, color=DEMAND, lw=1.1, ls="--", label="demand")
    panel.margins(y=0.08)


def _position(panel: Axes, data) -> None:
    time = data["time"]
    demand, actual = data["position_demand_value"] / 1e3, data["position_actual_value"] / 1e3
    farthest = 2e-3 * np.abs(data["velocity_demand_value"]).max() * np.diff(time)
    for sample in np.flatnonzero(np.abs(np.diff(demand)) > farthest + 0.5) + 1:
        new = actual[sample]
        demand[sample] = actual[sample] = np.nan  # the zero moved, not the axis
        panel.annotate(
            "zero set ", (time[sample], new), (0, 3), textcoords="offset points",
            fontsize=7.5, ha="right",
        )
    _pair(panel, time, demand, actual)
    _finish(panel, "position (mm)")


def _velocity(panel: Axes, data) -> None:
    demand, actual = data["velocity_demand_value"] / 1e6, data["velocity_actual_value"] / 1e6
    _pair(panel, data["time"], demand, actual)
    _finish(panel, "velocity (m/s)")


def _torque(panel: Axes, data) -> None:
    time = data["time"]
    upper, lower = data["axis.torque_limit_positive"], -data["axis.torque_limit_negative"]
    top = 1.25 * max(upper.max(), -lower.min(), 1e-9)
    panel.plot(time, data["axis.torque"], color=TORQUE, lw=1.5, label="actual")
    panel.fill_between(time, upper, top, color=FORBIDDEN, alpha=0.16, lw=0, label="over limit")
    panel.fill_between(time, lower, -top, color=FORBIDDEN, alpha=0.16, lw=0)
    panel.set_ylim(-top, top)
    _finish(panel, "torque (Nm)")


def _following_error(panel: Axes, data) -> None:
    time, error = data["time"], data["following_error_actual_value"]
    window = data["following_error_window"].astype(float)
    window[window == 0xFFFFFFFF] = np.nan  # switched off
    panel.plot(time, error, color=ERROR, lw=1.5, label="error")
    panel.plot(time, window, color=FORBIDDEN, lw=1.0, ls=(0, (5, 2)), label="window")
    panel.plot(time, -window, color=FORBIDDEN, lw=1.0, ls=(0, (5, 2)))
    _finish(panel, "following error (µm)")
    if np.isfinite(window).all():
        show_both(panel, float(np.abs(error).max()), float(window.max()))


def show_both(panel: Axes, peak: float, window: float) -> None:
    """Scale a panel so that a small error is visible beside a wide window."""
    linear = round_up(peak)
    if linear >= window / 2:
        panel.set_ylim(-1.2 * max(window, peak), 1.2 * max(window, peak))
        return
    panel.set_yscale("symlog", linthresh=linear, linscale=2 * np.log10(window / linear))
    ticks = [-window, -linear, 0, linear, window]
    panel.set_yticks(ticks, [f"{tick:.4g}".replace("-", "−") for tick in ticks])
    panel.minorticks_off()
    panel.set_ylim(-window * 1.5, window * 1.5)
    note = f"linear to ±{linear:g}, logarithmic beyond"
    beside = panel.get_yaxis_transform()
    panel.text(0.994, -linear, note, transform=beside, fontsize=7.5, ha="right")


def round_up(value: float) -> float:
    """The next round number, with at least a twentieth to spare."""
    decade = 10.0 ** np.floor(np.log10(max(value, 1.0)))
    series = decade * np.array([1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 15])
    return float(series[series >= 1.05 * max(value, 1.0)][0])


def runs(values: np.ndarray) -> list[tuple[int, int]]:
    """Stretches of equal values: (first, last + 1)."""
    edges = (np.flatnonzero(np.diff(values)) + 1).tolist()
    return list(zip([0, *edges], [*edges, len(values)], strict=True))


def _spans(panel: Axes, data) -> None:
    """Draw state and mode as coloured spans with their names, and a legend of the states."""
    time = np.append(data["time"], data["time"][-1])
    words, where = np.unique(data["statusword"], return_inverse=True)
    shown = [state_of(int(word)) for word in words]
    states = np.array([-1 if state is None else int(state) for state in shown])[where]
    for first, behind in runs(states):
        name, colour = _state(int(states[first]))
        _span(panel, time[first], time[behind], 1, name, colour)
    modes = data["modes_of_operation_display"]
    for number, (first, behind) in enumerate(runs(modes)):
        mode = Mode(int(modes[first]))
        colour = MODE_COLOUR[number % 2] if mode else "white"
        _span(panel, time[first], time[behind], 0, mode_words(mode).name, colour)
    panel.set_ylim(-0.5, 1.5)
    panel.set_yticks([1, 0], ["state", "mode"], fontsize=8.5)
    panel.tick_params(axis="y", length=0)
    key = [_state(state) for state in np.unique(states).tolist()]
    panel.figure.legend(
        handles=[Patch(color=colour, label=name) for name, colour in key],
        loc="lower left", bbox_to_anchor=(EDGES["left"] - 0.006, 0.0),
        ncols=len(key), frameon=False, fontsize=8, handlelength=1.2,
    )


def _state(number: int) -> tuple[str, str]:
    if number < 0:
        return "no pattern of the standard", "black"
    return State(number).name.lower().replace("_", " "), STATE_COLOUR[State(number)]


def _span(panel: Axes, begin: float, end: float, row: int, name: str, colour: str) -> None:
    panel.barh(row, end - begin, 0.82, begin, color=colour, lw=0)
    text = panel.text((begin + end) / 2, row, name, fontsize=8, ha="center", va="center_baseline")
    box = text.get_window_extent().transformed(panel.transData.inverted())
    if box.width > 0.96 * (end - begin):
        text.remove()


def _bits(panel: Axes, data) -> None:
    """Draw a line for each bit; a bit named by a mode is drawn only while that mode is active."""
    time, words = data["time"], data["statusword"].astype(int)
    modes = data["modes_of_operation_display"]
    rows = [(bit.name.lower(), bit, np.full(len(time), True)) for bit in BITS]
    for bit in BITS_OF_MODE:
        names = {mode: statusword_names(mode)[bit] for mode in dict.fromkeys(modes.tolist())}
        for name in dict.fromkeys(filter(None, names.values())):
            valid = np.isin(modes, [mode for mode, other in names.items() if other == name])
            rows.append((name, bit, valid))
    for row, (_, bit, valid) in enumerate(rows):
        base = -0.34 - row
        level = np.where(valid, base + 0.68 * (words & bit != 0), np.nan)
        panel.axhline(base, color="#dddddd", lw=0.6)
        panel.fill_between(time, base, level, step="post", color=ACTUAL, alpha=0.3, lw=0)
        panel.plot(time, level, drawstyle="steps-post", color=ACTUAL, lw=1.0)
    labels = [f"{name}  bit {bit.bit_length() - 1}" for name, bit, _ in rows]
    panel.set_yticks([-row for row in range(len(rows))], labels, fontsize=8.5)
    panel.set_ylim(0.6 - len(rows), 0.6)
    panel.tick_params(axis="y", length=0)
    panel.tick_params(axis="x", labelsize=8)
    panel.set_xlabel("time (s)")


def _phases(panels, time, phases) -> None:
    """Draw the phases: lines through all panels, and names on top, each in the lowest free row."""
    ends: list[float] = []  # right end of the last name, by row
    for phase in phases:
        start = time[min(phase.start, len(time) - 1)]
        for panel in panels:
            panel.axvline(start, color="#9a9a9a", lw=0.8, zorder=0.5)
        text = panels[0].annotate(
            phase.name, (start, 1.0), (3, 4), xycoords=("data", "axes fraction"),
            textcoords="offset points", fontsize=9,
        )
        box = text.get_window_extent()
        if box.x1 > panels[0].bbox.x1:  # the last name ends with the picture
            text.set(ha="right", position=(-3, 4))
            text.xy, text.xycoords = (1.0, 1.0), "axes fraction"
            box = text.get_window_extent()
        row = next((r for r, end in enumerate(ends) if end < box.x0), len(ends))
        ends[row : row + 1] = [box.x1 + 6]
        text.set_position((text.get_position()[0], 4 + 12 * row))
