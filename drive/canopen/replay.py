"""Plays a CAN log into a node of a model, and scores each answer of the drive.

What a master sent goes in at its time; what the drive sent is compared with what the model sends,
service by service in its order: SDO answers, emergencies, boot-up and state, PDOs.
"""

from collections import deque
from collections.abc import Iterable

from ..machine import Machine
from ..score import SERIAL, Score, Verdict, live
from .decode import Decoder
from .frame import Base, Frame
from .node import Node

SDO_RESPONSE, SDO_REQUEST, TPDO = 0x580, 0x600, (0x180, 0x280, 0x380, 0x480)
MICRO = 1_000_000
WAIT = 1.0  # s that an answer of the model may come later than the drive's


def node_of(frames: Iterable[Frame]) -> int | None:
    """The first node that answers an SDO or reports its state; None if there is none."""
    for frame in frames:
        base, node_id = frame.id & 0x780, frame.id & 0x7F
        if node_id and not frame.extended and base in (SDO_RESPONSE, Base.ERROR_CONTROL):
            return node_id
    return None


def replay(machine: Machine, node_id: int, rows: Iterable[tuple[float, Frame]]) -> Score:
    """Play a log into the drive of a machine.

    Args:
        machine: with the drive.
        node_id: of the drive in the log.
        rows: time (s) and frame, of the master and of all nodes.
    """
    drive = next(iter(machine.drives.values()))
    node, score = Node(drive, node_id), Score()
    heard: list[dict[str, float]] = [{}, {}]
    rows_of = {}

    def ear(side: int):
        def hear(_: int, row, value: float) -> None:
            key = f"{row.index:04X}h:{row.subindex:02X}h {row.name}"
            heard[side][key] = value
            rows_of[key] = row

        return hear

    decoders = [Decoder(drive.model, [node_id], ear(side)) for side in range(2)]
    waiting: dict[int, tuple[deque, deque]] = {}
    ours = {Base.ERROR_CONTROL + node_id, SDO_RESPONSE + node_id, 0x80 + node_id,
            *(base + node_id for base in TPDO)}
    begin: float | None = None
    cycle = round(machine.cycle_time * MICRO)
    now = ran = 0

    def compare(identifier: int) -> None:
        recorded, own = waiting[identifier]
        while recorded and own:
            time, frame = recorded.popleft()
            answer = own.popleft()
            for side in range(2):
                heard[side].clear()
            decoders[0].decode(frame)
            decoders[1].decode(answer)
            if frame.data == answer.data:
                score.add(Verdict.EQUAL)
                continue
            wrong = [k for k in heard[0] if k in heard[1] and heard[0][k] != heard[1][k]]
            named = [k for k in wrong if not live(rows_of[k])]
            if wrong and not named:
                score.add(Verdict.PHYSICS)
            elif named:
                key = named[0]
                score.differs(key, f"{heard[0][key]:g}", f"{heard[1][key]:g}", time)
            elif _serial(frame, answer):
                score.add(Verdict.PHYSICS)
            else:
                score.differs(_what(frame, drive), frame.data.hex(), answer.data.hex(), time)

    for stamp, frame in rows:
        begin = stamp if begin is None else begin
        now = round((stamp - begin) * MICRO)
        while ran + cycle <= now:
            machine.step()
            ran += cycle
            _collect(node, ran, waiting, ours)
        if frame.id in ours and not frame.remote:
            queue = waiting.setdefault(frame.id, (deque(), deque()))
            queue[0].append((now / MICRO, frame))
        else:
            for decoder in decoders:
                decoder.decode(frame)
            node.receive(frame, now)
        _collect(node, now, waiting, ours)
        for identifier in [*waiting]:
            compare(identifier)
    for _ in range(round(WAIT * MICRO / cycle)):
        ran += cycle
        machine.step()
        _collect(node, ran, waiting, ours)
    for identifier, (recorded, _) in waiting.items():
        compare(identifier)
        for time, frame in recorded:
            if identifier in (SDO_RESPONSE + node_id, 0x80 + node_id):
                score.differs(_what(frame, drive), frame.data.hex(), "nothing", time)
            else:
                score.add(Verdict.TIME)  # timers and events run at another pace
    return score


def _collect(node: Node, now: int, waiting: dict, ours: set[int]) -> None:
    for frame in node.poll(now):
        if frame.id in ours:
            waiting.setdefault(frame.id, (deque(), deque()))[1].append(frame)


def _serial(frame: Frame, answer: Frame) -> bool:
    head = SERIAL[0].to_bytes(2, "little") + bytes([SERIAL[1]])
    return frame.data[1:4] == answer.data[1:4] == head and frame.data[0] == answer.data[0]


def _what(frame: Frame, drive) -> str:
    base = frame.id & 0x780
    if base == SDO_RESPONSE and len(frame.data) == 8:
        index, subindex = int.from_bytes(frame.data[1:3], "little"), frame.data[3]
        row = drive.model.objects.get((index, subindex))
        return f"{index:04X}h:{subindex:02X}h {row.name if row else ''}".rstrip()
    return {0x80: "emergency", 0x700: "state"}.get(base, f"PDO {frame.id:03X}h")
