"""`servogym decode`: the frames of a CANopen log by meaning (CiA 301, 305, 402).

The PDO mapping begins as the drive model has it and follows what the log shows being written to or
read from 1400h.., 1600h.., 1800h.., 1A00h..; the bits of controlword and statusword are named after
the mode of operation last seen. Not named are the two statusword bits that stand in every state of
a drive on a bus, voltage_enabled and remote.
"""

import logging
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import can
from can.io.player import MESSAGE_READERS

from ..drive.canopen.frame import Base, Frame
from ..drive.canopen.node import NmtCommand
from ..drive.model import DriveModel, load
from . import decode_lss
from .decode_node import Known, Node
from .node import to_frame

NMT = {
    NmtCommand.START: "start",
    NmtCommand.STOP: "stop",
    NmtCommand.ENTER_PRE_OPERATIONAL: "enter pre-operational",
    NmtCommand.RESET_NODE: "reset",
    NmtCommand.RESET_COMMUNICATION: "reset communication",
}
TEXT_LOGS = (".log", ".asc", ".trc", ".csv")  # a frame a line


class Decoder:
    """Frames of a bus by meaning.

    Args:
        model: the drive model of the nodes.
        node_ids: the nodes that are such a drive; what others send is shown as bytes.

    Raises:
        ValueError: unknown model, a node-id out of range.
    """

    def __init__(
        self, model: str | Path | DriveModel = "generic", node_ids: Iterable[int] = range(1, 128)
    ):
        drive = Known(load(model))
        self._nodes: dict[int, Node] = {}
        self._by_id: dict[int, list[Node]] = {}
        for node_id in dict.fromkeys(node_ids):
            if not 1 <= node_id <= 127:
                raise ValueError(f"node_id = {node_id} is out of range 1..127")
            self._nodes[node_id] = Node(drive, node_id, self._listen)

    def decode(self, frame: Frame) -> str:
        """One line about a frame; never raises, what it does not know it gives as bytes."""
        text = None
        if not frame.extended:
            if frame.id == Base.NMT:
                text = self._nmt(frame)
            elif frame.id in decode_lss.LSS:
                text = decode_lss.tell(frame)
            else:
                text = self._service(frame)
        return text or f"unknown {frame}"

    def _service(self, frame: Frame) -> str | None:
        found = [(service, node) for node in self._by_id.get(frame.id, ())
                 for service in node.services[frame.id]]  # fmt: skip
        if not found:
            return None
        # a PDO that is not valid, or a node never heard, gives way to one that is
        best = min((service.rank, not node.alive) for service, node in found)
        texts = [s.tell(frame) for s, node in found if (s.rank, not node.alive) == best]
        return " | ".join(dict.fromkeys(text for text in texts if text))

    def _nmt(self, frame: Frame) -> str | None:
        if len(frame.data) != 2 or frame.remote or frame.data[0] not in NMT:
            return None
        command, node_id = NmtCommand(frame.data[0]), frame.data[1]
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            for node in [*self._nodes.values()]:
                if node_id in (0, node.id):
                    node.reset()
        return f"NMT {NMT[command]} {f'node {node_id}' if node_id else 'all nodes'}"

    def _listen(self, node: Node, before: Iterable[int]) -> None:
        """The identifiers of a node have changed."""
        for identifier in before:
            self._by_id[identifier].remove(node)
        for identifier in node.services:
            self._by_id.setdefault(identifier, []).append(node)


def run(log: Path, drive: str, node_ids: list[int] | None) -> int:
    """Print the frames of a log; -> exit status.

    Raises:
        ValueError: the log cannot be read to its end, or holds no frame.
        OSError: there is no such file.
    """
    decoder = Decoder(drive, node_ids or range(1, 128))
    begin = None
    try:
        for message in _messages(log):
            begin = message.timestamp if begin is None else begin
            frame = to_frame(message)
            text = decoder.decode(frame) if frame else _not_classical(message)
            print(f"{message.timestamp - begin:12.6f}  {text}")
        sys.stdout.flush()
    except BrokenPipeError:  # `servogym decode run.log | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    if begin is None:
        raise ValueError(f"{log}: there is no frame in it; is it complete?")
    return 0


def _not_classical(message: can.Message) -> str:
    if message.is_error_frame:
        return "error frame"
    return f"CAN FD {message.arbitration_id:03X}##{bytes(message.data).hex().upper()}"


def _messages(log: Path) -> Iterator[can.Message]:
    """The messages of a log; whatever a reader stumbles over becomes a ValueError."""
    suffixes = [suffix.lower() for suffix in log.suffixes]
    plain = suffixes[-2:-1] if suffixes[-1:] == [".gz"] else suffixes[-1:]
    if not plain or plain[0] not in MESSAGE_READERS:
        known = " ".join(sorted(MESSAGE_READERS))
        raise ValueError(f"{log}: unknown suffix, use one of {known}, also with .gz behind it")
    with log.open("rb") as file:  # also because the reader of .db makes a file that is not there
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - 1, 0))
        ends = suffixes[-1] not in TEXT_LOGS or size == 0 or file.read() == b"\n"
    library = logging.getLogger(MESSAGE_READERS[plain[0]].__module__)
    library.addFilter(_refuse)
    try:
        with can.LogReader(log) as reader:
            for message in reader:
                if message.arbitration_id is None:  # of a damaged .db
                    raise ValueError("a frame without an identifier")
                yield message
            if isinstance(reader, can.BLFReader) and size < reader.file_size:
                raise ValueError(f"{size} bytes of {reader.file_size} are there")
            if not ends:  # the readers take what is left of a frame for a short one
                raise ValueError("its last line has no end and may be wrong")
    except OSError:
        raise
    except Exception as error:  # each reader has exceptions of its own, down to IndexError
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{log}: damaged or cut off, no further frame can be read ({reason})"
        ) from None
    finally:
        library.removeFilter(_refuse)


def _refuse(record: logging.LogRecord) -> bool:
    """Readers only warn of a line they do not understand; an empty one may stay."""
    if record.args != ("",):
        raise ValueError(record.getMessage())
    return False
