"""Twins of machines with hidden parameters, drawn wide: how near they come, and what it costs.

    python tests/twin/campaign.py ROWS.jsonl [SERIES[:COUNT] ...]

plays the machines whose rows are missing or were made by another estimator, and writes a line for
each. SERIES is the beginning of a name; without it, all series are played. A log lacks 0.5 % of its
frames, its stamps jitter by 0.2 ms, and its encoder has noise of 0.2 to 1 µm. `page.py` makes the
tables of docs/results/twin.md from the rows.
"""

import ast
import hashlib
import itertools
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import health
import numpy as np
from buses import CELLS, cell
from machines import hide, moves

import servogym.envs.twin
from servogym.drive.wire.recording import Signal
from servogym.envs.engine import parameters
from servogym.envs.engine.replay import Replay
from servogym.envs.twin.experiment import Unusable, experiment
from servogym.envs.twin.families import FAMILIES, GAINS
from servogym.envs.twin.fit import fit
from servogym.envs.twin.reconstruction import expected

HIDDEN = ("coulomb_friction", "viscous_friction")
READ = ("od.position_actual_value", "od.torque_actual_value", "od.statusword")
SLOW = ("ball_screw", "vertical", "ball_screw_scale")
NAMES = ("position_actual_value", "torque_actual_value", "statusword")


def draw(machine, family, rng, known):
    """Give it hidden parameters; -> their values."""
    hidden = hide(machine, rng, [family.mass, *HIDDEN], drive=family.axis)
    if family.spring:
        stiffness, damping = family.spring
        low, high = (8e3, 4e5) if stiffness[0] == "l" else (5e4, 1e6)
        k = math.exp(rng.uniform(math.log(low), math.log(high)))
        ratio = rng.uniform(0.01, 0.1)
        spring = {stiffness: k, damping: 2 * ratio * math.sqrt(k * hidden[family.mass])}
        parameters.apply(machine, spring, family.axis)
        hidden |= spring
    if not known:
        hidden |= hide(machine, rng, GAINS, 0.3, family.axis)
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
    """One machine, its log, its twin; -> the twin, what was hidden, the noise floor (m), CPU-s.

    The floor is what the machine with the hidden parameters leaves of its own log, without noise.
    """
    rng = np.random.default_rng(seed)
    family = FAMILIES[truth or fitted_as]
    machine = family.make(drive)
    hidden = draw(machine, family, rng, known)
    noise = float(rng.uniform(0.2, 1.0)) * 1e-6
    parameters.apply(machine, {"encoder_noise": noise}, family.axis)
    machine.couplings["noise_state"] = int(rng.integers(1, 2**62))
    slow = {"speed": (0.05, 0.35), "acceleration": (1, 5)} if family.name in SLOW else {}
    set_points = moves(rng, seconds, period, **slow)
    signals = stream(machine, family.axis, set_points, period, rng)
    chosen = FAMILIES[fitted_as]
    found = experiment(signals, chosen.make(drive), chosen.axis)
    begin = time.process_time()
    twin = fit([found], drive, chosen, gains_known=known)
    cost = time.process_time() - begin
    if truth is not None:
        return twin, {}, math.nan, cost
    values = hidden | {"lag": twin.values["lag"]}
    whole = expected(twin.candidates, twin.whole[0], values)
    run = twin.candidates.simulate(whole, [values])
    left = whole.residuals(run.position[0], run.torque[0])[:, 0]
    floor = float(np.sqrt(np.mean(left[whole.time >= twin.cuts[0]] ** 2)))
    return twin, hidden, floor, cost


def machine(fitted_as, seed, **more):
    """What is kept of one machine: errors, floor, cost, and each hidden parameter."""
    return _kept(*one(seed, fitted_as, **more))


def bus(cell_of, seed):
    """The same of a log of a bus."""
    with tempfile.TemporaryDirectory() as folder:
        return _kept(*cell(*cell_of, seed, Path(folder)))


def _kept(twin, hidden, floor, cost):
    found = {}
    for name, value in hidden.items():
        low, high = twin.estimate.interval(name)
        found[name] = {"true": value, "found": twin.values[name], "low": low, "high": high}
    return {
        "verdict": twin.verdict, "held_out": twin.held_position,
        "floor": twin.floor_position if floor != floor else floor, "cpu": round(cost, 1),
        "parameters": found,
    }


class Series(NamedTuple):
    """Rows of one kind: what plays one of a seed, the seeds, how many are wanted."""

    play: Callable[[int], dict[str, Any]]
    first: int
    count: int
    kind: str = "machine"


def _machines(fitted_as, first, count, **more):
    return Series(partial(machine, fitted_as, **more), first, count)


SERIES = {
    "load on a spring": _machines("spring", 1200, 20),
    "a spring as rigid": _machines("rigid", 1300, 20, truth="spring"),
    "toothed belt": _machines("toothed_belt", 1400, 5),
    "ball screw": _machines("ball_screw", 1410, 5),
    "vertical": _machines("vertical", 1420, 5),
    "rotary table": _machines("rotary_table", 1430, 5),
    "conveyor": _machines("conveyor", 1440, 5),
    "gantry.x": _machines("gantry.x", 1450, 5),
    "gantry.y": _machines("gantry.y", 1460, 5),
    "rack and pinion": _machines("rack_pinion", 1470, 5),
    "linear motor": _machines("linear_motor", 1480, 5),
    "rigid, gains unknown": _machines("rigid", 1000, 20, known=False),
    "rigid": _machines("rigid", 1100, 20),
    "rigid, 10 ms": _machines("rigid", 1490, 5, period=1e-2),
    "rigid, kollmorgen_akd": _machines("rigid", 1500, 5, drive="kollmorgen_akd"),
    **{
        f"bus: {model}, {fieldbus}, {mode}, {ms} ms": Series(
            partial(bus, (model, fieldbus, mode, 1e-3 * ms)), 1, 1, "bus")
        for model, fieldbus, modes in CELLS for mode in modes for ms in (1, 10)
    },
    **{
        f"health: {mechanics}, {name}": Series(
            partial(health.play, mechanics, change), 1600, count, "health")
        for mechanics, name, change, count in health.CHANGES
    },
}


def row(series, seed):
    """What is kept of one seed."""
    kept = {"series": series, "seed": seed, "code": CODE}
    try:
        return _short(kept | SERIES[series].play(seed))
    except Unusable as error:
        return kept | {"verdict": "unusable", "said": str(error)}


def code():
    """The estimator that made the twins: a hash of its files' syntax trees without docstrings."""
    folder = Path(servogym.envs.twin.__file__).parent
    trees = [ast.parse((folder / f"{name}.py").read_text(encoding="utf-8")) for name in FILES]
    for node in itertools.chain(*map(ast.walk, trees)):
        documented = isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
        if documented and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return hashlib.sha256("".join(map(ast.dump, trees)).encode()).hexdigest()[:8]


FILES = ("candidates", "estimate", "experiment", "families", "fit", "logs", "reconstruction",
         "regression", "set_points")
CODE = code()


def _short(value):
    """Numbers to six figures."""
    if isinstance(value, dict):
        return {name: _short(each) for name, each in value.items()}
    return float(f"{value:.6g}") if isinstance(value, float) else value


def rows(file):
    """The rows of a file."""
    text = file.read_text(encoding="utf-8") if file.exists() else ""
    return [json.loads(line) for line in text.splitlines()]


def main(words):
    file = Path(words[0])
    for word in words[1:] or [""]:
        start, _, most = word.rpartition(":")
        start, most = (start, most) if most.isdigit() else (word, "")
        names = [start] if start in SERIES else [n for n in SERIES if n.startswith(start)]
        for name in names:
            _, first, count, _ = SERIES[name]
            for seed in range(first, first + int(most or count)):
                kept = {(each["series"], each["seed"]): each for each in rows(file)}
                if (name, seed) in kept and kept[name, seed]["code"] == CODE:
                    continue
                kept[name, seed] = row(name, seed)
                lines = [json.dumps(each, ensure_ascii=False) + "\n" for each in kept.values()]
                file.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
