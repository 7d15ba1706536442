"""Ports that carry frames to nodes and advance time."""

from collections.abc import Iterable
from typing import Protocol

from ..machine import Machine
from .frame import Frame
from .node import Node


class FramePort(Protocol):
    """A member of a bus; `servogym.drive.wire.bus.CanPort` implements it with python-can."""

    def now(self) -> float:
        """Time (s) from an arbitrary origin; it advances while frames are exchanged."""

    def exchange(self, frames: Iterable[Frame]) -> Iterable[Frame]:
        """Send `frames`, wait some ms for answers; -> the frames received since the last call."""


class NodePort:
    """The drives of a machine as nodes in this process, in simulated time.

    Args:
        machine: runs one cycle with every exchange.
        nodes: the nodes; by default one for each drive, with its node-id.
    """

    def __init__(self, machine: Machine, *nodes: Node):
        self.nodes = nodes or tuple(Node(drive) for drive in machine.drives.values())
        self._machine = machine
        self._period = round(machine.cycle_time * 1e6)
        self._time = 0  # µs

    def now(self) -> float:
        """Simulated time (s)."""
        return self._time * 1e-6

    def exchange(self, frames: Iterable[Frame]) -> list[Frame]:
        """Pass frames to the nodes, run a cycle, and return the frames of the nodes."""
        for frame in frames:
            for node in self.nodes:
                node.receive(frame, self._time)
        self._machine.step()
        self._time += self._period
        return [frame for node in self.nodes for frame in node.poll(self._time)]
