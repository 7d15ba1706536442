"""`servogym twin`."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments, machines
from . import bus as buses

GAIN_OBJECTS = (
    "velocity_control_gain", "velocity_control_time", "position_control_gain",
    "velocity_filter_time", "velocity_feed_forward",
)
LIVE = "bus"


def add_twin(twin: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    twin.add_argument(
        "logs", nargs="*", type=Path, metavar="LOG",
        help="log of one axis: candump, .asc, .blf, .pcapng, .csv; of several logs the last is "
        "held out, "
        "of a single log its end",
    )
    twin.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    twin.add_argument(
        "--mechanics", default="auto", metavar="FAMILY",
        help="auto, rigid, spring, toothed_belt, ball_screw, vertical, rotary_table, gantry.x ... "
        "(auto: rigid, spring, toothed_belt)",
    )
    twin.add_argument("-o", "--out", type=Path, help="output folder for the twin")
    add_log(twin)
    twin.add_argument(
        "--read-gains", metavar="FILE|bus",
        help="read gains and other objects from the drive's stored parameters, a JSON file, or a "
        "running node "
        "(`bus`)",
    )
    twin.add_argument(
        "--free", default="", metavar="NAME,...",
        help="further unknown parameters, such as pid_gain",
    )
    twin.add_argument(
        "--against", type=Path, metavar="FOLDER",
        help="compare with this twin: report what has changed since its log",
    )
    twin.add_argument(
        "--plan",
        type=Path,
        metavar="CSV",
        help="write an experiment to record; with a log, one that determines what the log leaves "
        "open",
    )
    twin.add_argument(
        "--range", nargs=2, type=arguments.FINITE, metavar=("LOW", "HIGH"),
        help="position range of the plan, m or rad",
    )
    twin.add_argument(
        "--velocity", type=arguments.POSITIVE, default=0.5, help="velocity of the plan (0.5 m/s)"
    )
    twin.add_argument(
        "--acceleration", type=arguments.POSITIVE, default=5.0,
        help="acceleration of the plan (5 m/s²)",
    )
    twin.add_argument(
        "--jerk", type=arguments.POSITIVE, default=200.0, help="jerk of the plan (200 m/s³)"
    )
    twin.add_argument(
        "--period", type=arguments.POSITIVE, default=1.0, help="bus cycle of the plan in ms (1)"
    )
    twin.add_argument(
        "--sweep", action="store_true",
        help="end the plan with a frequency sweep, for axes with a spring",
    )
    twin.add_argument(
        "--node-id", type=arguments.NODE_ID, help="node-id for --read-gains bus (1)"
    )
    buses.add(twin)
    twin.set_defaults(run=_twin, folders=("out",))


def add_replay(replay: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    replay.add_argument("log", type=Path, help="log: candump, .asc, .blf, .pcapng or .csv")
    machines.add(replay)
    add_log(replay, axis=False)
    replay.add_argument(
        "--sender", "--who", dest="sender", help="node or slave of the log, if there are several"
    )
    replay.add_argument("--out", type=Path, default=Path("out"), help="folder for replay.csv (out)")
    replay.set_defaults(folders=("out",))


def add_log(parser: argparse.ArgumentParser, axis: bool = True) -> None:
    """Add the options that describe a log."""
    parser.add_argument(
        "--columns", help="columns of a CSV: time=HEADING:ms,target_position=HEADING:mm,..."
    )
    parser.add_argument(
        "--mode", type=arguments.SIGNED_BYTE,
        help="mode of operation (6061h), if the log does not contain it",
    )
    parser.add_argument(
        "--torque-constant", type=arguments.POSITIVE,
        help="torque constant (Nm/A), for a current in A",
    )
    parser.add_argument(
        "--cycle", type=arguments.POSITIVE,
        help="bus cycle of the master in ms, for a log that is sampled less often",
    )
    parser.add_argument(
        "--hold", action="store_true",
        help="set-points of such a log are steps, not points on a curve",
    )
    if axis:
        parser.add_argument("--axis", help="node or slave of the log, if there are several")
        parser.add_argument(
            "--set", action="append", metavar="NAME=VALUE", default=[], type=machines._value,
            help="known parameter of the machine, such as feed_constant=0.01; repeatable",
        )


def _log_options(options: argparse.Namespace) -> dict[str, Any]:
    return {
        "columns": options.columns, "mode": options.mode,
        "torque_constant": options.torque_constant,
        "hold": options.hold,
        "cycle": None if options.cycle is None else 1e-3 * options.cycle,
    }


def _twin(options: argparse.Namespace, console: Console) -> int:
    from ...envs.autotune.needs import scipy
    from ...envs.twin.families import family

    if options.read_gains != LIVE:
        buses.refuse(options, f"is for --read-gains {LIVE}", "node_id")
    if options.plan is not None and not options.logs:
        return _plan(options)
    if not options.logs:
        raise ValueError("give at least one log, or --plan to write the experiment for it")
    for log in options.logs:
        if not log.is_file():
            raise ValueError(f"{log}: there is no such file")
    scipy("interpolate")
    if options.against is not None:
        return _against(options, console)
    if options.out is None:
        raise ValueError("-o FOLDER is missing: where the twin is to be kept")
    names, built = _names(options.mechanics), dict(options.set)
    objects = _gains(options)
    first = family(names[0]).given(built, objects)
    best, tried = _fitted(
        options, console, names, built, objects, first.make(options.drive), bool(objects),
        tuple(arguments.listed(options.free)),
    )
    from ...envs.twin.folder import content, save
    from ...envs.twin.report import report
    from ...envs.twin.words import missing

    file = save(options.out, best, options.drive, options.logs, tried)
    found = content(best, options.drive, options.logs, tried)
    report(options.out, best, found)
    _print(found)
    print(f"{file}, {options.out / 'report.md'}")
    if options.plan is not None:
        kinds = missing(best)
        if kinds:
            _plan(options, best.family.name, kinds)
        else:
            print(f"{options.plan}: not written, this log tells every parameter")
    return 0 if best.verdict in ("good", "fair") else 1


def _names(mechanics: str) -> tuple[str, ...]:
    from ...envs.twin.families import AUTO, family

    return AUTO if mechanics == "auto" else tuple(family(each).name for each in
                                                  mechanics.split(","))


def _fitted(
    options: argparse.Namespace, console: Console, names: Sequence[str], built: dict[str, Any],
    objects: dict[str, float], machine: Any, gains_known: bool, free: Sequence[str],
) -> tuple[Any, list[Any]]:
    """Fit families to the logs; `machine`, of the first one, has the drive that was logged."""
    from ...envs.twin import logs
    from ...envs.twin.families import family
    from ...envs.twin.fit import choose

    experiments = logs.read(
        options.logs, machine, options.drive, family(names[0]).axis, sender=options.axis,
        **_log_options(options),
    )
    in_log = any("velocity_control_gain" in each.objects for each in experiments)
    keeps = "; Ctrl-C keeps the best so far"
    with console.status(f"reading{keeps}") as status:
        return choose(
            experiments, options.drive, names, built, objects, gains_known=gains_known or in_log,
            progress=lambda text: status.update(f"{text}{keeps}"), free=tuple(free),
        )


def _gains(options: argparse.Namespace) -> dict[str, float]:
    """Return the drive's objects from a file or from a running node."""
    where = options.read_gains
    if where is None:
        return {}
    if where != LIVE:
        file = Path(where)
        if not file.is_file():
            raise ValueError(f"--read-gains {where}: there is no such file; `bus` reads a node")
        try:
            values = json.loads(file.read_text(encoding="utf-8"))
            values = values.get("parameters", values)
            return _known(options.drive, values)
        except (ValueError, AttributeError, TypeError):
            raise ValueError(
                f"--read-gains {where}: it is not a JSON file of objects and numbers"
            ) from None
    from ...drive.canopen.remote import CanOpenPort
    from ...drive.wire.bus import CanPort

    bus = buses.opened(options)
    try:
        port = CanOpenPort(CanPort(bus), options.node_id or 1, options.drive)
        node = next(iter(port.nodes.values()))
        names = [name for name in GAIN_OBJECTS if name in next(iter(port.models.values())).names]
        return {name: float(node.upload(name)) for name in names}
    finally:
        bus.shutdown()


def _known(drive: str, values: dict[str, Any]) -> dict[str, float]:
    """Return objects by name, from names or from addresses as in a parameter file."""
    from ...drive.kernel.record import OD
    from ...drive.model.model import load

    model = load(drive)
    found = {}
    for key, value in values.items():
        name = key
        head, _, sub = key.partition(":")
        try:
            index = int(head, 16)
            row = model.objects.get((index, int(sub or "0", 0)))
            name = row.name if row is not None else key
        except ValueError:
            pass
        if name in (OD.names or ()) or name in model.names:
            found[name] = float(value)
    if not found:
        raise ValueError("no object")
    return found


def _print(found: dict[str, Any]) -> None:
    for name, row in found["parameters"].items():
        interval = ""
        if row["low"] < row["high"]:
            interval = f" [{row['low']:.4g}, {row['high']:.4g}]"
        print(f"{name:24s} {row['value']:10.4g}{interval} {row['unit']}")
    for each in (*found["doubts"], *found["notes"]):
        print(f"- {each}")
    print(found["said"])


def _plan(options: argparse.Namespace, family_name: str = "", kinds: Sequence[str] = ()) -> int:
    """Write an experiment for an unknown axis, or of the kinds that a log has left open."""
    from ...envs.twin.experiment import Scale
    from ...envs.twin.families import family
    from ...envs.twin.plan import WHOLE, Limits, plan, write

    chosen = family(family_name or _names(options.mechanics)[0]).given(dict(options.set))
    machine = chosen.make(options.drive)
    low, high = options.range or machine.range(chosen.axis)
    if not (abs(low) < 1e6 and abs(high) < 1e6):
        raise ValueError("--range LOW HIGH is missing: this axis has no ends of its own")
    if options.range is None:  # off the ends
        low, high = low + 0.1 * (high - low), high - 0.1 * (high - low)
    limits = Limits(low, high, options.velocity, options.acceleration, options.jerk)
    set_points = plan(limits, 1e-3 * options.period, kinds=kinds or WHOLE, sweep=options.sweep)
    unit = Scale.of(machine, chosen.axis).position
    write(options.plan, set_points, 1e-3 * options.period, unit)
    print(
        f"{len(set_points)} set-points, {len(set_points) * 1e-3 * options.period:.1f} s: "
        f"{options.plan}; send one a bus cycle (607Ah in csp), log 6041h, 6064h and 6077h"
    )
    return 0


def _against(options: argparse.Namespace, console: Console) -> int:
    from ...envs.engine import parameters
    from ...envs.plants import twins
    from ...envs.twin.families import family
    from ...envs.twin.fit import KEPT
    from ...envs.twin.health import changes, table

    twin = twins.read(options.against)
    options.drive = twin.drive
    chosen = family(twin.mechanics)
    built = {k: v for k, v in twin.arguments.items() if k not in chosen.arguments} | dict(
        options.set
    )
    machine = chosen.given(built).make(options.drive)
    twin.give(machine)  # gains in the drive's own units
    x = machine.drives[twin.axis]
    found_then = (*GAIN_OBJECTS, *KEPT.values(), "supply_voltage")
    objects = dict(twin.objects) | {
        each: float(getattr(x.axis.od, each)) for each in found_then if each in x.objects.names
    }
    gap = parameters.PARAMETERS["backlash"].there(parameters.Joint(machine, twin.axis))
    best, _ = _fitted(
        options, console, [chosen.name], built, objects, machine, True,
        ("backlash",) if gap else (),
    )
    found = changes(twin, best)
    for change in found:
        print(change)
    print(f"{best.verdict}: position error {best.misfit:.2f} times the noise floor")
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        rows = {"against": str(options.against), "verdict": best.verdict, "changes": table(found)}
        file = options.out / "health.json"
        file.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        print(file)
    return 0 if best.verdict in ("good", "fair") else 1


def compare(options: argparse.Namespace, console: Console) -> int:
    """Feed the set-points of a log to a machine and print its deviation from the log."""
    import csv

    import numpy as np

    from ...envs.plants import twins
    from ...envs.twin import logs
    from ...envs.twin.candidates import Candidates
    from ...envs.twin.fit import best_lag

    if not options.log.is_file():
        raise ValueError(f"{options.log}: there is no such file")
    if options.twin is not None:
        options.drive = twins.read(options.twin).drive
    _, name = machines.made(options)

    def make():
        return machines.made(options)[0]

    candidates = Candidates(make, name, 1)
    (experiment,) = logs.read(
        [options.log], candidates.machines[0], options.drive, name, sender=options.sender,
        **_log_options(options),
    )
    quiet = {"encoder_noise": 0.0}
    known = None if options.twin is None else twins.read(options.twin).lag
    lag = best_lag(candidates, experiment, quiet) if known is None else known
    run = candidates.simulate(experiment, [quiet | {"lag": lag}])
    left_p = experiment.position - run.position[0]
    left_t = experiment.torque - run.torque[0]
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "replay.csv"
    unit = candidates.joint.unit
    with file.open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(["time (s)", f"measured position ({unit})", f"position ({unit})",
                         "measured torque (Nm)", "torque (Nm)"])
        for row in zip(experiment.time, experiment.position, run.position[0], experiment.torque,
                       run.torque[0], strict=True):
            writer.writerow([f"{value:.9g}" for value in row])

    def rms(values):
        return float(np.sqrt(np.mean(np.square(values))))

    explained = 100 * (1 - rms(left_p) / max(rms(experiment.position - experiment.position.mean()),
                                             1e-12))
    small = "µm" if unit == "m" else "µrad"
    print(
        f"{len(experiment.time)} samples, mode {experiment.mode}, bus cycle "
        f"{1e3 * experiment.period:g} ms, {100 * experiment.lost:.2f} % of the frames missing, "
        f"lag {1e3 * lag:.3g} ms"
    )
    print(
        f"position {1e6 * rms(left_p):.4g} {small} rms ({explained:.4g} % of the motion), torque "
        f"{rms(left_t):.3g} Nm rms: {file}"
    )
    return 0
