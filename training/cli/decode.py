"""`servogym decode`."""

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

from . import arguments


def add(decode: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    decode.add_argument(
        "log", type=Path,
        help="CAN log: .log (candump), .asc, .blf, .trc, .csv; EtherCAT capture: .pcapng, .pcap",
    )
    decode.add_argument(
        "--drive",
        help="drive model, see `servogym drives` (generic; on EtherCAT, found by identity)",
    )
    decode.add_argument(
        "--node-id", type=arguments.NODE_ID, nargs="+", action="extend",
        help="nodes with this drive model (all)",
    )
    decode.set_defaults(run=_decode)


def _decode(options: argparse.Namespace, console: Console) -> int:
    """Print the frames of a log. Raises ValueError if it is damaged or holds no frame."""
    lines = _of_ethercat if options.log.suffix in (".pcapng", ".pcap") else _of_can
    empty = True
    try:
        for seconds, text in lines(options):
            empty = False
            if text:
                print(f"{seconds:12.6f}  {text}")
        sys.stdout.flush()
    except BrokenPipeError:  # `servogym decode run.log | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    if empty:
        raise ValueError(f"{options.log} contains no frame; is it complete?")
    return 0


def _of_ethercat(options: argparse.Namespace) -> Iterator[tuple[float, str]]:
    """Yield time (s) and line; the line is empty for a frame without new information."""
    from ...drive.ethercat.decode import EtherCatDecoder
    from ...drive.wire.pcapng import read

    if options.node_id:
        raise ValueError("--node-id is for CAN; all slaves of an EtherCAT capture are decoded")
    decoder = EtherCatDecoder(options.drive)
    begin, count = None, 0
    for packet in read(options.log):
        count += 1
        begin = packet.time if begin is None else begin
        for text in decoder.decode(packet.frame) or [""]:
            yield (packet.time - begin) * 1e-9, text
    if count and decoder.others == count:
        raise ValueError(
            f"{options.log}: none of its {count} frames is an EtherCAT frame (type 88A4h, or UDP "
            "to that port): was it recorded at the right interface?"
        )
    if decoder.others:
        print(f"{decoder.others} frames of other protocols were left out", file=sys.stderr)


def _of_can(options: argparse.Namespace) -> Iterator[tuple[float, str]]:
    """Yield time (s) and line."""
    from ...drive.canopen.decode import Decoder
    from ...drive.wire.bus import to_frame
    from ...drive.wire.log import messages, not_classical

    decoder = Decoder(options.drive or "generic", options.node_id or range(1, 128))
    begin = None
    for message in messages(options.log):
        begin = message.timestamp if begin is None else begin
        frame = to_frame(message)
        text = decoder.decode(frame) if frame else not_classical(message)
        yield message.timestamp - begin, text
