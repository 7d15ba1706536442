"""What a drive on EtherCAT says of itself when it is asked: see `servogym.drive.observation`.

Its objects are those of its SDO information; without that all addresses are tried. Beside what
every bus has, its EEPROM, the registers of its controller, the description of each entry and
telegrams that it must refuse are asked for. States beyond PRE_OP are requested only where the drive
has to refuse them.
"""

import dataclasses
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

from ..drive import Drive
from ..machine import Standing
from ..model.model import DriveModel, load
from ..objects.abort import Abort, SdoAbort
from ..observation import ASKED, SETTLED, Observer, danger, shown
from .al import AlState
from .bus import Bus
from .coe_header import Service, header
from .controller.registers import R
from .description import Description, Pdo
from .mailbox import Kind
from .mailbox_client import MailboxError
from .master import EtherCatMaster
from .sdo_info import INCOMPLETE, Opcode
from .segment import Segment
from .slave import Slave

# registers that say what the controller is: address -> bytes
REGISTERS = {0x0000: 1, 0x0001: 1, 0x0002: 2, 0x0004: 1, 0x0005: 1, 0x0006: 1, 0x0007: 1,
             0x0008: 2, 0x0140: 2, 0x0502: 1}
UNSTEADY = ("serial_number", "alias", "tpdos", "rpdos")  # of a drive, or told one by one
SDO = {  # bodies of SDO requests, as ETG.1000.6 answers or refuses them
    "unknown command specifier": "E041600000000000",
    "segment of no upload": "6000000000000000",
    "segment of no download": "0000000000000000",
    "block upload": "A041600020000000",
    "an object that there is not": "40FF5F0000000000",
    "an upload of sub-index FEh": "401810FE00000000",
    "complete access of 1018h": "5018100000000000",
    "complete access from sub-index 2 on": "5018100200000000",
    "a write to a read-only object": "2B41600000000000",
    "a request of four bytes": "40181000",
}
INFORMATION = {  # bodies of SDO information: opcode, fragments left, data
    "lengths of the lists": "0100000000 00",
    "objects for RPDOs": "0100000002 00",
    "objects for TPDOs": "0100000003 00",
    "objects that are stored": "0100000004 00",
    "a list that there is not": "0100000009 00",
    "description of an object that there is not": "03000000FF5F",
    "description of an entry that there is not": "0500000018 10FE00",
    "an opcode that there is not": "0B0000000000",
}
SERVICES = (Service.TPDO_REQUEST, Service.RPDO_REQUEST, 0, 9)
PROTOCOLS = {Kind.AOE: 0x01, Kind.FOE: 0x08, Kind.SOE: 0x10, Kind.VOE: 0x20}  # bits of the SII
# states that a slave in PRE_OP refuses, and one that there is not
REFUSED = (AlState.OPERATIONAL, AlState.BOOTSTRAP, 5)
ERROR, ACKNOWLEDGE = 0x10, 0x10
POLLS = 200


class SlaveAccess(Protocol):
    """A slave in PRE_OP: `RemoteSlave`, or `wire.ethercat_observe.ScannedSlave`."""

    position: int
    description: Description
    mailbox: Any  # `MailboxClient`

    def read(self, address: int, size: int) -> bytes:
        """Registers."""

    def write(self, address: int, data: bytes) -> bool:
        """Registers; -> whether they were written."""


def of_model(
    model: "str | DriveModel | Any", like: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Observe a model through a slave in this process. Raises ValueError as `load`.

    Args:
        model: its name, its folder, or itself.
        like: an observation of a drive to compare with, see `Observer`.
    """
    drive = Drive(load(model, "ethercat"))
    cycling = Standing({"x": drive}, float(drive.model.cycle_time["position"]))
    master = EtherCatMaster(Bus(Segment([Slave(drive)])))
    slaves = master.scan()
    master.to_preop()

    def wait(time: float) -> None:
        cycling.step(round(time / cycling.cycle_time))

    return Observer(EtherCatLine(slaves, 0, wait), drive.model, like=like).observe()


class EtherCatLine:
    """The way to a slave.

    Args:
        slaves: of the segment.
        position: of the slave among them.
        wait: lets a time pass (s).
        read_only: why states are not requested, nor is anything written; "" if it may be.
    """

    def __init__(
        self, slaves: Sequence[SlaveAccess], position: int, wait: Callable[[float], object],
        read_only: str = "",
    ):
        self.about = {"bus": "ethercat", "position": position}
        self._slaves, self._slave, self._read_only = slaves, slaves[position], read_only
        self.wait = wait
        self._listed: frozenset[int] | None = None

    def upload(self, index: int, subindex: int = 0) -> bytes:
        """The bytes of an object. Raises SdoAbort, TimeoutError."""
        return _answered(index, subindex, lambda: self._slave.mailbox.upload(index, subindex))

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object. Raises SdoAbort, TimeoutError."""
        _answered(index, subindex, lambda: self._slave.mailbox.download(index, subindex, data))

    def why_not_write(self) -> str:
        """A slave of the segment that is enabled or moves."""
        if self._read_only:
            return self._read_only
        for slave in (self._slave, *(s for s in self._slaves if s is not self._slave)):
            try:
                if found := danger(slave.mailbox.upload, self.wait):
                    self._read_only = f"slave {slave.position} {found}"
                    return self._read_only
            except (SdoAbort, TimeoutError, ValueError):
                continue  # no drive, or one without a position
        return ""

    # ----------------------------------------------------------------- lists

    def indices(self, block: range) -> Iterable[int]:
        """Those of the list of all objects; without SDO information each of the range."""
        if self._listed is None:
            body = b"".join(self._information(Opcode.LIST_REQUEST, struct.pack("<H", 1)))[2:]
            self._listed = frozenset(n for (n,) in struct.iter_unpack("<H", body[: len(body) & ~1]))
        return [index for index in block if index in self._listed] if self._listed else block

    def _information(self, opcode: Opcode, data: bytes) -> list[bytes]:
        """The parts of an answer of SDO information; none where it is refused."""
        body = header(Service.SDO_INFORMATION) + struct.pack("<BxH", opcode, 0) + data
        parts: list[bytes] = []
        answer = self._telegram(Kind.COE, body)
        while isinstance(answer, bytes) and len(answer) >= 6 and answer[2] & 0x7F == opcode + 1:
            parts.append(answer[6:])
            if not answer[2] & INCOMPLETE:
                return parts
            answer = self._more()
        return []

    def _more(self) -> "bytes | str":
        try:
            return self._slave.mailbox.next(Kind.COE)
        except (TimeoutError, ValueError):
            return ""

    # ------------------------------------------------------------- questions

    def _telegram(self, kind: int, body: bytes) -> "bytes | str":
        """The answer to a telegram: its body, a mailbox error, or "" for silence."""
        try:
            return self._slave.mailbox.ask(kind, body)
        except TimeoutError:
            return ""
        except MailboxError as error:
            return f"mailbox error {error.detail}"

    def _asked(self, kind: int, body: bytes) -> str:
        answer = self._telegram(kind, body)
        return answer if isinstance(answer, str) else answer.hex()

    def _sdo(self, body: bytes) -> str:
        return self._asked(Kind.COE, header(Service.SDO_REQUEST) + body)

    def ask(self, values: Mapping[tuple[int, int], str]) -> dict[str, list[str]]:
        """Controller, EEPROM, descriptions, requests that a slave must refuse."""
        found: dict[str, list[str]] = {}
        for address, size in REGISTERS.items():
            found[f"register {address:04X}h"] = [self._slave.read(address, size).hex()]
        self._eeprom(found)
        for name, text in INFORMATION.items():
            body = header(Service.SDO_INFORMATION) + bytes.fromhex(text)
            found[name] = [self._asked(Kind.COE, body)]
            self._drop()
        if self._listed:
            self._descriptions(found, values)
        for name, text in SDO.items():
            found[name] = [self._sdo(bytes.fromhex(text))]
            self._abort()
        for place in ASKED:
            size = len(values.get(place, "")) // 2
            if values.get(place, "abort").startswith("abort") or not 1 <= size <= 4:
                continue
            target = struct.pack("<HB", *place)
            too_long = b"\x21" + target + struct.pack("<I", size + 4) + bytes(size + 4)
            found[f"{shown(place)} {size + 4} bytes"] = [self._sdo(too_long)]
            self._abort()
            if size > 1:
                short = bytes([0x23 | (4 - size + 1) << 2]) + target + bytes(4)
                found[f"{shown(place)} {size - 1} bytes"] = [self._sdo(short)]
        for service in SERVICES:
            found[f"CoE service {int(service)}"] = [
                self._asked(Kind.COE, struct.pack("<H", service << 12) + bytes(8))
            ]
            self._drop()
        for kind, bit in PROTOCOLS.items():
            if not self._slave.description.protocols & bit:
                found[f"mailbox of {kind.name}"] = [self._asked(kind, bytes(8))]
        self.wait(SETTLED)
        self._drop()
        if not self._read_only:
            self._states(found)
        return found

    def _drop(self) -> None:
        """Take answers that nobody waits for any more."""
        while isinstance(answer := self._slave.mailbox.waiting(), bytes) and answer:
            pass

    def _abort(self) -> None:
        """End a transfer that may be open; an abort has no answer."""
        body = header(Service.SDO_REQUEST) + b"\x80" + bytes(3) + struct.pack("<I", Abort.GENERAL)
        self._slave.mailbox.tell(Kind.COE, body)
        self._drop()

    def _eeprom(self, found: dict[str, list[str]]) -> None:
        device = self._slave.description
        for field in dataclasses.fields(Description):
            if field.name not in UNSTEADY:
                found[f"EEPROM, {field.name}"] = [_text(getattr(device, field.name))]
        for direction, pdos in (("RPDO", device.rpdos), ("TPDO", device.tpdos)):
            found[f"EEPROM, {direction}s"] = [f"{pdo.index:04X}h" for pdo in pdos]
            for pdo in pdos:
                found[f"EEPROM, {pdo.index:04X}h"] = _pdo(pdo)

    def _descriptions(
        self, found: dict[str, list[str]], values: Mapping[tuple[int, int], str]
    ) -> None:
        """Type, length, access and name of each entry, and of each object."""
        for index in sorted({index for index, _ in values}):
            parts = self._information(Opcode.OBJECT_REQUEST, struct.pack("<H", index))
            found[f"{index:04X}h, object"] = [b"".join(parts)[2:].hex()]
        for address in values:
            parts = self._information(Opcode.ENTRY_REQUEST, struct.pack("<HBB", *address, 0))
            found[f"{shown(address)}, entry"] = [b"".join(parts)[4:].hex()]

    def _states(self, found: dict[str, list[str]]) -> None:
        """States that are requested and refused: AL status and its code."""
        for state in REFUSED:
            self._slave.write(R.AL_CONTROL, bytes([state, 0]))
            answer = [self._al(ERROR)]
            self._slave.write(R.AL_CONTROL, bytes([AlState.PRE_OPERATIONAL | ACKNOWLEDGE, 0]))
            found[f"AL state {int(state)} requested"] = [*answer, self._al(0)]

    def _al(self, wanted: int) -> str:
        """AL status and code, as soon as the error bit is as wanted."""
        status = b""
        for _ in range(POLLS):
            status = self._slave.read(R.AL_STATUS, 2)
            if status[0] & ERROR == wanted:
                break
        return (status + self._slave.read(R.AL_STATUS_CODE, 2)).hex()


def _answered(index: int, subindex: int, transfer: Callable[[], Any]) -> Any:
    """What a transfer returns; a mailbox error is an abort without a code of its own."""
    try:
        return transfer()
    except ValueError as error:
        raise SdoAbort(Abort.GENERAL, index, subindex, str(error)) from None


def _text(value: Any) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return ", ".join(f"{name} {x}" for name, x in dataclasses.asdict(value).items())
    if isinstance(value, tuple):
        return "; ".join(_text(one) for one in value)
    return str(value)


def _pdo(pdo: Pdo) -> list[str]:
    entries = [f"{e.index:04X}h:{e.subindex:02X}h {e.bits} bits" for e in pdo.entries]
    return [pdo.name, f"sync manager {pdo.sync_manager}", f"flags {pdo.flags:04X}h", *entries]
