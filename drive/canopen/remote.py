"""The objects of a drive as a master sees them: by name, over SDO, or over PDO where mapped."""

import struct
from dataclasses import dataclass, field
from pathlib import Path

from ..abort import Abort, SdoAbort
from ..model import DriveModel, Object, load
from .frame import Base, Frame
from .node import NmtCommand
from .port import Port
from .sdo_client import SdoClient

SYNC = Frame(Base.SYNC)
PDOS = 512  # of each direction at most (CiA 301)
SYNCHRONOUS = range(241)  # transmission types


@dataclass
class _Pdo:
    """A PDO of the drive: what is mapped where, and its data."""

    cob_id: int
    data: bytearray
    places: dict[str, int] = field(default_factory=dict)  # object name -> byte
    heard: bool = False


class RemoteObjects:
    """Reads and writes objects of a drive on the bus.

    Args:
        port: the way to the bus.
        node_id: of the drive, 1..127.
        model: the drive model whose objects go by name; `generic` has those of the standard.
        sdo_timeout: for the answer to one SDO request (s).

    Raises:
        ValueError: node-id out of range, unknown model.
    """

    def __init__(
        self,
        port: Port,
        node_id: int,
        model: str | Path | DriveModel = "generic",
        sdo_timeout: float = 1.0,
    ):
        self.port = port
        self.node_id = node_id
        self.sdo = SdoClient(port, node_id, sdo_timeout, self._take)
        self._rows = load(model).names
        self._rpdos: list[_Pdo] = []
        self._tpdos: list[_Pdo] = []
        self._synchronous = False

    def nmt(self, command: NmtCommand) -> None:
        """Send an NMT command to the drive's node."""
        for pdo in self._tpdos:
            pdo.heard = False  # what the last one told may not be true any more
        self.exchange(Frame(Base.NMT, bytes([command, self.node_id])))

    def exchange(self, *frames: Frame) -> None:
        """Send frames, and a SYNC where a PDO in use is synchronous; take what has come."""
        sync = [SYNC] if self._synchronous else []
        for frame in self.port.exchange([*frames, *sync]):
            self._take(frame)

    def read(self, name: str) -> int | float:
        """An object's value (drive units), of the last TPDO that has it, else by SDO."""
        for pdo in self._tpdos:
            if pdo.heard and name in pdo.places:
                return _code(self._row(name)).unpack_from(pdo.data, pdo.places[name])[0]
        return self.upload(name)

    def upload(self, name: str) -> int | float:
        """An object's value (drive units), by SDO."""
        row = self._row(name)
        return _code(row).unpack(self.sdo.upload(row.index, row.subindex))[0]

    def write(self, name: str, value: int) -> None:
        """Set an object (drive units), in the first RPDO that has it, else by SDO.

        Raises:
            ValueError: unknown name, or a value that does not fit the object's type.
            SdoAbort: the drive refuses it.
        """
        row = self._row(name)
        try:
            data = _code(row).pack(value)
        except struct.error as error:
            raise ValueError(f"{name} = {value!r} is no {row.data_type}: {error}") from None
        for pdo in self._rpdos:
            if name in pdo.places:
                at = pdo.places[name]
                pdo.data[at : at + len(data)] = data
                self.exchange(Frame(pdo.cob_id, bytes(pdo.data)))
                return
        self.sdo.download(row.index, row.subindex, data)

    def use_pdos(self) -> None:
        """Read the mapping of the valid PDOs and use them from now on; starts the node (NMT)."""
        self._synchronous = False
        rpdos = self._mapped(0x1400, 0x1600)
        for pdo in rpdos:
            for name, at in pdo.places.items():
                data = self.sdo.upload(self._rows[name].index, self._rows[name].subindex)
                pdo.data[at : at + len(data)] = data
        self._rpdos, self._tpdos = rpdos, self._mapped(0x1800, 0x1A00)
        self.nmt(NmtCommand.START)

    def _mapped(self, communication: int, mapping: int) -> list[_Pdo]:
        names = {(row.index, row.subindex): name for name, row in self._rows.items()}
        pdos = []
        for number in range(PDOS):
            try:
                cob_id = self._number(communication + number, 1)
            except SdoAbort as refused:
                if refused.code == Abort.NO_OBJECT:
                    break
                raise
            if cob_id & 0x8000_0000:
                continue
            pdo, bits = _Pdo(cob_id & 0x7FF, bytearray()), 0
            for n in range(self._number(mapping + number, 0)):
                entry = self._number(mapping + number, n + 1)
                name = names.get((entry >> 16, entry >> 8 & 0xFF))
                if name:
                    pdo.places[name] = bits // 8
                bits += entry & 0xFF
            pdo.data = bytearray(bits // 8)
            pdos.append(pdo)
            if self._number(communication + number, 2) in SYNCHRONOUS:
                self._synchronous = True
        return pdos

    def _number(self, index: int, subindex: int) -> int:
        return int.from_bytes(self.sdo.upload(index, subindex), "little")

    def _row(self, name: str) -> Object:
        if name not in self._rows or not self._rows[name].format:
            raise ValueError(f"the model has no number {name!r}; use sdo.upload and sdo.download")
        return self._rows[name]

    def _take(self, frame: Frame) -> None:
        for pdo in self._tpdos:
            if frame.id == pdo.cob_id and not frame.remote and len(frame.data) >= len(pdo.data):
                pdo.data[:] = frame.data[: len(pdo.data)]
                pdo.heard = True


def _code(row: Object) -> struct.Struct:
    return struct.Struct("<" + row.format)
