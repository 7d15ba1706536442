"""A CANopen node around one drive: the switchboard of its communication services (CiA 301, 305).

The node performs no input or output: `receive` takes frames, `poll` returns them, and time (µs, an
integer) is an argument of both. The owner of the node transfers the frames and runs the drive's
cycles. A table maps each identifier to its services; it is rebuilt when a communication object or
the NMT state has changed.
"""

from collections import deque
from collections.abc import Callable

from ..drive import Drive
from ..model.model import load
from .emcy import Emergency
from .frame import Base, Frame, Route
from .heartbeat import HeartbeatConsumer, HeartbeatProducer, NodeGuarding
from .lss import UNCONFIGURED, LssSlave, LssState
from .nmt import LIVE, TARGET, NmtCommand, NmtState, Service
from .rpdo import Receiver
from .sdo_servers import SdoServers
from .sync import Sync
from .time_stamp import TimeStamp
from .tpdo import Transmitter

__all__ = ["NmtCommand", "NmtState", "Node"]

QUEUE = 1024  # frames to be polled; when full, the oldest is lost
_AFTER_ERROR = {  # 1029h:01, from OPERATIONAL for 0; 1: no change
    0: NmtState.PRE_OPERATIONAL,
    2: NmtState.STOPPED,
}


class Node:
    """A drive on a CAN bus.

    Args:
        drive: the drive.
        node_id: 1..127, or 255 for a node that waits for LSS to assign one. By default the node-id
            that LSS has stored in the drive, otherwise that of the drive.

    Raises ValueError: node_id is out of range, or the drive is on another bus.
    """

    def __init__(self, drive: Drive, node_id: int | None = None):
        load(drive.model, "can")
        if drive.model.bus != "can":
            raise ValueError(
                f'drive {drive.model.name!r} is on {drive.model.bus}: make it with bus="can"'
            )
        stored_node_id, stored_bit_rate = drive.parameters.lss or (drive.node_id, 0)
        node_id = stored_node_id if node_id is None else node_id
        if not 1 <= node_id <= 127 and node_id != UNCONFIGURED:
            raise ValueError(
                f"node_id = {node_id} is out of range 1..127; 255 lets the node wait for LSS"
            )
        self.drive = drive
        self.node_id = node_id
        self.state = NmtState.INITIALISING
        self._out: deque[Frame] = deque(maxlen=QUEUE)
        self._in_window: deque[Frame] = deque(
            maxlen=QUEUE
        )  # synchronous TPDOs, dropped when the window closes
        vendor, product, revision, serial = (drive.objects.value(0x1018, n) for n in range(1, 5))
        self.lss = LssSlave(
            (vendor, product, revision, serial), node_id, self._sender(Base.LSS_RESPONSE),
            stored_bit_rate or None, drive.parameters.keep_lss,
        )
        self.emergency = Emergency(drive, self._send)
        self.sync = Sync(drive, self.emergency)
        self.time_stamp = TimeStamp(drive)
        self.heartbeat = HeartbeatProducer(drive)
        self.heartbeat_consumer = HeartbeatConsumer(drive, self.emergency)
        self.guarding = NodeGuarding(drive, self.emergency)
        self._sdo = SdoServers(drive, self._sender)
        self._receiver = Receiver(drive, self.sync, self.emergency)
        self._transmitter = Transmitter(drive, self._out.append)
        self._resettable = (
            self.emergency, self.sync, self.time_stamp, self.heartbeat, self.heartbeat_consumer,
            self.guarding, self._receiver, self._sdo,
        )
        own = slice(drive.index, drive.index + 1)
        self._lost = drive.axes["connection_lost"][own]
        self._pulse = drive.axes["sync_pulse"][own]
        if node_id not in (UNCONFIGURED, drive.node_id):
            drive.node_id = node_id
            drive.reset_communication()
        self._boot()

    @property
    def bit_rate(self) -> int | None:
        """The bit rate set by LSS (bit/s), None before; the owner of the bus has to apply it."""
        return self.lss.bit_rate

    # ------------------------------------------------------------------- NMT

    def _boot(self) -> None:
        """Reset all services, send boot-up and enter PRE-OPERATIONAL; without node-id, only LSS."""
        self.state = NmtState.INITIALISING
        self.drive.operational = False
        self._lost[0] = 0
        self._in_window.clear()
        for service in self._resettable:
            service.reset()
        self._configure()
        if self.node_id != UNCONFIGURED:
            self._send(Base.ERROR_CONTROL + self.node_id, b"\0")
            self._enter(NmtState.PRE_OPERATIONAL)

    def _enter(self, state: NmtState) -> None:
        if state == NmtState.OPERATIONAL and self.state != state:
            self._transmitter.start()
        if state != NmtState.OPERATIONAL:
            self._receiver.forget()
            self._in_window.clear()
        if state == NmtState.STOPPED:
            self.sync.stop()
            self._sdo.stop()
        self.state = state
        self.drive.operational = state == NmtState.OPERATIONAL
        self._connect()

    def _nmt(self, data: bytes, time: int) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        if data[0] == NmtCommand.RESET_NODE:
            self.lss.power_on()
            self._take_node_id()
            self.drive.reset()
            self._boot()
        elif data[0] == NmtCommand.RESET_COMMUNICATION:
            self._reset_communication()
        elif data[0] in TARGET:
            self._enter(TARGET[NmtCommand(data[0])])

    def _reset_communication(self) -> None:
        self._take_node_id()
        self.drive.reset_communication()
        self._boot()

    def _adopt(self) -> None:
        """Adopt the node-id for which the drive has reset itself (parameter 387 of the ACT)."""
        assert self.drive.wanted_node_id is not None
        self.lss.stored_node_id, self.drive.wanted_node_id = self.drive.wanted_node_id, None
        self.lss.power_on()
        self._reset_communication()

    def _take_node_id(self) -> None:
        """Activate the node-id that LSS has configured."""
        self.node_id = self.lss.active_node_id = self.lss.node_id
        if self.node_id != UNCONFIGURED:
            self.drive.node_id = self.node_id

    # ----------------------------------------------------------- switchboard

    def _configure(self) -> None:
        """Let the services read their objects, and rebuild the tables."""
        self._version = self.drive.communication_version
        for service in self._resettable:
            service.configure()
        self._lost[0] = self._any_lost()
        self._transmitter.configure()
        self._connect()

    def _connect(self) -> None:
        """Build the tables from identifier to service for the NMT state."""
        routes: dict[Service, list[Route]] = {
            Service.LSS: [(Base.LSS_REQUEST, self._lss)],
            Service.NMT: [(Base.NMT, self._nmt)],
            Service.ERROR_CONTROL: self.heartbeat_consumer.routes,
            Service.SYNC: [(self.sync.identifier, self._sync)],
            Service.TIME: self.time_stamp.routes,
            Service.SDO: self._sdo.routes,
            Service.PDO: self._receiver.routes,
        }
        remote: dict[Service, list[Route]] = {
            Service.ERROR_CONTROL: [(Base.ERROR_CONTROL + self.node_id, self._guard)],
            Service.PDO: self._transmitter.routes,
        }
        live = LIVE[self.state]
        self._data_routes = self._table(routes, live)
        self._remote_routes = self._table(remote, live)
        pollers: tuple[tuple[Service, bool, Callable[[int], None]], ...] = (
            *((Service.SDO, True, server.poll) for server in self._sdo.servers.values()),
            (Service.ERROR_CONTROL, self._watches(), self._watch),
            (Service.PDO, self._receiver.monitors, self._receiver.poll),
            (Service.EMCY, True, self.emergency.poll),
            (Service.ERROR_CONTROL, self.heartbeat.produces, self._heartbeat),
            (Service.SYNC, self.sync.produces, self._produce_sync),
            (Service.PDO, True, self._flush_window),
            (Service.PDO, self._transmitter.has_events, self._transmitter.poll),
        )
        self._pollers = [poll for service, used, poll in pollers if used and service & live]

    def _table(
        self, routes: dict[Service, list[Route]], live: Service
    ) -> dict[int, list[Callable[[bytes, int], None]]]:
        table: dict[int, list[Callable[[bytes, int], None]]] = {}
        for service, pairs in routes.items():
            if service & live:
                for identifier, take in pairs:
                    table.setdefault(identifier, []).append(take)
        return table

    def _send(self, identifier: int, data: bytes) -> None:
        self._out.append(Frame(identifier, data))

    def _sender(self, identifier: int) -> Callable[[bytes], None]:
        put = self._out.append
        return lambda data: put(Frame(identifier, data))

    def receive(self, frame: Frame, time: int) -> None:
        """Process a frame at `time` (µs); frames for others and invalid ones are ignored."""
        if self._version != self.drive.communication_version:
            self._configure()
        identifier, data, remote, extended = frame
        takers = (self._remote_routes if remote else self._data_routes).get(identifier)
        if takers is None or extended or len(data) > 8:
            return
        if self.lss.bit_rate_switch is not None and self.lss.switching(time):
            return
        for take in takers:
            take(data, time)

    def _lss(self, data: bytes, time: int) -> None:
        self.lss.request(data, time)
        waiting = self.lss.state == LssState.WAITING
        if waiting and self.node_id == UNCONFIGURED and self.lss.node_id != UNCONFIGURED:
            self._reset_communication()

    def _guard(self, data: bytes, time: int) -> None:
        answer = self.guarding.answer(self.state, time)
        if answer is not None:
            self._send(Base.ERROR_CONTROL + self.node_id, answer)

    def _sync(self, data: bytes, time: int) -> None:
        counter = self.sync.take(data, time)
        self._pulse[0] = counter is not None
        if counter is not None and self.state == NmtState.OPERATIONAL:
            self._receiver.sync()
            self._in_window += self._transmitter.sync(counter, time)

    # ------------------------------------------------------------------ poll

    def poll(self, time: int) -> list[Frame]:
        """Return the frames to send at `time` (µs), in order."""
        if self.drive.wanted_node_id is not None:
            self._adopt()
        if self._version != self.drive.communication_version:
            self._configure()
        if self.lss.bit_rate_switch is not None and self.lss.switching(time):
            return []
        pollers = self._pollers
        for poll in pollers:
            poll(time)
            if pollers is not self._pollers:
                break  # the NMT state has changed, so other services are active
        frames = [*self._out]
        self._out.clear()
        return frames

    def _heartbeat(self, time: int) -> None:
        if self.heartbeat.due(time):
            self._send(Base.ERROR_CONTROL + self.node_id, bytes([self.state]))

    def _produce_sync(self, time: int) -> None:
        data = self.sync.produce(time)
        if data is not None:
            self._send(self.sync.identifier, data)
            self._sync(data, time)

    def _flush_window(self, time: int) -> None:
        if self._in_window:
            if self.sync.open(time):
                self._out += self._in_window
            self._in_window.clear()

    def _watch(self, time: int) -> None:
        """Lost heartbeats and life guarding: 1029h for the node, 6007h for the drive."""
        lost = self.heartbeat_consumer.poll(time) | self.guarding.poll(time)
        self._lost[0] = self._any_lost()
        if not lost:
            return
        state = _AFTER_ERROR.get(self.drive.objects.value(0x1029, 1))
        if state == NmtState.STOPPED or (state and self.state == NmtState.OPERATIONAL):
            if self.state != NmtState.STOPPED:
                self.emergency.poll(time)  # a stopped node sends no EMCY (inferred)
            self._enter(state)

    def _watches(self) -> bool:
        return self.heartbeat_consumer.monitors or self.guarding.monitors

    def _any_lost(self) -> bool:
        return bool(self.heartbeat_consumer.lost) or self.guarding.lost
