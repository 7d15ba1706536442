"""The standard picture of a motion: position, velocity, torque, following error, states and bits.

References are dashed, measurements solid.
"""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from ..drive.words import MODE_ABBREVIATION, MODE_BITS, Mode, State, Statusword, state_of

BLUE, ORANGE, GREY, RED = "#1f5fa8", "#d9822b", "#8a8f98", "#c0392b"
STATE_COLOUR = {
    State.NOT_READY_TO_SWITCH_ON: "#d5d8dc",
    State.SWITCH_ON_DISABLED: "#aeb6bf",
    State.READY_TO_SWITCH_ON: "#f7dc6f",
    State.SWITCHED_ON: "#f5b041",
    State.OPERATION_ENABLED: "#58b368",
    State.QUICK_STOP_ACTIVE: "#e67e22",
    State.FAULT_REACTION_ACTIVE: "#e74c3c",
    State.FAULT: "#922b21",
}
# statusword bits drawn as lines, from top to bottom
BITS = (
    (Statusword.TARGET_REACHED, 0),
    (Statusword.MODE_12, 1),
    (Statusword.MODE_13, 2),
    (Statusword.INTERNAL_LIMIT_ACTIVE, None),
    (Statusword.WARNING, None),
)


def draw(data: dict[str, np.ndarray], phases: list[Any], path: Path, title: str) -> Path:
    """Draw a trace with the channels of the demo, position units being µm, to `path`."""
    time = data["time"]
    figure, axes = plt.subplots(
        6, 1, figsize=(13, 12.5), sharex=True, layout="constrained",
        gridspec_kw={"height_ratios": [3, 2.4, 2.4, 2.4, 0.75, 1.7]},
    )  # fmt: skip
    position, velocity, torque, error, states, bits = axes
    _pair(position, time, data["position_demand_value"] / 1e3, data["position_actual_value"] / 1e3)
    position.set_ylabel("position (mm)")
    _pair(velocity, time, data["velocity_demand_value"] / 1e6, data["velocity_actual_value"] / 1e6)
    velocity.set_ylabel("velocity (m/s)")
    _torque(torque, time, data)
    _following_error(error, time, data)
    _states(states, time, data["statusword"])
    _bits(bits, time, data["statusword"], data["modes_of_operation_display"])
    for panel in axes[:4]:
        panel.grid(alpha=0.3)
        panel.legend(loc="upper left", ncols=4, fontsize=8, framealpha=0.9)
    _phases(axes, time, phases)
    bits.set_xlabel("time (s)")
    position.set_xlim(time[0], time[-1])
    figure.suptitle(title, fontsize=13, fontweight="bold")
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _pair(panel, time, demand, actual) -> None:
    panel.plot(time, actual, color=BLUE, lw=1.4, label="actual")
    panel.plot(time, demand, color=ORANGE, lw=1.1, ls="--", label="demand")
    panel.margins(y=0.18)


def _torque(panel, time, data) -> None:
    positive, negative = data["axis.torque_limit_positive"], data["axis.torque_limit_negative"]
    top = 1.15 * max(positive.max(), negative.max())
    panel.fill_between(time, positive, top, color=RED, alpha=0.13, lw=0, label="beyond the limit")
    panel.fill_between(time, -top, -negative, color=RED, alpha=0.13, lw=0)
    panel.plot(time, data["axis.torque"], color=BLUE, lw=1.1, label="at the shaft")
    panel.set_ylim(-top, top)
    panel.set_ylabel("torque (Nm)")


def _following_error(panel, time, data) -> None:
    error = data["following_error_actual_value"] / 1e3
    window = data["following_error_window"] / 1e3
    panel.plot(time, error, color=BLUE, lw=1.1, label="demand - actual")
    panel.plot(time, window, color=RED, lw=1, ls=":", label="following error window 6065h")
    panel.plot(time, -window, color=RED, lw=1, ls=":")
    panel.margins(y=0.12)
    panel.set_ylabel("following\nerror (mm)")


def _spans(values: np.ndarray):
    """Runs of equal values: (value, first, last + 1)."""
    edges = np.flatnonzero(np.diff(values)) + 1
    starts = [0, *edges.tolist()]
    return [
        (values[start], start, end)
        for start, end in zip(starts, [*starts[1:], len(values)], strict=True)
    ]


def _states(panel, time, statusword) -> None:
    shown = [state_of(int(word)) for word in statusword]
    numbers = np.array([-1 if state is None else int(state) for state in shown])
    seen = {}
    for number, start, end in _spans(numbers):
        colour = STATE_COLOUR[State(number)] if number >= 0 else "black"
        panel.axvspan(time[start], time[min(end, len(time) - 1)], color=colour, lw=0)
        seen[State(number).name.replace("_", " ") if number >= 0 else "INVALID"] = colour
    handles = [plt.Rectangle((0, 0), 1, 1, color=colour) for colour in seen.values()]
    panel.figure.legend(
        handles, seen.keys(), loc="outside lower center", ncols=len(seen), fontsize=8, frameon=False
    )
    panel.set_yticks([])
    panel.set_ylabel("state", rotation=0, ha="right", va="center")


def _bits(panel, time, statusword, modes) -> None:
    statusword = statusword.astype(int)
    for row, (mask, place) in enumerate(BITS):
        level = (statusword & mask != 0) * 0.7 - row
        panel.fill_between(time, -row, level, step="post", color=BLUE, alpha=0.75, lw=0)
        panel.axhline(-row, color=GREY, lw=0.5)
        if place is None or place == 0:
            continue
        for mode, start, end in _spans(modes):
            name = MODE_BITS.get(Mode(int(mode)), ("", "", ""))[place].replace("_", " ")
            left, right = time[start], time[min(end, len(time) - 1)]
            if name and right - left > 0.008 * len(name) * (time[-1] - time[0]):
                panel.text(left, 0.36 - row, f" {name}", fontsize=7, va="center", color="#333333")
    for mode, start, _ in _spans(modes):
        panel.text(
            time[start], 1.12, f" {MODE_ABBREVIATION.get(Mode(int(mode)), '?')}", fontsize=8,
            va="center", fontweight="bold",
        )  # fmt: skip
        panel.axvline(time[start], color=GREY, lw=0.8)
    names = ["target reached", "bit 12", "bit 13", "internal limit", "warning"]
    panel.set_yticks([0.3 - row for row in range(len(BITS))], names, fontsize=8)
    panel.set_ylim(-len(BITS) + 0.9, 1.5)
    panel.tick_params(axis="y", length=0)


def _phases(axes, time, phases) -> None:
    for phase in phases:
        start, end = time[phase.start], time[min(phase.end, len(time) - 1)]
        for panel in axes[:4]:
            panel.axvline(start, color=GREY, lw=0.8, ls=(0, (2, 2)))
        narrow = end - start < 0.05 * (time[-1] - time[0])
        axes[0].annotate(
            phase.name, ((start + end) / 2, 1.0), xycoords=("data", "axes fraction"),
            xytext=(0, 4), textcoords="offset points", ha="center", va="bottom", fontsize=8,
            rotation=60 if narrow else 0,
        )  # fmt: skip
