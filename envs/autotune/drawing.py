"""Bode diagrams with margins, of `Response`s."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .margins import LEAST_COHERENCE, TOO_HIGH, Margins

COLOURS = ("#4477aa", "#cc6633", "#228833", "#aa3377")
DOTS_PER_INCH = 110


def draw_bode(responses: Sequence[tuple[str, Any]], path: Path) -> None:
    """Draw gain and phase of both loops with their margins, and the coherence, as a PNG.

    Args:
        responses: names and responses.
        path: path of the picture.
    """
    figure = Figure(figsize=(11, 8), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True, height_ratios=(3, 3, 1.2))
    first = responses[0][1]
    figure.suptitle(
        f"{first.drive} ({first.model}): multisine, {first.amplitude * 100:.3g} % of rated torque, "
        f"in motion at {first.speed:.3g} {first.unit}/s"
    )
    panels: list[list[Axes]] = [list(row) for row in grid]
    loops(panels[0], panels[1], responses)
    for axes in panels[2]:
        for (name, response), colour in zip(responses, COLOURS, strict=False):
            axes.semilogx(response.frequencies, response.coherence, color=colour, label=name)
        axes.axhline(LEAST_COHERENCE, color="grey", lw=0.8, ls=":")
        axes.set(ylim=(0, 1.05), xlabel="frequency (Hz)", ylabel="coherence")
    finish(figure, [axes for row in panels for axes in row], path)


def loops(
    upper: Sequence[Axes], lower: Sequence[Axes], responses: Sequence[tuple[str, Any]]
) -> None:
    """Draw gain into the `upper` and phase into the `lower` panels, for both loops."""
    for (name, response), colour in zip(responses, COLOURS, strict=False):
        kinds = (
            (response.velocity_loop, response.velocity_margins),
            (response.position_loop, response.position_margins),
        )
        for gain, phase, (loop, found) in zip(upper, lower, kinds, strict=True):
            label = f"{name}: {found}"
            loop, degrees = _line(gain, phase, response, loop, color=colour, label=label)
            _mark(gain, phase, found, response.frequencies, loop, degrees, colour)
        for how, other in response.also:
            label = f"{name}, {how}"
            for gain, phase, loop in zip(
                upper, lower, (other.velocity_loop, other.position_loop), strict=True
            ):
                _line(gain, phase, other, loop, color=colour, label=label, ls=":")
    for axes, title in zip(upper, ("velocity loop", "position loop"), strict=True):
        axes.axhline(0.0, color="grey", lw=1)
        axes.set(title=title, ylabel="open loop (dB)", ylim=(-40, 40))
    for axes in lower:
        axes.axhline(-180.0, color="grey", lw=1)
        axes.set(ylabel="phase (degree)", ylim=(-270, 90), yticks=range(-270, 91, 90))


def _line(
    gain: Axes, phase: Axes, response: Any, loop: np.ndarray, **look: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Draw a loop at coherent frequencies; -> its values there, and its phase (degree)."""
    measured = (response.coherence >= LEAST_COHERENCE) & (abs(loop) < TOO_HIGH)
    loop = np.where(measured, loop, np.nan)
    degrees = _unwrapped(loop)
    gain.semilogx(response.frequencies, 20 * np.log10(abs(loop)), **look)
    phase.semilogx(response.frequencies, degrees, **{**look, "label": None})
    return loop, degrees


def _unwrapped(loop: np.ndarray) -> np.ndarray:
    """Phase (degree), between -270 and 90 at the highest frequency with a gain above 1."""
    degrees = np.full(len(loop), np.nan)
    measured = np.isfinite(loop)
    if measured.any():
        turned = np.degrees(np.unwrap(np.angle(loop[measured])))
        above = np.flatnonzero(abs(loop[measured]) >= 1)
        at = turned[above[-1] if len(above) else 0]
        degrees[measured] = turned - 360 * np.ceil((at - 90) / 360)
    return degrees


def _mark(
    gain: Axes, phase: Axes, found: Margins, frequencies: np.ndarray, loop: np.ndarray,
    degrees: np.ndarray, colour: str,
) -> None:
    """Draw the margins at their frequencies, if these were measured."""
    low, high = frequencies[0], frequencies[-1]
    measured = np.isfinite(degrees)
    if low <= found.crossover <= high:
        at = float(np.interp(found.crossover, frequencies[measured], degrees[measured]))
        phase.plot([found.crossover] * 2, [-180, at], color=colour, lw=3, alpha=0.6)
    if low <= found.phase_crossover <= high:
        level = 20 * np.log10(abs(loop[measured]))
        at = float(np.interp(found.phase_crossover, frequencies[measured], level))
        gain.plot([found.phase_crossover] * 2, [at, 0], color=colour, lw=3, alpha=0.6)


def finish(figure: Figure, panels: Sequence[Any], path: Path) -> None:
    """Add grids and legends, and write the file."""
    for axes in panels:
        axes.grid(alpha=0.3, which="both")
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_tuned(tuned: Any, path: Path) -> None:
    """Draw a `Tuned` before and after: loops with margins, step, move and following error."""
    figure = Figure(figsize=(12, 11), layout="constrained")
    rows = figure.subplots(4, 2, height_ratios=(3, 2.4, 2.4, 2.4))
    responses = [("before", tuned.before), ("after", tuned.after)]
    loops(list(rows[0]), list(rows[1]), responses)
    for axes in (*rows[0], *rows[1]):
        axes.set(xlabel="frequency (Hz)")
    (step, torque), (move, error) = rows[2], rows[3]
    small, unit = 1e3, f"m{tuned.unit}"
    trials = [("before", tuned.trial_before), ("after", tuned.trial_after)]
    for (name, trial), colour in zip(trials, COLOURS, strict=False):
        step.plot(1e3 * trial.step_time, trial.step_velocity, color=colour, label=name)
        torque.plot(trial.time, trial.torque, color=colour, label=name, lw=0.8)
        error.plot(trial.time, small * trial.error, color=colour, label=name, lw=0.8)
        move.plot(trial.time, small * trial.demand, color=colour, label=name)
    time = trials[-1][1].step_time
    step.plot(1e3 * time, time >= 0, "k--", lw=1, label="demand")
    step.set(title="small step of the velocity", xlabel="time (ms)", ylabel="share of the step")
    move.set(title="move", xlabel="time (s)", ylabel=f"position demand ({unit})")
    torque.set(title="torque command on the move", xlabel="time (s)", ylabel="Nm")
    error.set(title="following error on the move", xlabel="time (s)", ylabel=unit)
    figure.suptitle(
        f"{tuned.name} ({tuned.model}): asked {tuned.asked.gain:g} dB and {tuned.asked.phase:g}°, "
        + ("reached" if tuned.reached else "not reached")
    )
    finish(figure, [axes for row in rows for axes in row], path)
