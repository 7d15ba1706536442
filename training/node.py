"""`servogym node`: drives as CANopen nodes on a bus of python-can, in real time."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import can
from rich.console import Console

from ..drive.canopen.frame import Base, Frame
from ..drive.canopen.node import NmtCommand, Node
from ..drive.drive import Drive
from ..drive.model import load
from ..envs.gantry import gantry
from ..envs.linear_axis import linear_axis
from ..envs.machine import Machine
from .bus import to_frame, to_message

# machine by name, and where its axes stand at power-on (m)
AXES: dict[str, tuple[Callable[[str], Machine], dict[str, float]]] = {
    "linear": (linear_axis, {"x": 0.12}),
    "vertical": (lambda drive: linear_axis(drive, inclination=90, brake_torque=4.0), {"x": 0.12}),
    "gantry": (gantry, {"x": 0.1, "y": 0.1, "z": -0.1}),
    "gantry-x1x2": (
        lambda drive: gantry(drive, x_drives=2),
        {"x1": 0.1, "x2": 0.101, "y": 0.1, "z": -0.1},
    ),
}
SDO_REQUESTS = range(0x601, 0x680)
ECHO_TIME = 100_000  # µs in which a bus gives a frame back to its sender, if at all


@dataclass
class Statistics:
    """What a real-time server has done."""

    received: int = 0
    sent: int = 0
    cycles: int = 0
    missed: int = 0  # times the machine fell behind by more than `Server.TOLERANCE`


class Server:
    """Serves machines with one drive each as nodes on one bus.

    Simulated time follows the clock; where the machine cannot keep up, it skips and counts it. The
    nodes hear each other; what a bus gives back of the server's own frames is dropped.
    """

    TOLERANCE = 0.05  # s

    def __init__(
        self, bus: can.BusABC, machines: Sequence[Machine], log: can.Listener | None = None
    ) -> None:
        self.bus = bus
        self.log = log
        self.machines = list(machines)
        self.nodes = [Node(d) for machine in machines for d in machine.drives.values()]
        self.statistics = Statistics()
        self._begin = time.monotonic()
        self._stopped = False
        self._cycles_at_request = -1
        self._sent: deque[tuple[int, Frame]] = deque()  # that may still come back

    def stop(self) -> None:
        """Let `run` return; may be called from another thread."""
        self._stopped = True

    def run(self) -> None:
        """Serve until `stop`."""
        while not self._stopped:
            self.serve(self.bus.recv(timeout=0.001))

    def serve(self, message: can.Message | None) -> None:
        """Handle a received message, let the due cycles pass, send what there is to send."""
        self._advance()
        now = int((time.monotonic() - self._begin) * 1e6)
        frame = to_frame(message) if message else None
        if frame and self._is_echo(frame, now):
            frame = None
        if frame and SDO_REQUESTS.start <= frame.id < SDO_REQUESTS.stop:
            self._pass_a_cycle()
        if message and frame:
            self.statistics.received += 1
            if self.log:
                self.log(message)
            for node in self.nodes:
                node.receive(frame, now)
        for node in self.nodes:
            for answer in node.poll(now):
                self._send(answer, now)
                for other in self.nodes:
                    if other is not node:
                        other.receive(answer, now)

    def _is_echo(self, frame: Frame, now: int) -> bool:
        """Whether this is what the server has sent itself a moment ago."""
        for i, (_, sent) in enumerate(self._sent):
            if sent == frame:
                del self._sent[i]
                return True
        return False

    def _send(self, frame: Frame, now: int) -> None:
        while self._sent and self._sent[0][0] < now - ECHO_TIME:
            self._sent.popleft()
        self._sent.append((now, frame))
        message = to_message(frame)
        self.bus.send(message)
        self.statistics.sent += 1
        if self.log:
            message.timestamp = time.time()
            self.log(message)

    def _pass_a_cycle(self) -> None:
        """Let the drives see what one SDO request wrote before the next one is answered."""
        while self.statistics.cycles == self._cycles_at_request:
            time.sleep(1e-4)
            self._advance()
        self._cycles_at_request = self.statistics.cycles

    def close(self) -> None:
        """Close log and bus."""
        if self.log:
            self.log.stop()
        self.bus.shutdown()

    def _advance(self) -> None:
        for machine in self.machines:
            behind = time.monotonic() - self._begin - machine.time
            if behind > self.TOLERANCE:
                self.statistics.missed += 1
                self._begin += behind - self.TOLERANCE
                behind = self.TOLERANCE
            cycles = int(behind / machine.cycle_time)
            if cycles > 0:
                machine.step(cycles)
                self.statistics.cycles += cycles


def axis_for(drive: str, node_id: int, axis: str = "linear") -> Machine:
    """A machine whose drives have node-ids from `node_id` on, with all compiled that it needs.

    Args:
        drive: drive model by name or folder.
        node_id: of the first drive; 1..127 has to hold for the last one too.
        axis: key of `AXES`.

    Raises ValueError: unknown model or axis, node-id out of range.
    """
    if axis not in AXES:
        raise ValueError(f"--axis = {axis!r}: use one of {', '.join(AXES)}")
    make, places = AXES[axis]
    machine = make(drive)
    last = node_id + len(machine.drives) - 1
    if not 1 <= node_id <= last <= 127:
        raise ValueError(f"--node-id = {node_id}: {node_id}..{last} is out of range 1..127")
    for number, x in enumerate(machine.drives.values(), node_id):
        x.node_id = number
        x.reset_communication()
    machine.reset(positions=places)
    machine.step()
    machine.reset(positions=places)
    _warm_up(drive)
    return machine


def machines_for(drive: str, node_ids: Sequence[int], axis: str) -> list[Machine]:
    """A machine for each node-id; a drive of two axes has the next node-id for its second one."""
    machines = []
    for node_id in node_ids:
        for _ in range(load(drive).axes):
            machines.append(axis_for(drive, node_id, axis))
            node_id += len(machines[-1].drives)
    served = [x.node_id for machine in machines for x in machine.drives.values()]
    if len(set(served)) != len(served):
        raise ValueError(f"--node-id {[*node_ids]}: the nodes would be {served}, some twice")
    return machines


def _warm_up(drive: str) -> None:
    """Let a node move its PDOs once: the first one would wait seconds for the compiler."""
    node = Node(Drive(drive))
    node.receive(Frame(Base.NMT, bytes([NmtCommand.START, 0])), 0)
    node.receive(Frame(0x201, bytes(8)), 0)
    node.poll(0)


def run(
    drive: str, node_ids: Sequence[int], axis: str, interface: str, channel: str, bitrate: int,
    log: str | None, console: Console,
) -> int:  # fmt: skip
    """Serve until Ctrl-C; -> exit status."""
    with console.status("compiling the control cycle, once per version (up to 30 s) ..."):
        machines = machines_for(drive, node_ids, axis)
    try:
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate)
    except (can.CanError, OSError, ValueError, ImportError, NotImplementedError) as error:
        raise ValueError(
            f"no bus on -i {interface} -c {channel}: {error}; "
            "without hardware use -i udp_multicast -c 239.74.163.2"
        ) from None
    server = Server(bus, machines, can.Logger(log) if log else None)
    nodes = ", ".join(str(node.node_id) for node in server.nodes)
    console.print(f"{drive} as node {nodes} on {interface} {channel}")
    try:
        server.run()
    except KeyboardInterrupt:
        pass
    finally:
        server.close()
    s = server.statistics
    console.print(
        f"{s.received} frames received, {s.sent} sent, {s.cycles} position cycles, "
        f"{s.missed} deadlines missed"
    )
    return 0
