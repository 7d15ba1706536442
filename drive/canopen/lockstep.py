"""Drives on a bus in simulated time, which advances with SYNC as fast as the computer permits.

No clock is read, so two runs with the same frames are the same bit by bit.
"""

import math
from collections.abc import Sequence

from ..machine import Machine
from .frame import SYNC
from .link import Link, Loopback
from .node import Node

ROUNDS = 100  # of answers between nodes at one instant; further frames wait for the next one


class LockStep:
    """Machines and their drives as nodes of one `Loopback`, in simulated time.

    SYNC is produced here (`sync`) or by a master behind another link (`serve`). At a SYNC, a node
    latches the RPDOs and samples the TPDOs; then the position cycles of the period run.

    Args:
        machines: machines with drives of different node-ids.
        period: period of SYNC (µs), a whole multiple of each machine's cycle.
        bus: the nodes' bus; by default one on which frames take no time.

    Raises:
        ValueError: two drives with one node-id, or a period that is not a multiple of the cycles.
    """

    def __init__(
        self, machines: Sequence[Machine], period: int = 1000, bus: Loopback | None = None
    ):
        self.period = period
        self.bus = bus or Loopback()
        self.time = 0  # µs
        self.nodes = [Node(drive) for machine in machines for drive in machine.drives.values()]
        node_ids = sorted(node.node_id for node in self.nodes)
        if len(set(node_ids)) != len(node_ids):
            raise ValueError(f"node-ids {node_ids}: each node needs a node-id of its own")
        self._machines = [(machine, _cycle(machine, period)) for machine in machines]
        self._tick = math.gcd(*(cycle for _, cycle in self._machines))
        self._stations = [(node, self.bus.join()) for node in self.nodes]
        self._own = self.bus.join()
        self._settle()

    def sync(self, count: int = 1) -> None:
        """Produce `count` SYNCs and advance by their periods."""
        for _ in range(count):
            self._own.send(SYNC, self.time)
            self._pass_period()

    def serve(self, link: Link, *, ends: bool = False) -> None:
        """Process the frames of a master's link, with one period per SYNC, and send the answers.

        The nodes answer a SYNC before its period passes; events within the period are sent after
        it.

        Args:
            link: the master's link.
            ends: a SYNC ends its period instead of starting it. Frames sent since the previous
                SYNC then act for the whole period, and the nodes answer with the result.
        """
        for frame in link.receive(self.time):
            is_sync = frame.id == SYNC.id and not (frame.remote or frame.extended)
            if is_sync and ends:
                self._pass_period()
                self._forward(link)
            self._own.send(frame, self.time)
            self._settle()
            self._forward(link)
            if is_sync and not ends:
                self._pass_period()
                self._forward(link)
        self._settle()
        self._forward(link)

    def _forward(self, link: Link) -> None:
        for frame in self._own.receive(self.time):
            link.send(frame, self.time)

    def _pass_period(self) -> None:
        end = self.time + self.period
        while self.time < end:
            tick = self.time + self._tick
            while (due := self.bus.due()) is not None and due < tick:
                self.time = max(self.time, due)
                if not self._settle():
                    break
            self.time = tick
            for machine, cycle in self._machines:
                if tick % cycle == 0:
                    machine.step()
            self._settle()

    def _settle(self) -> bool:
        """Let all nodes receive and send at this instant; False if they do not finish."""
        time = self.time
        for _ in range(ROUNDS):
            for node, link in self._stations:
                for frame in link.receive(time):
                    node.receive(frame, time)
            for node, link in self._stations:
                for frame in node.poll(time):
                    link.send(frame, time)
            due = self.bus.due()
            if due is None or due > time:
                return True
        return False


def _cycle(machine: Machine, period: int) -> int:
    """Cycle of a machine (µs)."""
    cycle = round(machine.cycle_time * 1e6)
    if abs(cycle - machine.cycle_time * 1e6) > 1e-6 or period < cycle or period % cycle:
        raise ValueError(
            f"period = {period} µs is not a whole multiple of the machine's cycle = "
            f"{machine.cycle_time * 1e6:g} µs: choose another SYNC period"
        )
    return cycle
