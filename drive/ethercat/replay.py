"""A master's recorded frames played into slaves of a model, and each answer scored.

Frames go in at their recorded times. A model may be quicker or slower than the drive was: a
mailbox that answers at another poll, a state that is reached earlier and clocks are explained by
time; measured values by physics. Mailbox telegrams are compared in their order.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

from ..model.model import DriveModel, Object, load
from ..score import Score, Verdict, live
from .bus import Bus
from .controller.registers import R
from .decode import REGISTERS, EtherCatDecoder
from .frame import LOGICAL, Datagram, body_of, unpack
from .mailbox import HEADER, Kind

# registers that show times, or errors of a cable: first and behind
CLOCKS = ((R.RECEIVE_TIME, R.SYSTEM_TIME_OFFSET), (R.SYSTEM_TIME_DIFFERENCE, 0x0930),
          (R.SPEED_COUNTER_DIFFERENCE, 0x0934), (R.START_TIME, R.SYNC0_CYCLE),
          (R.LATCH_TIME, 0x09D0))
CABLES = ((R.RX_ERRORS, 0x0314),)
POLLED = (R.AL_STATUS, R.AL_STATUS_CODE, R.SYNC_MANAGER + 5, R.SYNC_MANAGER + 13,
          R.EEPROM_CONTROL, R.DL_STATUS)
NAMED = 40  # bytes that are shown of a difference


def exchanges(frames: Iterable[tuple[int, bytes]]) -> Iterator[tuple[int, bytes, bytes]]:
    """Time (ns), request and reply of each frame that came back, of those with EtherCAT."""
    order = EtherCatDecoder()
    sent: dict[tuple[int, ...], tuple[int, bytes]] = {}
    for time, frame in frames:
        try:
            if body_of(frame) < 0:
                continue
            rows = unpack(frame)
        except ValueError:
            continue
        key = tuple(row.index << 16 | row.command << 8 | row.ado & 0xFF for row in rows)
        if not order.returned(frame, rows, key in sent):
            sent[key] = time, frame
        elif key in sent:
            begin, request = sent.pop(key)
            yield begin, request, frame


def slaves_of(pairs: Iterable[tuple[int, bytes, bytes]]) -> int:
    """How many slaves answer broadcasts in a recording; 1 where there is none."""
    most = 1
    for _, request, reply in pairs:
        if request[16:17] in (b"\x07", b"\x08"):
            most = max(most, unpack(reply)[0].wkc)
    return most


class Replay:
    """Slaves of a model that a recording is played into.

    Args:
        bus: with the slaves, and what they move.
        model: of the slaves; objects are told by its names.
    """

    def __init__(self, bus: Bus, model: str | Path | DriveModel):
        self.bus = bus
        self.score = Score()
        model = load(model, "ethercat")
        self._heard: list[dict[str, tuple[Object, float]]] = [{}, {}]
        self._sides = [EtherCatDecoder(model, self._ear(n)) for n in range(2)]
        self._telegrams: dict[str, tuple[deque[bytes], deque[bytes]]] = {}
        self._pending: dict[tuple[str, int], list[tuple[float, bytes, bytes]]] = {}
        self._begin: int | None = None
        self._time = 0.0

    def _ear(self, side: int):
        def hear(slave: str, row: Object, value: float) -> None:
            self._heard[side][f"{slave}: {row.index:04X}h:{row.subindex:02X}h {row.name}"] = (
                row, value,
            )

        return hear

    def run(self, pairs: Iterable[tuple[int, bytes, bytes]]) -> Score:
        """Play all of a recording; -> how the model answered."""
        for time, request, reply in pairs:
            self.exchange(time, request, reply)
        for key in [*self._pending]:
            self._settle(key, None)
        return self.score

    def exchange(self, time: int, request: bytes, reply: bytes) -> None:
        """One frame, sent at `time` (ns), and what came back of it."""
        self._begin = time if self._begin is None else self._begin
        self._time = (time - self._begin) * 1e-9
        answer = self.bus.exchange(request, time - self._begin)
        sent, recorded = unpack(request), unpack(reply)
        if answer is None:
            for row in recorded:
                self.score.differs(str(row)[:24], "a reply", "none", self._time)
            return
        for side, frame in enumerate((reply, answer)):
            self._heard[side].clear()
            self._sides[side].decode(request)
            self._sides[side].decode(frame)
        for out, back, own in zip(sent, recorded, unpack(answer), strict=True):
            self._datagram(out, back, own)

    def _datagram(self, sent: Datagram, back: Datagram, own: Datagram) -> None:
        name, slave = self._sides[0].addressee(sent)
        manager = self._sides[0].mailbox_of(slave, back.ado) if slave else None
        if back.command in LOGICAL:
            self._process_data(back, own)
        elif slave is not None and manager == 1:
            self._mailbox(name, back, own)
        elif back.ado in POLLED:
            self._poll(name, back, own)
        else:
            if back.ado == R.AL_CONTROL:
                for key in [*self._pending]:
                    self._settle(key, None)
            self._register(name, back, own)

    def _register(self, name: str, back: Datagram, own: Datagram) -> None:
        end = back.ado + len(back.data)
        if (back.data, back.wkc) == (own.data, own.wkc):
            self.score.add(Verdict.EQUAL)
        elif back.wkc == own.wkc and any(low < end and back.ado < high for low, high in CLOCKS):
            self.score.add(Verdict.TIME)
        elif back.wkc == own.wkc and any(low < end and back.ado < high for low, high in CABLES):
            self.score.add(Verdict.PHYSICS)
        else:
            self._tell(name, back.ado, back, own)

    def _tell(self, name: str, address: int, back: Datagram, own: Datagram) -> None:
        what = f"{name}: {REGISTERS.get(address, 'register')} ({address:04X}h)"
        shown = [
            f"{row.data.hex()[:NAMED]}" + (f" wkc {row.wkc}" if back.wkc != own.wkc else "")
            for row in (back, own)
        ]
        self.score.differs(what, shown[0], shown[1], self._time)

    # ------------------------------------------------------------------- polls

    def _poll(self, name: str, back: Datagram, own: Datagram) -> None:
        """A register that is read until it changes: the model may have changed before."""
        key = name, back.ado
        if back.data == own.data and back.wkc == own.wkc:
            self.score.add(Verdict.EQUAL)
            self._settle(key, back.data)
        elif back.wkc != own.wkc:
            self._tell(name, back.ado, back, own)
        else:
            self._settle(key, back.data)
            self._pending.setdefault(key, []).append((self._time, back.data, own.data))

    def _settle(self, key: tuple[str, int], value: bytes | None) -> None:
        """Polls that waited: the drive shows now what the model did, or never did (None)."""
        rest = []
        for time, recorded, own in self._pending.pop(key, []):
            if value == own:
                self.score.add(Verdict.TIME)
            elif value is None:
                what = f"{key[0]}: {REGISTERS.get(key[1], 'register')} ({key[1]:04X}h)"
                self.score.differs(what, recorded.hex(), own.hex(), time)
            else:
                rest.append((time, recorded, own))
        if rest:
            self._pending[key] = rest

    # ----------------------------------------------------------------- mailbox

    def _mailbox(self, name: str, back: Datagram, own: Datagram) -> None:
        queues = self._telegrams.setdefault(name, (deque(), deque()))
        for queue, row in zip(queues, (back, own), strict=True):
            if row.wkc:
                queue.append(row.data)
        if not (queues[0] and queues[1]):
            self.score.add(Verdict.TIME if back.wkc or own.wkc else Verdict.EQUAL)
            return
        while queues[0] and queues[1]:
            self._telegram(name, queues[0].popleft(), queues[1].popleft())

    def _telegram(self, name: str, recorded: bytes, own: bytes) -> None:
        bodies, kinds = [], []
        for data in (recorded, own):
            length, _, _, kind = HEADER.unpack_from(data.ljust(HEADER.size, b"\0"))
            bodies.append(data[HEADER.size : HEADER.size + length])
            kinds.append(kind & 0x0F)
        if bodies[0] == bodies[1] and kinds[0] == kinds[1]:
            self.score.add(Verdict.EQUAL)
            return
        what, row = f"{name}: mailbox", None
        if kinds[0] == Kind.COE and len(bodies[0]) >= 6:
            index, subindex = int.from_bytes(bodies[0][3:5], "little"), bodies[0][5]
            what, row = self._sides[0].named(index, subindex)
            what = f"{name}: {what}"
        same = bodies[0][:6] == bodies[1][:6] and len(bodies[0]) == len(bodies[1])
        if row is not None and same and live(row):
            self.score.add(Verdict.PHYSICS)
        else:
            self.score.differs(what, bodies[0].hex()[:NAMED], bodies[1].hex()[:NAMED], self._time)

    # ------------------------------------------------------------ process data

    def _process_data(self, back: Datagram, own: Datagram) -> None:
        if (back.data, back.wkc) == (own.data, own.wkc):
            self.score.add(Verdict.EQUAL)
            return
        if back.wkc != own.wkc:
            self.score.differs(f"process data {back.logical:08X}h", f"wkc {back.wkc}",
                               f"wkc {own.wkc}", self._time)
            return
        recorded, model = self._heard
        wrong = [(what, row, value, model[what][1]) for what, (row, value) in recorded.items()
                 if what in model and model[what][1] != value]
        named = [each for each in wrong if not live(each[1])]
        if named:
            what, _, value, other = named[0]
            self.score.differs(what, f"{value:g}", f"{other:g}", self._time)
        elif wrong:
            self.score.add(Verdict.PHYSICS)
        else:
            self.score.differs(f"process data {back.logical:08X}h", back.data.hex()[:NAMED],
                               own.data.hex()[:NAMED], self._time)
