"""`servogym scope`."""

import argparse
import re
from pathlib import Path

from rich.console import Console

from . import machines

CHANNELS = (
    "position_demand_value", "position_actual_value", "following_error_actual_value",
    "axis.torque_command", "statusword",
)  # fmt: skip


def add(commands) -> None:
    """Its row in the table of commands."""
    scope = commands.add_parser("scope", help="an oscilloscope on a move: channels, trigger, CSV")
    machines.add(scope)
    scope.add_argument(
        "--channels", default=",".join(CHANNELS),
        help="objects by name or as 6064h and 60F9h:01, axis.FIELD of the record; with commas",
    )  # fmt: skip
    scope.add_argument(
        "--trigger", help="CHANNEL:EDGE:LEVEL, EDGE of rising, falling, above, change"
    )
    scope.add_argument("--before", type=int, default=100, help="samples ahead of it (100)")
    scope.add_argument("--depth", type=int, default=4000, help="samples in all (4000)")
    scope.add_argument("--move", type=float, default=0.1, help="distance, m or rad (0.1)")
    scope.add_argument(
        "--out", type=Path, default=Path("out"), help="folder: scope.csv, .png (out)"
    )
    scope.set_defaults(run=_scope)


def _name(drive, text: str) -> str:
    """A channel as `Trace` knows it."""
    match = re.fullmatch(r"([0-9A-Fa-f]{4})h(?::([0-9A-Fa-f]{2}))?", text.strip())
    if not match:
        return text.strip()
    address = int(match[1], 16), int(match[2] or "0", 16)
    if address not in drive.model.objects:
        raise ValueError(f"{text}: drive {drive.model.name} has no such object")
    return drive.model.objects[address].name


def _trigger(drive, text: str | None):
    from ...drive.trace import Edge, Trigger

    if text is None:
        return None
    match = re.fullmatch(r"(.+):(rising|falling|above|change)(?::(-?[\d.]+(?:e-?\d+)?))?", text)
    if not match:
        raise ValueError(f"--trigger = {text!r}: use CHANNEL:EDGE:LEVEL, as 6064h:rising:300000")
    return Trigger(_name(drive, match[1]), Edge[match[2].upper()], float(match[3] or 0))


def _scope(options: argparse.Namespace, console: Console) -> int:
    from ...drive.kernel.words import Mode
    from ...drive.master import Master
    from ...drive.trace import Trace
    from ...envs.masters.port import MachinePort
    from ..pictures.traces import draw

    machine, name = machines.made(options)
    drive = machine.drives[name]
    trigger = _trigger(drive, options.trigger)
    trace = Trace(
        drive, [_name(drive, x) for x in options.channels.split(",") if x.strip()],
        depth=options.depth, trigger=trigger, before=options.before if trigger else 0,
    )  # fmt: skip
    master = Master(MachinePort(machine, lambda: trace.sample(machine.time)), name)
    master.set_mode(Mode.PROFILE_POSITION)
    master.enable()
    master.move_to(options.move, relative=True)
    if trigger and not trace.triggered:
        raise ValueError(f"--trigger = {options.trigger!r}: it did not come during the move")
    options.out.mkdir(parents=True, exist_ok=True)
    trace.save(options.out / "scope.csv")
    draw(trace, options.out / "scope.png")
    print(f"{len(trace)} samples: {options.out / 'scope.csv'}, {options.out / 'scope.png'}")
    return 0
