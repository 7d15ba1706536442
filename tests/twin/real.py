"""Twins of two published logs of real spindles (maxon EPOS4), as rows of the campaign's file.

    python tests/twin/real.py FOLDER ROWS.jsonl

of a folder with axis_a_steps.csv and axis_d_profile.csv: time_ms, target_mm, demand_mm, actual_mm
and current_mA. Motors are those of their data sheets, position controllers those listed with the
logs; of axis d resistance and inductance of the winding are guesses.
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import at_rest
import numpy as np
from campaign import CODE, _short, rows

from servogym.envs.twin import logs
from servogym.envs.twin.families import FAMILIES
from servogym.envs.twin.fit import fit

FREE = ("supply_voltage", "pid_gain", "pid_integral_gain", "pid_derivative_gain")
COLUMNS = ("time=time_ms:ms,target_position={}:mm,position_actual_value=actual_mm:mm,"
           "current_actual_value=current_mA:mA")
AXES = {  # log, set-points, steps, increments a turn and a mm, winding, controller, currents
    "axis a": {
        "file": "axis_a_steps.csv", "set_points": "target_mm", "hold": True,
        "increments": (24, 85.58), "winding": (0.0429, 0.782, 0.877e-3),
        "pid": (660, 32_117, 9), "currents": (2.48, 12.0),
    },
    "axis d": {
        "file": "axis_d_profile.csv", "set_points": "demand_mm", "hold": False,
        "increments": (48, 50.95), "winding": (0.070, 0.35, 0.4e-3),
        "pid": (3_135, 124_158, 48), "currents": (6.29, 18.0),
    },
}


def twin(folder, file, set_points, hold, increments, winding, pid, currents):
    """The twin of one of them."""
    a_turn, a_mm = increments
    constant, resistance, inductance = winding
    p, i, d = pid  # mA/rad, mA/(rad s), mA s/rad
    rated, highest = currents
    limit = round(1e3 * highest / rated)
    chosen = FAMILIES["spindle"].given(
        {
            "feed_constant": 1e-3 * a_turn / a_mm, "tuned": False, "dc_link_voltage": 48.0,
            "motor_torque_constant": constant, "motor_resistance": resistance,
            "motor_inductance": inductance,
        },
        {
            "control_structure": 1, "pid_gain": round(1e3 * p * constant),
            "pid_integral_gain": round(i * constant), "pid_derivative_gain": round(
                1e3 * d * constant),
            "acceleration_feed_forward": 0, "velocity_feed_forward": 0, "link_capacitance": 0,
            "motor_rated_current": round(1e3 * rated),
            "motor_rated_torque": round(1e3 * rated * constant), "max_current": limit,
            "max_torque": limit, "encoder_increments": a_turn,
        },
    )
    found = logs.read(
        [folder / file], chosen.make("generic"), "generic", "x", mode=8, cycle=5e-4, hold=hold,
        columns=COLUMNS.format(set_points), torque_constant=constant,
    )
    return fit(found, "generic", replace(chosen, extra=FREE), gains_known=True)


def row(name, folder):
    """What is kept of it: errors in increments, shares of following error and torque."""
    begin = time.process_time()
    fitted = twin(folder, **AXES[name])
    cost = time.process_time() - begin
    (whole,), (run,), (cut,) = fitted.whole, fitted.simulated, fitted.cuts
    moving = np.abs(np.gradient(run.demand[0], whole.time)) > 1e-3 * at_rest.MOVING
    moving &= whole.time >= cut
    left = whole.torque - run.torque[0]
    held = fitted.shares()

    def rms(values):
        return float(np.sqrt(np.mean(values**2)))

    return _short({
        "series": name, "seed": 0, "code": CODE, "verdict": fitted.verdict, "cpu": round(cost, 1),
        "increment": fitted.increment, "fitted": fitted.shares(False)["position_rms"],
        "held_out": held["position_rms"], "following_error": held["following_error"],
        "torque": held["torque"], "values": fitted.values,
    } | ({} if AXES[name]["hold"] else {
        "torque_in_motion": rms(left[moving]) / rms(whole.torque[moving]),
        "log": at_rest.figures(folder / AXES[name]["file"])[0],
    }))


def main(folder, file):
    kept = [each for each in rows(Path(file)) if each["series"] not in AXES]
    kept += [row(name, Path(folder)) for name in AXES]
    text = "".join(json.dumps(each, ensure_ascii=False) + "\n" for each in kept)
    Path(file).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
