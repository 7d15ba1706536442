"""Explains the frames of a CANopen log (CiA 301, 305, 402).

The PDO mapping starts as in the drive model and follows the reads and writes of 1400h.., 1600h..,
1800h.. and 1A00h.. in the log. The bits of controlword and statusword are named according to the
last mode of operation. The statusword bits voltage_enabled and remote are not printed, because they
are set in every state of a drive on a bus.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

from ...model.model import DriveModel, Object, load
from ..frame import Base, Frame
from ..node import NmtCommand
from . import lss
from .node import ModelInfo, Node

NMT = {
    NmtCommand.START: "start",
    NmtCommand.STOP: "stop",
    NmtCommand.ENTER_PRE_OPERATIONAL: "enter pre-operational",
    NmtCommand.RESET_NODE: "reset",
    NmtCommand.RESET_COMMUNICATION: "reset communication",
}


class Decoder:
    """Explains the frames of a bus.

    Args:
        model: the drive model of the nodes.
        node_ids: the nodes that are such drives; frames of others are shown as bytes.
        heard: called with node-id, object and value (drive units) of each number transferred by
            PDO or SDO; for a write, after the drive has confirmed it.

    Raises:
        ValueError: unknown model, a node-id out of range.
    """

    def __init__(
        self, model: str | Path | DriveModel = "generic", node_ids: Iterable[int] = range(1, 128),
        heard: Callable[[int, Object, float], None] = lambda node_id, row, value: None,
    ):
        drive = ModelInfo(load(model))
        self._nodes: dict[int, Node] = {}
        self._by_id: dict[int, list[Node]] = {}
        for node_id in dict.fromkeys(node_ids):
            if not 1 <= node_id <= 127:
                raise ValueError(f"node_id = {node_id} is out of range 1..127")
            self._nodes[node_id] = Node(drive, node_id, self._listen, heard)

    def decode(self, frame: Frame) -> str:
        """Explain a frame in one line; never raises, and shows unknown frames as bytes."""
        text = None
        if not frame.extended:
            if frame.id == Base.NMT:
                text = self._nmt(frame)
            elif frame.id in lss.LSS:
                text = lss.explain(frame)
            else:
                text = self._service(frame)
        return text or f"unknown {frame}"

    def _service(self, frame: Frame) -> str | None:
        found = [(service, node) for node in self._by_id.get(frame.id, ())
                 for service in node.services[frame.id]]
        if not found:
            return None
        # valid PDOs and nodes that have sent something take precedence over others
        best = min((service.rank, not node.alive) for service, node in found)
        texts = [s.explain(frame) for s, node in found if (s.rank, not node.alive) == best]
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
        """Register the identifiers of a node after a change."""
        for identifier in before:
            self._by_id[identifier].remove(node)
        for identifier in node.services:
            self._by_id.setdefault(identifier, []).append(node)
