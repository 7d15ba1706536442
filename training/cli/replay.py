"""`servogym replay`."""

import argparse
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from . import arguments, twin

if TYPE_CHECKING:
    from ...drive.score import Score


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of the comparison with a machine and those for scoring answers."""
    twin.add_replay(command)
    command.add_argument(
        "--node-id", type=arguments.NODE_ID,
        help="without a machine: node-id of the drive in a CAN log (the first in the log)",
    )
    command.add_argument(
        "--most", type=arguments.COUNT, default=40,
        help="without a machine: number of differences to list, most frequent first (40)",
    )
    command.set_defaults(run=_replay, machine=None)


def _replay(options: argparse.Namespace, console: Console) -> int:
    """Compare motions if there is a machine or a twin; otherwise score the drive's answers."""
    if options.machine is not None or options.twin is not None:
        return twin.compare(options, console)
    if options.log.suffix in (".pcapng", ".pcap"):
        score = _of_ethercat(options)
    else:
        score = _of_can(options)
    _show(score, options.most, console)
    return 0


def _of_ethercat(options: argparse.Namespace) -> "Score":
    from ...drive.ethercat.bus import Bus
    from ...drive.ethercat.replay import Replay, exchanges, slaves_of
    from ...drive.wire.pcapng import read
    from ...envs.plants.catalogue import ethercat_line

    pairs = [*exchanges((packet.time, packet.frame) for packet in read(options.log))]
    if not pairs:
        raise ValueError(f"{options.log}: no EtherCAT frame with its reply is in it")
    segment, machines = ethercat_line([options.drive] * slaves_of(pairs), "none")
    return Replay(Bus(segment, machines, "real"), options.drive).run(pairs)


def _of_can(options: argparse.Namespace) -> "Score":
    from ...drive.canopen.replay import node_of, replay
    from ...drive.wire.bus import to_frame
    from ...drive.wire.log import messages
    from ...envs.plants.catalogue import axis_for

    rows = [(message.timestamp, frame) for message in messages(options.log)
            if (frame := to_frame(message)) is not None]
    node_id = options.node_id or node_of(frame for _, frame in rows)
    if node_id is None:
        raise ValueError(f"{options.log}: no node answers in it; name one with --node-id")
    return replay(axis_for(options.drive, node_id), node_id, rows)


def _show(score: "Score", most: int, console: Console) -> None:
    from ...drive.score import Verdict

    explained = score.total - score.counts[Verdict.DIFFERS]
    console.print(f"{explained} of {score.total} answers are equal or explained: " + ", ".join(
        f"{score.counts[verdict]} {verdict}" for verdict in Verdict))
    rows = sorted(score.differences.values(), key=lambda row: (-row.count, row.first))
    if not rows:
        return
    table = Table(title="what differs")
    for column in ("times", "first (s)", "register or object", "recorded", "model"):
        table.add_column(column, overflow="fold")
    for row in rows[:most]:
        table.add_row(str(row.count), f"{row.first:.3f}", row.what, row.recorded, row.model)
    console.print(table)
    if len(rows) > most:
        console.print(f"and {len(rows) - most} more: --most {len(rows)} lists them")
