"""Pictures that compare a twin with the measurement, and a page that assesses it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .fit import Fitted

INK, SOFT = "#1f5fa8", "#d1721e"
GRID: Any = {"alpha": 0.3, "lw": 0.6}
PICTURES = ("motion.png", "friction.png", "spectrum.png")


def report(folder: Path, fitted: Fitted, content: Mapping[str, Any]) -> list[Path]:
    """Write ``report.md`` and its pictures, and return the paths."""
    folder = Path(folder)
    for name, draw in zip(PICTURES, (_motion, _friction, _spectrum), strict=True):
        draw(folder / name, fitted)
    rows = "".join(
        f"| {name} | {row['value']:.4g} | {row['low']:.4g} | {row['high']:.4g} | {row['unit']} |\n"
        for name, row in content["parameters"].items()
    )
    held = content["held_out"]
    unit = fitted.unit
    lines = [
        f"# Twin of {', '.join(each['name'] for each in content['logs']) or 'a log'}\n",
        f"**{content['said']}.**\n",
        f"Drive {content['drive']}, mechanics {content['mechanics']}; a set-point appears in "
        f"the samples {1e3 * content['lag']:.3g} ms later.\n",
        f"| parameter | value | 95 % from | to | unit |\n|---|---:|---:|---:|---|\n{rows}",
        f"Held out: position {held['position_rms']:.3g} {unit} rms (floor {held['floor']:.3g}), "
        f"torque {held['torque_rms']:.3g} Nm rms (floor {held['floor_torque']:.3g}), "
        f"{held['fit']:.4g} % of the motion; {100 * held['following_error_left']:.3g} % of the "
        f"following error and {100 * held['torque_left']:.3g} % of the torque are left over. "
        f"Fitted: position {held['fitted_position_rms']:.3g} {unit} rms.\n",
        "".join(f"- {each}\n" for each in (*content["doubts"], *content["notes"])),
        "![measured and simulated](motion.png)\n",
        "![friction](friction.png) ![spectrum](spectrum.png)\n",
    ]
    if len(content["tried"]) > 1:
        lines.insert(2, "Tried: " + ", ".join(
            f"{name} ({each['ratio']:.3g} times the floor)"
            for name, each in content["tried"].items()
        ) + ".\n")
    (folder / "report.md").write_text("\n".join(lines), encoding="utf-8")
    return [folder / "report.md", *(folder / name for name in PICTURES)]


def _figure(rows: int, columns: int, size: tuple[float, float]) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, sharex=rows > 1, squeeze=False)


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _motion(path: Path, fitted: Fitted) -> None:
    """Plot position, following error, torque and residuals of the last log."""
    experiment, run = fitted.whole[-1], fitted.simulated[-1]
    cut = fitted.cuts[-1]
    scale, unit = (1e3, "mm") if fitted.unit == "m" else (1.0, "rad")
    fine, small = (1e6, "µm") if fitted.unit == "m" else (1e6, "µrad")
    time = experiment.time
    figure, axes = _figure(4, 1, (9.0, 9.0))
    panels = axes[:, 0]
    panels[0].plot(time, scale * experiment.position, color=INK, lw=1.6, label="measured")
    panels[0].plot(time, scale * run.position[0], color=SOFT, lw=0.9, label="twin")
    panels[0].plot(time, scale * run.demand[0], color="0.4", lw=0.7, ls="--", label="demand")
    panels[0].set_ylabel(f"position ({unit})")
    panels[1].plot(time, fine * (run.demand[0] - experiment.position), color=INK, lw=1.2)
    panels[1].plot(time, fine * (run.demand[0] - run.position[0]), color=SOFT, lw=0.8)
    panels[1].set_ylabel(f"following error ({small})")
    panels[2].plot(time, experiment.torque, color=INK, lw=1.2)
    panels[2].plot(time, run.torque[0], color=SOFT, lw=0.8)
    panels[2].set_ylabel("torque (Nm)")
    left = fine * experiment.residuals(run.position[0], run.torque[0])[:, 0]
    panels[3].plot(time, left, color="0.3", lw=0.7)
    floor = fine * fitted.floor_position
    panels[3].axhspan(-2 * floor, 2 * floor, color=INK, alpha=0.12, lw=0)
    panels[3].set_ylabel(f"measured − twin ({small})")
    panels[3].set_xlabel("time (s)")
    for panel in panels:
        panel.grid(**GRID)
        if 0.0 < cut < time[-1]:
            panel.axvline(cut, color="0.5", lw=0.8, ls=":")
    panels[0].legend(loc="upper right", fontsize=8, ncols=3)
    panels[0].set_title(
        f"{experiment.name}: {fitted.verdict}"
        + (", right of the dotted line held out" if 0 < cut < time[-1] else ""), fontsize=10,
    )
    _save(figure, path)


def _friction(path: Path, fitted: Fitted) -> None:
    """Plot the torque without inertia over the speed, and the identified friction law."""
    assert fitted.candidates is not None
    gear = abs(fitted.candidates.joint.gear)
    speed, torque = fitted.rough.curve
    figure, axes = _figure(1, 1, (5.0, 3.6))
    panel = axes[0, 0]
    unit = "m/s" if fitted.unit == "m" else "rad/s"
    force = "N" if fitted.unit == "m" else "Nm"
    panel.plot(speed / gear, torque * gear, ".", ms=1.5, color=INK, alpha=0.4, label="measured")
    at = np.linspace(float(speed.min()), float(speed.max()), 200) / gear
    law = fitted.values["coulomb_friction"] * np.sign(at) + fitted.values["viscous_friction"] * at
    panel.plot(at, law - fitted.values.get("load_force", 0.0) + _weight(fitted), color=SOFT,
               lw=1.4, label="twin: Coulomb and viscous")
    panel.set_xlabel(f"speed ({unit})")
    panel.set_ylabel(f"torque without inertia ({force})")
    panel.grid(**GRID)
    panel.legend(fontsize=8)
    _save(figure, path)


def _weight(fitted: Fitted) -> float:
    """The constant force that the regression found besides the load force: gravity (N or Nm)."""
    assert fitted.candidates is not None
    gear = fitted.candidates.joint.gear
    return fitted.rough.load * gear + fitted.values.get("load_force", 0.0)


def _spectrum(path: Path, fitted: Fitted) -> None:
    """Plot the frequency response from torque to acceleration excited by the moves."""
    assert fitted.candidates is not None
    gear = fitted.candidates.joint.gear
    figure, axes = _figure(1, 1, (5.0, 3.6))
    panel = axes[0, 0]
    experiment, run = fitted.whole[-1], fitted.simulated[-1]
    for position, torque, color, label in (
        (experiment.position, experiment.torque, INK, "measured"),
        (run.position[0], run.torque[0], SOFT, "twin"),
    ):
        period, (angle, even_torque) = experiment.even(position * gear, torque)
        frequency, gain = _response(period, angle, even_torque)
        panel.loglog(frequency, gain, color=color, lw=1.2, label=label)
    panel.set_xlabel("frequency (Hz)")
    panel.set_ylabel("acceleration over torque (1/kg·m²)")
    panel.grid(which="both", **GRID)
    panel.legend(fontsize=8)
    _save(figure, path)


def _response(
    period: float, position: np.ndarray, torque: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gain by Welch's method with half-overlapping windows."""
    count = len(position)
    length = min(1 << int(np.log2(max(count // 4, 16))), 1024)
    window = np.hanning(length)
    cross: Any = 0.0
    power: Any = 0.0
    for begin in range(0, count - length + 1, length // 2):
        part = slice(begin, begin + length)
        line = np.polyfit(np.arange(length), position[part], 1)
        p = np.fft.rfft(window * (position[part] - np.polyval(line, np.arange(length))))
        t = np.fft.rfft(window * (torque[part] - torque[part].mean()))
        cross = cross + p * np.conj(t)
        power = power + np.abs(t) ** 2
    frequency = np.fft.rfftfreq(length, period)
    inside = slice(2, max(3, int(0.4 * length)))
    gain = np.abs(cross) / np.maximum(power, 1e-30) * (2 * np.pi * frequency) ** 2
    return frequency[inside], np.maximum(np.asarray(gain)[inside], 1e-6)
