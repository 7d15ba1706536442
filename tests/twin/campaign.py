"""Twins of machines with hidden parameters, drawn wide: how near they come, and what it costs.

    python tests/twin/campaign.py FAMILY FIRST LAST [known] [10ms] [true=FAMILY] [drive=MODEL]

A line a seed, and the sums. The log has 0.5 % of its frames missing, stamps that jitter by 0.2 ms
and an encoder with noise of 0.2 to 1 µm. `true` is the family the log comes from, where another one
is fitted to it.
"""

import math
import sys
import time

import numpy as np
from machines import hide, moves

from servogym.drive.wire.recording import Signal
from servogym.envs.engine import parameters
from servogym.envs.engine.replay import Replay
from servogym.envs.twin.experiment import Unusable, experiment
from servogym.envs.twin.families import FAMILIES, GAINS
from servogym.envs.twin.fit import fit

HIDDEN = ("coulomb_friction", "viscous_friction")
READ = ("od.position_actual_value", "od.torque_actual_value", "od.statusword")
SLOW = ("ball_screw", "vertical", "ball_screw_scale")
NAMES = ("position_actual_value", "torque_actual_value", "statusword")


def draw(machine, family, rng, known):
    """Give it hidden parameters; -> their values."""
    hidden = hide(machine, rng, [family.mass, *HIDDEN])
    if family.spring:
        stiffness, damping = family.spring
        low, high = (8e3, 4e5) if stiffness[0] == "l" else (5e4, 1e6)
        k = math.exp(rng.uniform(math.log(low), math.log(high)))
        ratio = rng.uniform(0.01, 0.1)
        spring = {stiffness: k, damping: 2 * ratio * math.sqrt(k * hidden[family.mass])}
        parameters.put(machine, spring)
        hidden |= spring
    if not known:
        hidden |= hide(machine, rng, GAINS, 0.3)
    return hidden


def stream(machine, name, set_points, period, rng, *, dropped=0.005, jitter=2e-4):
    """The signals of a log in csp: what a bus would carry, without its frames."""
    drive = machine.drives[name]
    unit = float(drive.axis.rad_per_position_unit) / machine.joint(name)[0]
    machine.reset({name: float(set_points[0])})
    machine.step()
    here = round(float(set_points[0]) * machine.joint(name)[0] / float(
        drive.axis.rad_per_increment))
    drive.axis.zero_counts, drive.axis.homed = int(drive.axis.counts) - here, 1
    drive.commission({
        "interpolation_time_index": -3, "interpolation_time_period_value": round(period * 1e3),
        "following_error_window": 2**31 - 1,
    })
    per, lead = round(period / machine.cycle_time), round(0.3 / period)
    units = np.round(np.concatenate([np.full(lead, set_points[0]), set_points]) / unit)
    rows_of = Replay(name, ["controlword", "modes_of_operation", "target_position"], READ)
    rows = np.zeros(per * len(units), rows_of.written)
    rows["controlword"], rows["modes_of_operation"] = 15, 8
    rows["controlword"][: 10 * per], rows["controlword"][10 * per : 20 * per] = 6, 7
    rows["target_position"] = np.repeat(units, per)
    arrives = np.arange(len(rows)) % per == 0
    found = rows_of.run([machine], rows, arrives)[0][lead * per :][per - 1 :: per]
    count = len(set_points)
    at = np.arange(count) * period
    sent, heard = rng.random(count) >= dropped, rng.random(count) >= dropped
    late = at + rng.uniform(0, jitter, count)
    signals = {"target_position": Signal(late[sent], units[lead:][sent], "")}
    late = at + period + rng.uniform(0, jitter, count)
    for column, name in zip(READ, NAMES, strict=True):
        signals[name] = Signal(late[heard], found[column].astype(float)[heard], "")
    return signals


def one(seed, fitted_as, *, truth=None, known=True, period=1e-3, drive="generic", seconds=4.0):
    """One machine: a log, a fit, and what they have in common."""
    rng = np.random.default_rng(seed)
    family = FAMILIES[truth or fitted_as]
    machine = family.make(drive)
    hidden = draw(machine, family, rng, known)
    noise = float(rng.uniform(0.2, 1.0)) * 1e-6
    parameters.put(machine, {"encoder_noise": noise}, family.axis)
    machine.couplings["noise_state"] = int(rng.integers(1, 2**62))
    slow = {"speed": (0.05, 0.35), "acceleration": (1, 5)} if family.name in SLOW else {}
    set_points = moves(rng, seconds, period, **slow)
    signals = stream(machine, family.axis, set_points, period, rng)
    chosen = FAMILIES[fitted_as]
    found = experiment(signals, chosen.make(drive), chosen.axis)
    begin = time.process_time()
    twin = fit([found], drive, chosen, gains_known=known)
    cost = time.process_time() - begin
    errors, covered = {}, {}
    for name, value in hidden.items():
        if truth is None and name in twin.values:
            low, high = twin.estimate.interval(name)
            errors[name] = twin.values[name] / value - 1
            covered[name] = low <= value <= high
    floor = math.nan
    if truth is None:
        quiet = twin.candidates.simulate(found, [hidden | {"lag": twin.values["lag"]}])
        held = found.time >= twin.cuts[0]
        floor = float(np.sqrt(np.mean((quiet.position[0] - found.position)[held] ** 2)))
    return twin, errors, covered, floor, cost


def main(words):
    family, first, last = words[0], int(words[1]), int(words[2])
    more = dict(word.split("=") for word in words if "=" in word)
    arguments = {
        "known": "known" in words, "period": 1e-2 if "10ms" in words else 1e-3,
        "truth": more.get("true"), "drive": more.get("drive", "generic"),
    }
    all_errors, all_covered, ratios, verdicts, costs = {}, [], [], [], []
    for seed in range(first, last):
        try:
            twin, errors, covered, floor, cost = one(seed, family, **arguments)
        except Unusable as error:
            verdicts.append("unusable")
            print(seed, error, flush=True)
            continue
        floor = floor if floor == floor else twin.floor_position
        ratios.append(twin.held_position / floor)
        verdicts.append(twin.verdict)
        costs.append(cost)
        all_covered += covered.values()
        for name, error in errors.items():
            all_errors.setdefault(name, []).append(abs(error))
        shown = ", ".join(
            f"{n} {100 * e:+.1f} %{'' if covered[n] else ' !'}" for n, e in errors.items()
        )
        print(
            f"{seed} {family}: held out {1e6 * twin.held_position:.2f} µm, {ratios[-1]:.2f} of the "
            f"floor, {twin.verdict}, {cost:.1f} s: {shown}", flush=True,
        )
    print(f"{family} {arguments}: {len(verdicts)} machines")
    print({verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)})
    if ratios:
        print(f"of the floor: within 1.3 {np.mean(np.array(ratios) <= 1.3):.2f}, within 2 "
              f"{np.mean(np.array(ratios) <= 2):.2f}, largest {max(ratios):.2f}")
        print(f"processor time: median {np.median(costs):.1f} s, largest {max(costs):.1f} s")
    for name, values in all_errors.items():
        print(f"{name}: median {100 * np.median(values):.2f} %, largest {100 * max(values):.1f} %")
    if all_covered:
        print(f"95 % intervals cover {np.mean(all_covered):.3f} of {len(all_covered)} parameters")


if __name__ == "__main__":
    main(sys.argv[1:])
