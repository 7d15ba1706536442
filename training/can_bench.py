"""`servogym bench --can`: SDO servers side by side on one virtual bus, and drives in lock-step.

The library `canopen` has a `LocalNode` that answers SDO requests from a dictionary; it is the
comparison. It and our node sit on one bus of python-can, in a thread each, and answer the same
clients in alternating blocks. What handling a frame costs without bus, threads and client is
measured as well; the rest of a round trip is theirs.
"""

import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import can
import numpy as np
from rich.console import Console
from rich.table import Table

from ..drive.canopen.bit_time import length
from ..drive.canopen.frame import Base, Frame
from ..drive.canopen.node import NmtCommand, Node
from ..drive.drive import Drive
from ..drive.words import Mode, State
from ..envs.linear_axis import linear_axis
from ..envs.machine import Machine
from ..envs.supervisor import TO_ENABLED
from .lockstep import LockStep
from .node import to_frame, to_message

OURS, THEIRS = 1, 2  # node-ids
NAMES = {OURS: "servogym", THEIRS: "canopen"}
REQUESTS = (
    bytes.fromhex("4041600000000000"),  # upload 6041h
    bytes.fromhex("237A600010270000"),  # download 607Ah
)
PAIRS = 100  # an upload and a download each, in a block
SYNC_PERIOD = 1000  # µs
RPDOS = [
    ["controlword", "modes_of_operation", "target_position"],
    ["velocity_offset", "torque_offset"],
]
TPDOS = [
    ["statusword", "position_actual_value", "torque_actual_value"],
    ["velocity_actual_value", "following_error_actual_value"],
]
STATES = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)

Client = Callable[[int], None]  # one upload and one download of a node


def _dictionary() -> Any:
    """6041h and 607Ah as `canopen` knows objects."""
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


def _serve(bus: can.BusABC, node: Node, stop: threading.Event) -> None:
    """Our node in a thread: every frame it receives is handled at once."""
    while not stop.is_set():
        message = bus.recv(0.05)
        frame = to_frame(message) if message else None
        if frame:
            node.receive(frame, 0)
            for answer in node.poll(0):
                bus.send(to_message(answer))


@contextmanager
def _servers(channel: str) -> Iterator[None]:
    """Both nodes on the bus, each in a thread."""
    import canopen

    network = canopen.Network()
    network.connect(interface="virtual", channel=channel)
    network.add_node(canopen.LocalNode(THEIRS, _dictionary()))
    stop = threading.Event()
    bus = can.Bus(interface="virtual", channel=channel)
    thread = threading.Thread(target=_serve, args=(bus, Node(Drive(node_id=OURS)), stop))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        bus.shutdown()
        network.disconnect()


@contextmanager
def _raw_client(channel: str) -> Iterator[Client]:
    """A loop over python-can's own send and recv."""
    with can.Bus(interface="virtual", channel=channel) as bus:

        def pair(node_id: int) -> None:
            for request in REQUESTS:
                bus.send(to_message(Frame(Base.SDO_REQUEST + node_id, request)))
                answer = bus.recv(1.0)
                while answer and answer.arbitration_id != Base.SDO_RESPONSE + node_id:
                    answer = bus.recv(1.0)
                if answer is None or answer.data[0] not in (0x4B, 0x60):
                    raise RuntimeError(f"{NAMES[node_id]} did not answer {request.hex()}: {answer}")

        yield pair


@contextmanager
def _library_client(channel: str) -> Iterator[Client]:
    """The SdoClient of `canopen`."""
    import canopen

    network = canopen.Network()
    network.connect(interface="virtual", channel=channel)
    nodes = {n: canopen.RemoteNode(n, _dictionary()) for n in NAMES}
    for node in nodes.values():
        network.add_node(node)

    def pair(node_id: int) -> None:
        nodes[node_id].sdo.upload(0x6041, 0)
        nodes[node_id].sdo.download(0x607A, 0, REQUESTS[1][4:])

    try:
        yield pair
    finally:
        network.disconnect()


def _handling() -> dict[int, Callable[[], None]]:
    """Two requests handled, from the frame's bytes to those of the answer, for each node."""
    import canopen

    answers: list[tuple[int, bytes]] = []

    class Answers(canopen.Network):  # keeps what the node would send
        def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
            answers.append((can_id, bytes(data)))

    network = Answers()
    network.add_node(canopen.LocalNode(THEIRS, _dictionary()))
    node = Node(Drive(node_id=OURS))
    node.poll(0)

    def theirs() -> None:
        for request in REQUESTS:
            network.notify(Base.SDO_REQUEST + THEIRS, bytearray(request), 0.0)
            if answers.pop()[0] != Base.SDO_RESPONSE + THEIRS:
                raise RuntimeError("canopen did not answer")

    def ours() -> None:
        for request in REQUESTS:
            node.receive(Frame(Base.SDO_REQUEST + OURS, request), 0)
            (answer,) = node.poll(0)
            if answer.id != Base.SDO_RESPONSE + OURS:
                raise RuntimeError("servogym did not answer")

    return {OURS: ours, THEIRS: theirs}


def _times(functions: dict[int, Callable[[], object]], repeat: int) -> dict[int, float]:
    """Median time of one request (s), in alternating blocks."""
    blocks: dict[int, list[float]] = {name: [] for name in functions}
    for _ in range(repeat + 1):  # the first one warms up
        for name, function in functions.items():
            begin = time.perf_counter()
            for _ in range(PAIRS):
                function()
            blocks[name].append((time.perf_counter() - begin) / PAIRS / len(REQUESTS))
    return {name: float(np.median(times[1:])) for name, times in blocks.items()}


def sdo(repeat: int) -> dict[str, Any]:
    """Requests per second of both servers: handling alone, and round trips of two clients.

    Raises ImportError without `canopen`.
    """
    handling = _times(_handling(), repeat * 5)
    results: dict[str, Any] = {"handling": _compare(handling, handling)}
    channel = f"servogym-bench-{id(results)}"
    with _servers(channel):
        for name, client in (("raw_loop", _raw_client), ("sdo_client", _library_client)):
            with client(channel) as pair:
                times = _times({n: lambda n=n: pair(n) for n in NAMES}, repeat)  # type: ignore[misc]
            results[name] = _compare(times, handling)
    return results


def _compare(times: dict[int, float], handling: dict[int, float]) -> dict[str, float]:
    result = {f"{NAMES[n]}_per_s": 1 / t for n, t in times.items()}
    for n, t in times.items():  # of client, bus and threads
        result[f"{NAMES[n]}_others_share"] = max(0.0, 1 - handling[n] / t)
    return result | {"ratio": times[THEIRS] / times[OURS]}


def axis_in_csp(node_id: int, period: int = SYNC_PERIOD) -> Machine:
    """A linear axis that takes two RPDOs and sends two TPDOs at every SYNC of `period` (µs)."""
    machine = linear_axis()
    (drive,) = machine.drives.values()
    drive.node_id = node_id
    drive.reset_communication()
    drive.map_pdos(RPDOS, TPDOS)
    for n in range(2):
        drive.write(0x1400 + n, 2, 1)
        drive.write(0x1800 + n, 2, 1)
    drive.write("interpolation_time_period_value", period // 100)
    drive.write("interpolation_time_index", -4)
    machine.reset(positions={"x": 0.1})
    return machine


def lockstep(drives: int, syncs: int) -> dict[str, float]:
    """Simulated time over real time of drives in csp on one loop-back, and what the bus would say.

    Raises RuntimeError where a drive is not enabled at the end or a TPDO is missing.
    """
    run = LockStep([axis_in_csp(n) for n in range(1, drives + 1)], SYNC_PERIOD)
    master = run.bus.join()
    master.send(Frame(Base.NMT, bytes([NmtCommand.START, 0])), 0)
    frames: list[Frame] = []

    def cycle(number: int) -> None:
        nonlocal frames
        word = TO_ENABLED[STATES[min(number // 10, len(STATES) - 1)]]
        target = round(20_000 * np.sin(number * 2e-3))
        sent = [
            frame
            for n in range(1, drives + 1)
            for frame in (
                Frame(0x200 + n, struct.pack("<Hbi", word, Mode.CYCLIC_SYNC_POSITION, target)),
                Frame(0x300 + n, bytes(6)),
            )
        ]
        for frame in sent:
            master.send(frame, run.time)
        run.sync()
        frames = [*sent, *master.receive(run.time)]

    for number in range(100):
        cycle(number)
    begin = time.perf_counter()
    for number in range(100, 100 + syncs):
        cycle(number)
    elapsed = time.perf_counter() - begin
    asleep = [n.node_id for n in run.nodes if n.drive.state != State.OPERATION_ENABLED]
    if asleep or len(frames) != drives * (len(RPDOS) + len(TPDOS)) + 1:
        raise RuntimeError(f"drives {asleep} are not enabled, {len(frames)} frames a cycle")
    return {
        "drives": drives,
        "sync_period_us": SYNC_PERIOD,
        "frames_per_sync": len(frames),
        "times_real_time": syncs * SYNC_PERIOD * 1e-6 / elapsed,
        "load_at_1_mbit_s": sum(map(length, frames)) / SYNC_PERIOD,  # above 1: does not fit
    }


def measure(repeat: int) -> dict[str, Any]:
    """Both measurements; `repeat` blocks of requests, 10 SYNCs a block."""
    return {"sdo": sdo(max(repeat // 4, 3)), "lockstep": lockstep(8, max(10 * repeat, 100))}


def show(results: dict[str, Any], console: Console) -> None:
    """Print what `measure` gave."""
    table = Table(title="SDO requests per second, expedited, half uploads and half downloads")
    for column in ("", "servogym", "canopen", "ratio", "client, bus, threads"):
        table.add_column(column, justify="right" if column else "left")
    for key, name in (
        ("handling", "handling alone"),
        ("raw_loop", "round trip, raw loop"),
        ("sdo_client", "round trip, SdoClient"),
    ):
        r = results["sdo"][key]
        table.add_row(
            name, f"{r['servogym_per_s']:.0f}", f"{r['canopen_per_s']:.0f}", f"{r['ratio']:.2f}",
            f"{r['servogym_others_share']:.0%}, {r['canopen_others_share']:.0%}",
        )  # fmt: skip
    console.print(table)
    r = results["lockstep"]
    console.print(
        f"{r['drives']} drives, SYNC every {r['sync_period_us']} µs, {r['frames_per_sync']} frames "
        f"each: {r['times_real_time']:.2f} times real time on one core "
        f"(at 1 Mbit/s their load would be {r['load_at_1_mbit_s']:.1f})"
    )
