"""`servogym scope`."""

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments, machines
from . import bus as buses

CHANNELS = [
    "position_demand_value", "position_actual_value", "following_error_actual_value",
    "torque_actual_value", "statusword",
]
OF_A_MACHINE = [*CHANNELS[:3], "axis.torque_command", "statusword"]
BUS = "bus"
ONLY_OF_A_BUS = f"is for a running node only, `servogym scope {BUS}`"
MOST = 6  # panels of a log that has none of `CHANNELS`
DEPTH, BEFORE, RATE, DURATION = 4000, 100, 50.0, 10.0


def add(scope: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    scope.epilog = (
        f"`{BUS}` records a running node without commanding it: it listens to TPDOs and polls "
        "other objects by SDO. A log has a format of `servogym decode`, or is a scope.csv."
    )
    machines.add(scope, f"`{BUS}` for a running node, or a log (.log, .asc, .blf, .pcapng ...)")
    scope.add_argument(
        "--channels",
        help="objects by name or as 6064h and 60F9h:01, separated by commas; for a machine also "
        "axis.FIELD of the record",
    )
    scope.add_argument(
        "--trigger", help="CHANNEL:EDGE:LEVEL, where EDGE is rising, falling, above or change"
    )
    scope.add_argument(
        "--before", type=arguments.FROM_ZERO, help=f"samples before the trigger ({BEFORE})"
    )
    scope.add_argument(
        "--depth", type=arguments.COUNT, default=DEPTH, help=f"total number of samples ({DEPTH})"
    )
    scope.add_argument(
        "--move", type=arguments.FINITE, default=0.1, help="distance of the move, m or rad (0.1)"
    )
    scope.add_argument("--node-id", type=arguments.NODE_ID, help="node-id on a bus or in a log (1)")
    scope.add_argument(
        "--rate", type=arguments.POSITIVE, help=f"polls per second ({RATE:g})"
    )
    scope.add_argument(
        "--duration", type=arguments.POSITIVE, help=f"longest recording of a bus, s ({DURATION:g})"
    )
    buses.add(scope)
    scope.add_argument(
        "--out", type=Path, default=Path("out"), help="folder for scope.csv and scope.png (out)"
    )
    scope.set_defaults(run=_scope, drive=None, folders=("out",))


def _trigger(text: str | None, named: Callable[[str], str]):
    from ...drive.trace import Edge, Trigger

    if text is None:
        return None
    match = re.fullmatch(r"(.+):(rising|falling|above|change)(?::(-?[\d.]+(?:e-?\d+)?))?", text)
    if not match:
        raise ValueError(
            f"--trigger = {text!r}: use CHANNEL:EDGE:LEVEL, such as 6064h:rising:300000"
        )
    return Trigger(named(match[1]), Edge[match[2].upper()], float(match[3] or 0))


def _asked(options: argparse.Namespace) -> list[str]:
    asked = arguments.listed(options.channels)
    if options.channels is not None and not asked:
        raise ValueError(f"--channels = {options.channels!r} names no channel")
    return asked


def _window(options: argparse.Namespace, trigger: Any) -> dict[str, Any]:
    before = min(BEFORE, options.depth - 1) if options.before is None else options.before
    if before >= options.depth:
        raise ValueError(
            f"--before = {before} samples is out of range 0..{options.depth - 1}: give less than "
            "--depth"
        )
    return {"depth": options.depth, "trigger": trigger, "before": before if trigger else 0}


def _scope(options: argparse.Namespace, console: Console) -> int:
    from ..pictures.traces import draw

    if options.machine == BUS:
        recording, said, during = _of_node(options)
    elif options.machine not in machines.FACTORIES and Path(options.machine).suffix != ".xml":
        buses.refuse(options, ONLY_OF_A_BUS, "rate", "duration")
        recording, said, during = _of_log(options)
    else:
        buses.refuse(options, ONLY_OF_A_BUS, "rate", "duration", "node_id")
        recording, said, during = _of_machine(options), "", "during the move"
    if not recording.triggered:
        raise ValueError(f"--trigger = {options.trigger!r}: the trigger did not occur {during}")
    if not len(recording):
        raise ValueError(f"no sample {during}: none of the channels was received")
    options.out.mkdir(parents=True, exist_ok=True)
    recording.save(options.out / "scope.csv")
    draw(recording, options.out / "scope.png")
    print(f"{len(recording)} samples{said}: {options.out / 'scope.csv'}, "
          f"{options.out / 'scope.png'}")
    return 0


def _of_machine(options: argparse.Namespace):
    from ...drive.kernel.words import Mode
    from ...drive.master import Master
    from ...drive.trace import Trace
    from ...drive.wire.recording import address_of, channel_of
    from ...envs.masters.port import MachinePort

    options.drive = options.drive or "generic"
    machine, name = machines.made(options)
    drive = machine.drives[name]

    def named(channel: str) -> str:
        return channel_of(drive.model, channel) if address_of(channel) else channel

    trace = Trace(
        drive, [named(channel) for channel in _asked(options) or OF_A_MACHINE],
        **_window(options, _trigger(options.trigger, named)),
    )
    master = Master(MachinePort(machine, lambda: trace.sample(machine.time)), name)
    master.set_mode(Mode.PROFILE_POSITION)
    master.enable()
    master.move_to(options.move, relative=True)
    return trace


def _of_log(options: argparse.Namespace):
    from ...drive.trace import Recording
    from ...drive.wire.recording import Source, record

    log = Path(options.machine)
    if not log.is_file():
        known = f"{', '.join(machines.FACTORIES)}, an MJCF file, {BUS}, or a log"
        raise ValueError(
            f"machine {options.machine!r} is unknown, and there is no such file: choose "
            f"one of {known}"
        )
    source = Source(log, options.drive)
    asked = _asked(options)
    node = options.axis or (None if options.node_id is None else str(options.node_id))
    watched = _trigger(options.trigger, lambda channel: channel)
    sender = source.drive(node, [*asked, *([watched.channel] if watched else [])])
    names = [source.name(sender, channel) for channel in asked]
    names = names or [name for name in CHANNELS if name in source.units[sender]]
    names = names if asked or len(names) > 1 else source.often(sender, MOST)
    trigger = _trigger(options.trigger, lambda channel: source.name(sender, channel))
    recording = Recording(
        {name: source.units[sender][name] for name in names}, **_window(options, trigger)
    )
    record(recording, source.groups(sender))
    return recording, f" of {sender}", f"in {log}"


def _of_node(options: argparse.Namespace):
    from ...drive.canopen.remote import CanOpenPort
    from ...drive.master.errors import ServoError
    from ...drive.trace import Recording
    from ...drive.wire.bus import CanPort
    from ...drive.wire.recording import NodeScope, record

    node_id, rate = options.node_id or 1, options.rate or RATE
    duration = options.duration or DURATION
    bus = buses.opened(options)
    try:
        port = CanOpenPort(CanPort(bus), node_id, options.drive or "generic")
        asked = _asked(options)
        scope = NodeScope(port, rate, asked or CHANNELS, optional=not asked)
        shown = {**scope.units}
        trigger = _trigger(options.trigger, scope.watch)
        recording = Recording(shown, **_window(options, trigger))
        ended = ""
        try:
            record(recording, scope.groups(duration))
        except KeyboardInterrupt:
            ended = ", interrupted"
        except ServoError as error:
            if not len(recording):
                raise
            ended = f", ended by {error}"
    finally:
        bus.shutdown()
    late = f", {scope.late} polls late: lower --rate" if scope.late else ""
    said = f" of node {node_id}{late}{ended}"
    return recording, said, f"within {duration:g} s"
