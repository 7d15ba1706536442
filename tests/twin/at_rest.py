"""Why no twin foretells the whole torque of an axis that swings between its increments: a picture.

    python tests/twin/at_rest.py LOG.csv OUT.png

of a table with time_ms, target_mm, demand_mm, actual_mm and current_mA, moves alike. Prints what it
shows: how much of the current's square is of the time at rest, how far two moves differ there, and
which share of a move's current the mean of the others leaves.
"""

import csv
import sys
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

INCREMENTS = 50.95  # per mm
MOVING, BAND = 1.0, 5.0  # mm/s of the demand; mm about the target that are still at rest


def figures(log):
    """What the log shows: rms and shares of the current (A), and what the picture draws."""
    with open(log, encoding="utf-8") as text:
        rows = list(csv.DictReader(text))
    time, target, demand, actual, current = (
        np.array([float(row[name]) for row in rows])
        for name in ("time_ms", "target_mm", "demand_mm", "actual_mm", "current_mA"))
    time, current = 1e-3 * time, 1e-3 * current
    moving = np.abs(np.gradient(demand, time)) > MOVING
    rest = ~moving & (np.abs(actual - target) < BAND)
    away = INCREMENTS * (actual - target)
    slope, offset = np.polyfit(away[rest], current[rest], 1)
    left = current[rest] - slope * away[rest] - offset
    found = {
        "rest": np.std(current[rest]), "motion": np.std(current[moving]),
        "share": np.sum(current[rest] ** 2) / np.sum(current**2),
        "explained": 1 - np.var(left) / np.var(current[rest]),
    }
    for name, way in (("out", 1), ("back", -1)):
        steps = np.flatnonzero(np.sign(np.diff(target)) == way) + 1
        length = int(np.diff(steps).min()) // 2  # back in the other half
        begins = target[steps - 1]
        steps = steps[(steps + length <= len(current)) & (begins == np.median(begins))]
        folded = np.array([current[n : n + length] for n in steps])
        on = np.array([moving[n : n + length] for n in steps]).any(axis=0)
        others = (folded.sum(axis=0) - folded) / (len(folded) - 1)
        found[name] = np.sqrt(np.mean((folded - others)[:, on] ** 2) / np.mean(folded[:, on] ** 2))
        if way > 0:
            phase = np.array([demand[n + 2] for n in steps])  # how late a move is stamped
            alike = folded[np.abs(phase - np.median(phase)) < 0.03]
    found |= {"alike": len(alike), "travel": np.median(alike[:, 3:11].std(0)),
              "stand": np.median(alike[:, 15:].std(0))}
    drawn = 1e3 * (time[: alike.shape[1]] - time[0]), alike, away[rest], current[rest]
    return {name: float(value) for name, value in found.items()} | {"alike": len(alike)}, drawn


def main(log, picture):
    found, (after, alike, away, current) = figures(log)
    for name, value in found.items():
        print(f"{name:10s} {value:.3g}")
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    panels[0].plot(after, alike.T, color="#1f5fa8", lw=0.8, alpha=0.7)
    panels[0].set_xlabel("time after the set-point (ms)")
    panels[0].set_ylabel("current (A)")
    panels[0].set_title(f"{len(alike)} moves stamped alike: alike until they stand", fontsize=9)
    jitter = np.random.default_rng(0).uniform(-0.2, 0.2, len(away))
    panels[1].plot(away.round() + jitter, current, ".", ms=3, color="#d1721e")
    panels[1].set_xlabel("position at rest − target (increments)")
    panels[1].set_title(f"at rest: {100 * found['explained']:.0f} % of the current goes with the "
                        "position", fontsize=9)
    for panel in panels:
        panel.grid(alpha=0.3, lw=0.6)
    figure.savefig(Path(picture), dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main(*sys.argv[1:])
