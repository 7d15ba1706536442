"""Why no twin foretells the whole torque of an axis that swings between its increments: a picture.

    python tests/twin/at_rest.py LOG.csv OUT.png

of a table with time_ms, target_mm, demand_mm, actual_mm and current_mA, moves alike. Prints what it
shows: how much of the current's square is of the time at rest, and how far two moves differ there.
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


def main(log, picture):
    with open(log, encoding="utf-8") as text:
        rows = list(csv.DictReader(text))
    time, target, demand, actual, current = (
        np.array([float(row[name]) for row in rows])
        for name in ("time_ms", "target_mm", "demand_mm", "actual_mm", "current_mA"))
    time, current = 1e-3 * time, 1e-3 * current
    moving = np.abs(np.gradient(demand, time)) > MOVING
    rest = ~moving & (np.abs(actual - target) < BAND)
    away = INCREMENTS * (actual - target)
    share = np.sum(current[rest] ** 2) / np.sum(current**2)
    slope, offset = np.polyfit(away[rest], current[rest], 1)
    left = current[rest] - slope * away[rest] - offset
    explained = 1 - np.var(left) / np.var(current[rest])
    steps = np.flatnonzero(np.diff(target) > 0) + 1
    length = int(np.diff(steps).min()) // 2
    folded = np.array([current[n : n + length] for n in steps if n + length <= len(current)])
    phase = np.array([demand[n + 2] for n in steps[: len(folded)]])  # how late a move is stamped
    alike = folded[np.abs(phase - np.median(phase)) < 0.03]
    print(f"rms {np.std(current[rest]):.2f} A at rest, {np.std(current[moving]):.2f} A in motion; "
          f"{100 * share:.0f} % of the square is of the time at rest")
    print(f"at rest {100 * explained:.0f} % of the current goes with the position, "
          f"{slope:.2f} A an increment")
    print(f"{len(alike)} moves stamped alike differ by {np.median(alike[:, 3:11].std(0)):.3f} A "
          f"while they travel, by {np.median(alike[:, 15:].std(0)):.2f} A at rest")
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    after = 1e3 * (time[steps[0] : steps[0] + length] - time[steps[0]])
    panels[0].plot(after, alike.T, color="#1f5fa8", lw=0.8, alpha=0.7)
    panels[0].set_xlabel("time after the set-point (ms)")
    panels[0].set_ylabel("current (A)")
    panels[0].set_title(f"{len(alike)} moves stamped alike: alike until they stand", fontsize=9)
    jitter = np.random.default_rng(0).uniform(-0.2, 0.2, np.count_nonzero(rest))
    panels[1].plot(away[rest].round() + jitter, current[rest], ".", ms=3, color="#d1721e")
    panels[1].set_xlabel("position at rest − target (increments)")
    panels[1].set_title(f"at rest: {100 * explained:.0f} % of the current goes with the position",
                        fontsize=9)
    for panel in panels:
        panel.grid(alpha=0.3, lw=0.6)
    figure.savefig(Path(picture), dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main(*sys.argv[1:])
