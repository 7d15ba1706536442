"""Explains the frames of an EtherCAT capture: registers, states, mailboxes, process data.

The configuration in the capture is tracked (station addresses, sync managers, FMMUs, PDO assignment
and mapping), so process data of any bus are named by objects. The drive model of a slave follows
from its identity in the EEPROM unless one is given. Only changes of process data are printed. An
outgoing frame is kept until it returns, because slaves overwrite the data in it.
"""

import functools
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ..kernel.words import Mode, decode_controlword, decode_statusword
from ..model.model import DriveModel, Object, load, model_names
from ..model.pdo import mapping_entry
from ..objects.abort import TEXT
from .al import AlState, AlStatusCode
from .coe_header import Service
from .controller.registers import REGISTERS_TABLE, Effect, R
from .description import describe
from .frame import LOGICAL, NAMES, Command, Datagram, body_of, unpack
from .mailbox import HEADER, Kind

READS = (Command.APRD, Command.FPRD, Command.BRD, Command.LRD)
POSITION = (Command.APRD, Command.APWR, Command.APRW, Command.ARMW)
BROADCAST = (Command.BRD, Command.BWR, Command.BRW)
PASSED = 2  # bit of the source address that slaves set
RETURNED = 6  # byte of the frame that contains it
ASSIGNMENTS = {0x1C12: 2, 0x1C13: 3}
IDENTITY = 8  # word of the EEPROM from which vendor and product start
# bits of AL Control and AL Status (ETG.1000.6, 5.3.1 and 5.3.2)
AL_CONTROL_BITS = ((0x10, "acknowledge"), (0x20, "identification requested"))
AL_STATUS_BITS = ((0x10, "error bit"), (0x20, "identification shown"))
EEPROM_COMMANDS = {2: "write", 4: "reload"}
EEPROM_ERRORS = (  # bits of 0502h
    (0x0800, "checksum wrong"), (0x1000, "not loaded"), (0x2000, "refused"),
    (0x4000, "write not enabled"),
)
QUIET = {  # polled registers, which are printed when they change
    R.AL_STATUS, R.AL_STATUS_CODE, R.SYNC_MANAGER + 5, R.SYNC_MANAGER + 13, R.DL_STATUS,
    R.EEPROM_CONTROL, R.SYSTEM_TIME, R.SYSTEM_TIME_DIFFERENCE,
}


def _registers() -> dict[int, str]:
    """Name of the register that begins at an address."""
    many = (Effect.SYNC_MANAGER, Effect.FMMU)  # a row for each byte
    names = {row.address: row.name for row in REGISTERS_TABLE if row.effect not in many}
    return names | {
        R.AL_STATUS_CODE: "AL status code", R.EEPROM_CONTROL: "EEPROM control and status",
    }


REGISTERS = _registers()


@dataclass
class _Fmmu:
    """An FMMU; `kind` is 0 unless it maps whole bytes."""

    logical: int
    length: int
    physical: int
    kind: int


@dataclass
class _Slave:
    """The state of a slave as far as the capture shows it."""

    name: str
    model: DriveModel | None
    managers: dict[int, tuple[int, int]] = field(default_factory=dict)  # start and length
    fmmus: dict[int, _Fmmu] = field(default_factory=dict)
    assigned: dict[int, list[int]] = field(default_factory=dict)  # sync manager -> PDOs
    mapped: dict[int, list[int]] = field(default_factory=dict)  # PDO -> entries
    values: dict[tuple[int, int], int] = field(default_factory=dict)  # as printed last
    polled: dict[int, bytes] = field(default_factory=dict)
    word: int = -1  # address in the EEPROM that is being read
    vendor: bytes = b""
    written: tuple[int, int, bytes] | None = None  # by SDO, waits for the answer
    mode: int = 0

    def entries(self, manager: int) -> list[int]:
        """Mapped objects of a sync manager according to the capture or the model."""
        defaults = _mappings(self.model) if self.model else {}
        pdos = self.assigned.get(manager)
        if pdos is None:
            index = next(index for index, number in ASSIGNMENTS.items() if number == manager)
            pdos = [self._default(index, n + 1) for n in range(self._default(index, 0))]
        return [entry for pdo in pdos for entry in self.mapped.get(pdo, defaults.get(pdo, []))]

    def _default(self, index: int, subindex: int) -> int:
        row = self.row(index, subindex)
        return int(row.default or 0) if row else 0

    def row(self, index: int, subindex: int) -> Object | None:
        """The row of an object; None if the model does not have it or is unknown."""
        return self.model.objects.get((index, subindex)) if self.model else None

    def object(self, index: int, subindex: int) -> str:
        """Name of an object, or its address if it is unknown."""
        row = self.row(index, subindex)
        return row.name if row else f"{index:04X}h:{subindex:02X}"

    def text(self, index: int, subindex: int, data: bytes) -> str:
        """Format a value with the name of its object."""
        if 0x1600 <= index < 0x1C00 and subindex and len(data) == 4:
            *target, bits = mapping_entry(int.from_bytes(data, "little"))
            return f"{index:04X}h:{subindex:02X} = {self.object(*target)}, {bits} bits"
        if index in ASSIGNMENTS and subindex and len(data) == 2:
            return f"{self.object(index, subindex)} = {int.from_bytes(data, 'little'):04X}h"
        row = self.row(index, subindex)
        if row is None or not row.format or row.size != len(data):
            text = data.rstrip(b"\0")
            if len(data) > 8 and text.isascii() and text.decode("ascii").isprintable():
                return f"{self.object(index, subindex)} = {text.decode('ascii')!r}"
            return f"{self.object(index, subindex)} = {data.hex()}"
        value, own = row.code.unpack(data)[0], self.model.own_modes if self.model else {}
        if index in (0x6060, 0x6061):
            self.mode = value
            name = Mode(value).name if value in {*Mode} else ""
            return f"{row.name} = {value} {own[value].name if value in own else name}".rstrip()
        if index == 0x6040:
            return f"{row.name} {value:04X}h {' '.join(decode_controlword(value, self.mode, own))}"
        if index == 0x6041:
            return f"{row.name} {value:04X}h → {' '.join(decode_statusword(value, self.mode, own))}"
        return f"{row.name} = {value}"


class EtherCatDecoder:
    """Explains the frames of a segment.

    Args:
        model: drive model of slaves whose identity is not in the capture; with None, their objects
            are shown by number.
        heard: called with slave, object and value (drive units) of each number in process data or
            SDO; for a write, after the slave has confirmed it.

    Raises:
        ValueError: unknown model.
    """

    def __init__(
        self, model: str | Path | DriveModel | None = None,
        heard: Callable[[str, Object, float], None] = lambda slave, row, value: None,
    ):
        self.others = 0  # frames of other protocols
        self._marked = False  # a frame without `PASSED` was recorded, so the bit is conclusive
        self._heard = heard
        self._given = load(model, "ethercat") if model else None
        self._stations: dict[int, _Slave] = {}
        self._positions: dict[int, _Slave] = {}
        self._sent: dict[tuple[int, ...], list[Datagram]] = {}
        self._known = _identities()

    def decode(self, frame: bytes) -> list[str]:
        """Explain a frame in lines; none if nothing is new or it is not an EtherCAT frame.

        Never raises; `others` counts frames of other protocols.
        """
        if body_of(frame) < 0:
            self.others += 1
            return []
        try:
            rows = unpack(frame)
        except ValueError as error:
            return [str(error)]
        key = tuple(row.index << 16 | row.command << 8 | row.ado & 0xFF for row in rows)
        if not self.returned(frame, rows, key in self._sent):
            again = key in self._sent
            self._sent[key] = rows
            return [f"no reply to {rows[0]}"] if again else []
        sent = self._sent.pop(key, rows)
        lines: list[str] = []
        for out, back in zip(sent, rows, strict=False):
            lines += self._datagram(out, back)
        return lines

    def returned(self, frame: bytes, rows: list[Datagram], sent: bool) -> bool:
        """Whether a frame has passed the slaves, which set a bit of its source address.

        Some masters use locally administered addresses, which have that bit set from the start.
        Then a frame has passed if it was sent before or if a slave has counted it.
        """
        if not frame[RETURNED] & PASSED:
            self._marked = True
            return False
        return self._marked or sent or any(row.wkc for row in rows)

    def named(self, index: int, subindex: int) -> tuple[str, Object | None]:
        """Address and name of an object, and its row in the model if there is one."""
        row = self._given.objects.get((index, subindex)) if self._given else None
        return f"{index:04X}h:{subindex:02X}h {row.name if row else ''}".rstrip(), row

    # -------------------------------------------------------------- datagrams

    def _datagram(self, sent: Datagram, back: Datagram) -> list[str]:
        if back.command in LOGICAL:
            return self._process_data(sent, back)
        if back.command not in NAMES:
            return [f"unknown command {back.command:02X}h"]
        if back.command == Command.NOP:
            return []
        name, slave = self.addressee(sent)
        if slave is None:
            return self._register(name, None, sent, back)
        manager = self.mailbox_of(slave, back.ado)
        if manager is not None and back.wkc:
            return self._telegram(slave, sent.data if manager == 0 else back.data)
        if manager is not None:  # an empty mailbox that is polled, or a full one that is written
            return [] if manager else [f"{slave.name}: its mailbox is still full"]
        return self._register(name, slave, sent, back)

    def addressee(self, row: Datagram) -> tuple[str, _Slave | None]:
        """Name and state of the slave that a datagram addresses; None for all slaves."""
        if row.command in BROADCAST:
            return "all slaves", None
        if row.command in POSITION:
            place = -row.adp & 0xFFFF
            slave = self._positions.setdefault(place, _Slave(f"slave {place}", self._given))
        else:
            slave = self._stations.setdefault(row.adp, _Slave(f"slave {row.adp:04X}h", self._given))
        return slave.name, slave

    def mailbox_of(self, slave: _Slave, address: int) -> int | None:
        """0 or 1 if the outgoing or incoming mailbox of a slave begins at an address."""
        for n in (0, 1):
            if n in slave.managers and slave.managers[n][0] == address:
                return n
        return None

    def _register(
        self, name: str, slave: _Slave | None, sent: Datagram, back: Datagram
    ) -> list[str]:
        writes = back.command not in READS
        data = sent.data if writes else back.data
        what = "write" if writes else "read"
        if not back.wkc:
            return [f"{name}: {what} {_place(back.ado)} had no effect (working counter 0)"]
        if not data:
            return [f"{name}: {what} {_place(back.ado)} of no bytes"]
        if writes and back.ado == R.EEPROM_CONTROL and slave is None and len(data) >= 2:
            everyone = _Slave(name, None)
            for each in (everyone, *self._stations.values()):
                each.word = int.from_bytes(data[2:6], "little") if len(data) > 3 else each.word
            return self._eeprom(everyone, data)
        if slave is not None:
            if not writes and back.ado in QUIET:
                if slave.polled.get(back.ado) == data:
                    return []
                slave.polled[back.ado] = data
            described = self._configured(slave, back.ado, data, writes)
            if described is not None:
                return described
        elif not writes and back.ado in QUIET:
            return []
        value = int.from_bytes(data, "little")
        if back.ado in (R.AL_CONTROL, R.AL_STATUS):
            return [f"{name}: {_place(back.ado)} {_state(data, back.ado == R.AL_CONTROL)}"]
        if back.ado == R.AL_STATUS_CODE:
            return [f"{name}: {_place(back.ado)} {_code(value)}"] if value else []
        arrow = "←" if writes else "="
        shown = data.hex() if len(data) > 8 else f"{value:0{2 * len(data)}X}h"
        counted = f" ({back.wkc} slaves)" if back.command in BROADCAST else ""
        return [f"{name}: {_place(back.ado)} {arrow} {shown}{counted}"]

    def _configured(
        self, slave: _Slave, address: int, data: bytes, writes: bool
    ) -> list[str] | None:
        """Track addresses, EEPROM, FMMUs and sync managers; -> text, None for other registers."""
        if writes and address == R.STATION_ADDRESS and len(data) >= 2:
            station = int.from_bytes(data[:2], "little")
            self._stations[station] = slave
            before, slave.name = slave.name, f"slave {station:04X}h"
            return [f"{before} becomes {slave.name}"]
        if writes and R.EEPROM_CONTROL <= address <= R.EEPROM_ADDRESS and len(data) >= 4:
            at = R.EEPROM_ADDRESS - address
            if len(data) >= at + 2:
                slave.word = int.from_bytes(data[at : at + 4], "little")
            return self._eeprom(slave, data) if address == R.EEPROM_CONTROL else []
        if writes and address == R.EEPROM_CONTROL and len(data) >= 2:
            return self._eeprom(slave, data)
        if not writes and R.EEPROM_CONTROL <= address <= R.EEPROM_DATA:
            found = data[R.EEPROM_DATA - address :]
            value = int.from_bytes(data[:2], "little") if address == R.EEPROM_CONTROL else 0
            wrong = [f"{slave.name}: EEPROM: {what}" for bit, what in EEPROM_ERRORS if value & bit]
            return wrong + self._identity(slave, found)
        if writes and R.FMMU <= address < R.FMMU + 0x100 and len(data) >= 13:
            lines = []
            for k in range(0, len(data) - 12, 16):
                lines += self._fmmu(slave, (address - R.FMMU + k) // 16, data[k : k + 16])
            return lines
        if writes and R.SYNC_MANAGER <= address < R.SYNC_MANAGER + 0x80 and len(data) >= 7:
            lines = []
            for k in range(0, len(data) - 6, 8):
                start, length, control = struct.unpack_from("<HHB", data, k)
                n = (address - R.SYNC_MANAGER + k) // 8
                if data[k + 6] & 1:
                    slave.managers[n] = start, length
                    lines.append(f"{slave.name}: sync manager {n} at {start:04X}h, {length} bytes, "
                                 f"control {control:02X}h")
                else:
                    slave.managers.pop(n, None)
            return lines
        if writes and R.SYNC_MANAGER <= address < R.SYNC_MANAGER + 0x80 and address & 7 == 6:
            n = (address - R.SYNC_MANAGER) // 8  # by its activation byte alone
            return [f"{slave.name}: sync manager {n} {'on' if data[0] & 1 else 'off'}"]
        return None

    def _eeprom(self, slave: _Slave, data: bytes) -> list[str]:
        """Explain a command to the EEPROM; of the many reads only the results are printed."""
        value = int.from_bytes(data[:2], "little")
        command = value >> 8 & 7
        if command in (0, 1):
            return []
        text = f"{slave.name}: EEPROM {EEPROM_COMMANDS.get(command, f'command {command}')}"
        if command == 2:
            text += f" word {slave.word:04X}h" if slave.word >= 0 else ""
            text += "" if value & 1 else ", not enabled"
        return [text]

    def _fmmu(self, slave: _Slave, n: int, row: bytes) -> list[str]:
        logical, length, first, last, physical, bit, kind, active = struct.unpack_from(
            "<IHBBHBBB", row
        )
        if not active:
            slave.fmmus.pop(n, None)
            return []
        whole = (first, last, bit) == (0, 7, 0)
        slave.fmmus[n] = _Fmmu(logical, length, physical, kind if whole else 0)
        way = {1: "reads", 2: "writes", 3: "reads and writes"}.get(kind, "?")
        return [f"{slave.name}: FMMU {n} {way} {length} bytes at {physical:04X}h as {logical:08X}h"]

    def _identity(self, slave: _Slave, data: bytes) -> list[str]:
        word, slave.word = slave.word, -1
        if word == IDENTITY + 2 and slave.vendor and len(data) >= 4:  # four bytes at a time
            data = slave.vendor + data[:4]
        elif word != IDENTITY or len(data) < 4:
            return []
        if len(data) < 8:
            slave.vendor = data[:4]
            return [f"{slave.name}: vendor {int.from_bytes(data[:4], 'little'):08X}h"]
        vendor, product = struct.unpack_from("<II", data)
        if (vendor, product) in self._known:
            slave.model = self._known[vendor, product]
        known = f", {slave.model.title}" if slave.model else ""
        return [f"{slave.name}: vendor {vendor:08X}h, product {product:08X}h{known}"]

    # ---------------------------------------------------------------- mailbox

    def _telegram(self, slave: _Slave, data: bytes) -> list[str]:
        if len(data) < HEADER.size:
            return [f"{slave.name}: mailbox {data.hex()}"]
        length, _, _, kind = HEADER.unpack_from(data)
        body = data[HEADER.size : HEADER.size + length]
        if kind & 15 == Kind.ERROR and len(body) >= 4:
            return [f"{slave.name}: mailbox error {int.from_bytes(body[2:4], 'little')}"]
        if kind & 15 != Kind.COE or len(body) < 3:
            name = Kind(kind & 15).name if kind & 15 in set(Kind) else f"type {kind & 15}"
            return [f"{slave.name}: {name} {body.hex()}"]
        service = body[1] >> 4
        if service == Service.EMERGENCY and len(body) >= 5:
            code, register = struct.unpack_from("<HB", body, 2)
            return [f"{slave.name}: emergency {code:04X}h, error register {register:02X}h"]
        if service in (Service.SDO_REQUEST, Service.SDO_RESPONSE) and len(body) >= 10:
            return [f"{slave.name}: {text}" for text in self._sdo(slave, service, body[2:])]
        return [f"{slave.name}: CoE service {service} {body[2:].hex()}"]

    def _sdo(self, slave: _Slave, service: int, body: bytes) -> list[str]:
        command, index, subindex = struct.unpack_from("<BHB", body)
        name = slave.object(index, subindex)
        if command == 0x80:
            (code,) = struct.unpack_from("<I", body, 4)
            reason = TEXT.get(code, "")  # type: ignore[call-overload]
            return [f"{name} refused: {code:08X}h {reason}".rstrip()]
        kind = command >> 5
        if service == Service.SDO_REQUEST:
            if kind == 2:
                return [f"read {name}"]
            if kind == 1:
                data = _content(body, command)
                self._follow(slave, index, subindex, data)
                slave.written = index, subindex, data
                return [f"write {slave.text(index, subindex, data)}"]
            return [f"segment {body[:1].hex()}"]
        if kind == 2:
            data = _content(body, command)
            self._follow(slave, index, subindex, data)
            self._hear(slave, index, subindex, data)
            return [slave.text(index, subindex, data)]
        if kind == 3 and slave.written and slave.written[:2] == (index, subindex):
            self._hear(slave, *slave.written)
        return [] if kind == 3 else [f"segment {len(body) - 1} bytes"]

    def _follow(self, slave: _Slave, index: int, subindex: int, data: bytes) -> None:
        """Track PDO assignment and mapping as a master writes or reads them."""
        value = int.from_bytes(data[:4], "little")
        if index in ASSIGNMENTS:
            rows = slave.assigned.setdefault(ASSIGNMENTS[index], [])
        elif 0x1600 <= index < 0x1C00:
            rows = slave.mapped.setdefault(index, [])
        else:
            return
        if subindex == 0:
            del rows[value:]
            return
        rows += [0] * (subindex - len(rows))
        rows[subindex - 1] = value

    # ----------------------------------------------------------- process data

    def _process_data(self, sent: Datagram, back: Datagram) -> list[str]:
        lines = []
        for slave in self._stations.values():
            for fmmu in slave.fmmus.values():
                at = fmmu.logical - back.logical
                if not 0 <= at <= len(back.data) - fmmu.length or not fmmu.kind:
                    continue
                data = sent.data if fmmu.kind == 2 else back.data
                lines += self._image(slave, fmmu, data[at : at + fmmu.length], bool(back.wkc))
        if not back.wkc:
            lines.append(f"process data {back.logical:08X}h: no slave (working counter 0)")
        return lines

    def _hear(self, slave: _Slave, index: int, subindex: int, data: bytes) -> None:
        row = slave.row(index, subindex)
        if row is not None and row.format and len(data) == row.size:
            self._heard(slave.name, row, row.unpack(data))

    def _image(self, slave: _Slave, fmmu: _Fmmu, data: bytes, valid: bool) -> list[str]:
        manager = next(
            (n for n, (start, _) in slave.managers.items() if start == fmmu.physical), None
        )
        if manager not in (2, 3):
            return []
        lines, at = [], 0
        for entry in slave.entries(manager):
            index, subindex, bits = mapping_entry(entry)
            part = data[at : at + bits // 8]
            at += bits // 8
            value = int.from_bytes(part, "little")
            if valid:
                self._hear(slave, index, subindex, part)
            if not index or slave.values.get((index, subindex)) == value:
                continue
            slave.values[index, subindex] = value
            if index in (0x6040, 0x6041, 0x6060, 0x6061):
                lines.append(f"{slave.name}: {slave.text(index, subindex, part)}")
        return lines


@functools.cache
def _mappings(model: DriveModel) -> dict[int, list[int]]:
    """Default entries of each PDO."""
    device = describe(model)
    return {
        pdo.index: [e.index << 16 | e.subindex << 8 | e.bits for e in pdo.entries]
        for pdo in (*device.rpdos, *device.tpdos)
    }


def _content(body: bytes, command: int) -> bytes:
    """The data of an initiate telegram."""
    if command & 2:
        return body[4 : 8 - (command >> 2 & 3)] if command & 1 else body[4:8]
    (size,) = struct.unpack_from("<I", body, 4)
    return body[8 : 8 + size]


def _place(address: int) -> str:
    return f"{REGISTERS.get(address, 'register')} ({address:04X}h)"


def _state(data: bytes, requested: bool) -> str:
    """Format AL Control if `requested`, else AL Status; their bits 4 and 5 differ."""
    value = data[0]
    state = value & 0x0F
    text = AlState(state).name if state in set(AlState) else f"{state:X}h"
    for bit, meaning in AL_CONTROL_BITS if requested else AL_STATUS_BITS:
        text += f" + {meaning}" if value & bit else ""
    if not requested and len(data) >= 6 and (code := int.from_bytes(data[4:6], "little")):
        text += f", {_code(code)}"
    return text


def _code(code: int) -> str:
    return f"{code:04X}h {AlStatusCode(code).name if code in set(AlStatusCode) else ''}".rstrip()


@functools.cache
def _identities() -> dict[tuple[int, int], DriveModel]:
    """Models with an EtherCAT face by vendor and product."""
    found = {}
    for name in model_names():
        try:
            model = load(name, "ethercat")
        except ValueError:
            continue
        vendor, product = (int(model.objects[0x1018, n].default) for n in (1, 2))
        found[vendor, product] = model
    return found
