"""How a master reaches the bus: frames and time pass through a port the user gives."""

from collections.abc import Callable, Iterable
from typing import Protocol

from .frame import Frame
from .node import Node


class Port(Protocol):
    """A member of a bus; `servogym.training.bus.CanPort` is one of python-can."""

    def now(self) -> float:
        """Time (s) from any beginning; it passes while frames are exchanged."""

    def exchange(self, frames: Iterable[Frame]) -> Iterable[Frame]:
        """Send `frames`, wait for some (ms at most) -> all frames received since the last call."""


class NodePort:
    """An emulated node in this process, in simulated time.

    Args:
        node: the node.
        step: lets one cycle of the machine pass, such as `Machine.step`.
        period: of that cycle (s).
    """

    def __init__(self, node: Node, step: Callable[[], object], period: float):
        self._node = node
        self._step = step
        self._period = round(period * 1e6)
        self._time = 0  # µs

    def now(self) -> float:
        """Simulated time (s)."""
        return self._time * 1e-6

    def exchange(self, frames: Iterable[Frame]) -> list[Frame]:
        """Frames to the node, one cycle, frames from the node; a cycle takes one SDO request."""
        for frame in frames:
            self._node.receive(frame, self._time)
        self._step()
        self._time += self._period
        return self._node.poll(self._time)
