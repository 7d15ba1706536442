"""Comparison of SDO servers for `servogym bench --can`.

The peer is `LocalNode` of the library `canopen`, which answers SDO requests from a dictionary. It
and our node answer the same clients over python-can's virtual bus in alternating blocks, each on a
channel of its own, so that neither has to drop the other's frames. They run in a thread each, as
the library runs its node, and also in the thread of the client. The time to handle a frame without
bus, threads and client is measured as well; the rest of a round trip is due to these.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib.util import find_spec
from typing import Any

import can
import numpy as np

from ...drive.canopen.frame import Base, Frame
from ...drive.canopen.node import Node
from ...drive.drive import Drive
from ...drive.wire.bus import to_frame, to_message
from . import alternate, step_time

OURS, THEIRS = 1, 2  # node-ids
NAMES = {OURS: "servogym", THEIRS: "canopen"}
REQUESTS = (
    bytes.fromhex("4041600000000000"),  # upload 6041h
    bytes.fromhex("237A600010270000"),  # download 607Ah
)
PAIRS = 100  # in a block: an upload and a download each

Client = Callable[[int], None]  # one upload and one download of a node


def _dictionary() -> Any:
    """6041h and 607Ah as objects of `canopen`."""
    from canopen import objectdictionary

    dictionary = objectdictionary.ObjectDictionary()
    for name, index, data_type in (
        ("statusword", 0x6041, objectdictionary.UNSIGNED16),
        ("target_position", 0x607A, objectdictionary.INTEGER32),
    ):
        variable = objectdictionary.ODVariable(name, index, 0)
        variable.data_type, variable.default = data_type, 0
        dictionary.add_object(variable)
    return dictionary


@contextmanager
def _raw_client(channel: str) -> Iterator[Client]:
    """A loop over python-can's send and recv; the nodes have threads."""
    with _threads(channel), _bus(channel, OURS) as to_ours, _bus(channel, THEIRS) as to_theirs:
        buses = {OURS: to_ours, THEIRS: to_theirs}
        yield lambda node_id: _ask(buses[node_id], node_id)


@contextmanager
def _one_thread(channel: str) -> Iterator[Client]:
    """A loop over send and recv whose thread also runs the nodes."""
    import canopen

    with (
        _bus(channel, OURS) as to_ours,
        _bus(channel, THEIRS) as to_theirs,
        _bus(channel, OURS) as our_bus,
        _bus(channel, THEIRS) as their_bus,
    ):
        node = Node(Drive(node_id=OURS))
        node.poll(0)
        network = canopen.Network(their_bus)
        network.add_node(canopen.LocalNode(THEIRS, _dictionary()))

        def theirs() -> None:
            message = their_bus.recv(0)
            if message:
                network.notify(message.arbitration_id, message.data, message.timestamp)

        buses = {OURS: to_ours, THEIRS: to_theirs}
        serve: dict[int, Callable[[], None]] = {
            OURS: partial(_answer, our_bus, node, 0.0),
            THEIRS: theirs,
        }
        yield lambda node_id: _ask(buses[node_id], node_id, serve[node_id])


def _bus(channel: str, node_id: int) -> can.BusABC:
    return can.Bus(interface="virtual", channel=f"{channel}-{node_id}")


def _ask(bus: can.BusABC, node_id: int, serve: Callable[[], None] | None = None) -> None:
    """Send both requests and receive their answers."""
    for request in REQUESTS:
        bus.send(to_message(Frame(Base.SDO_REQUEST + node_id, request)))
        if serve:
            serve()
        answer = bus.recv(1.0)
        if answer is None or answer.data[0] not in (0x4B, 0x60):
            raise RuntimeError(f"{NAMES[node_id]} did not answer {request.hex()}: {answer}")


def _answer(bus: can.BusABC, node: Node, wait: float) -> None:
    """Let our node process a frame and answer at once."""
    message = bus.recv(wait)
    frame = to_frame(message) if message else None
    if frame:
        node.receive(frame, 0)
        for answer in node.poll(0):
            bus.send(to_message(answer))


@contextmanager
def _threads(channel: str) -> Iterator[None]:
    """Run both nodes on their buses, each in a thread."""
    import canopen

    network = canopen.Network()
    network.connect(interface="virtual", channel=f"{channel}-{THEIRS}")
    network.add_node(canopen.LocalNode(THEIRS, _dictionary()))
    stop = threading.Event()
    bus, node = _bus(channel, OURS), Node(Drive(node_id=OURS))
    node.poll(0)

    def serve() -> None:
        while not stop.is_set():
            _answer(bus, node, 0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        bus.shutdown()
        network.disconnect()


@contextmanager
def _library_client(channel: str) -> Iterator[Client]:
    """The SdoClient of `canopen`; the nodes have threads."""
    import canopen

    networks = {n: canopen.Network() for n in NAMES}
    nodes = {n: canopen.RemoteNode(n, _dictionary()) for n in NAMES}

    def pair(node_id: int) -> None:
        nodes[node_id].sdo.upload(0x6041, 0)
        nodes[node_id].sdo.download(0x607A, 0, REQUESTS[1][4:])

    with _threads(channel):
        for n, network in networks.items():
            network.connect(interface="virtual", channel=f"{channel}-{n}")
            network.add_node(nodes[n])
        try:
            yield pair
        finally:
            for network in networks.values():
                network.disconnect()


def _handling() -> dict[int, Callable[[], None]]:
    """Two requests handled, from the frame's bytes to those of the answer, for each node."""
    import canopen

    answers: list[tuple[int, bytes]] = []

    class Answers(canopen.Network):  # keeps the answers of the node
        def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
            answers.append((can_id, bytes(data)))

    to_ours, to_theirs = (int(Base.SDO_REQUEST) + n for n in NAMES)
    from_ours, from_theirs = (int(Base.SDO_RESPONSE) + n for n in NAMES)
    network = Answers()
    network.add_node(canopen.LocalNode(THEIRS, _dictionary()))
    node = Node(Drive(node_id=OURS))
    node.poll(0)

    def theirs() -> None:
        for request in REQUESTS:
            network.notify(to_theirs, bytearray(request), 0.0)
            if answers.pop()[0] != from_theirs:
                raise RuntimeError("canopen did not answer")

    def ours() -> None:
        for request in REQUESTS:
            node.receive(Frame(to_ours, request), 0)
            (answer,) = node.poll(0)
            if answer.id != from_ours:
                raise RuntimeError("servogym did not answer")

    return {OURS: ours, THEIRS: theirs}


def _times(pairs: Mapping[int, Callable[[], object]], repeat: int) -> dict[int, float]:
    """Median time of one request (s) by node-id."""
    taken = alternate([partial(step_time, pair, PAIRS) for pair in pairs.values()], repeat)
    return dict(zip(pairs, (np.median(taken, axis=0) / len(REQUESTS)).tolist(), strict=True))


def measure(repeat: int) -> dict[str, Any]:
    """Requests per second of both servers: handling alone, and round trips of two clients.

    Raises ImportError without `canopen`.
    """
    if find_spec("canopen") is None:
        raise ImportError("--can compares with the library canopen: pip install canopen")
    handling = _times(_handling(), repeat * 5)
    results: dict[str, Any] = {"handling": _compare(handling, handling)}
    for name, client in CLIENTS.items():
        with client(f"servogym-bench-{name}-{id(results)}") as pair:
            times = _times({n: partial(pair, n) for n in NAMES}, repeat)
        results[name] = _compare(times, handling)
    return results


CLIENTS: dict[str, Callable[[str], AbstractContextManager[Client]]] = {
    "raw_loop": _raw_client,
    "sdo_client": _library_client,
    "one_thread": _one_thread,
}


def _compare(times: dict[int, float], handling: dict[int, float]) -> dict[str, float]:
    result = {f"{NAMES[n]}_per_s": 1 / t for n, t in times.items()}
    for n, t in times.items():  # share of client, bus and threads
        result[f"{NAMES[n]}_others_share"] = max(0.0, 1 - handling[n] / t)
    return result | {"ratio": times[THEIRS] / times[OURS]}
