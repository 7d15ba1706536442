"""Drives on EtherCAT as a master reaches them: objects by SDO, or by process data where mapped."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from ..master.port import Units
from ..model.model import DriveModel, load
from ..model.pdo import mapping_entry, places
from ..objects.hooks.ethercat import mappable
from .al import AlState

LATENCY = 0.01  # s; inferred: by then a drive has seen a start bit and its status bits are new
OUTPUTS = ("controlword", "target_position", "modes_of_operation")
INPUTS = ("statusword", "position_actual_value", "modes_of_operation_display")
ASSIGNMENTS = (0x1C12, 0x1C13)
PDO_BYTES = 8


class SlaveSide(Protocol):
    """One slave, as `master.RemoteSlave` or `servogym.drive.wire.soem.SoemSlave`."""

    outputs: bytearray
    inputs: bytes
    mailbox: Any  # upload(index, subindex) and download(index, subindex, data)

    @property
    def state(self) -> AlState:
        """State without the error bit."""

    def upload(self, index: int, subindex: int = 0) -> int:
        """A number."""

    def assign(self, rpdos: Iterable[int], tpdos: Iterable[int]) -> None:
        """PDOs of sync managers 2 and 3."""


class SegmentMaster(Protocol):
    """Who commands slaves: `master.EtherCatMaster`, or `servogym.drive.wire.soem.SoemMaster`."""

    @property
    def slaves(self) -> Sequence[SlaveSide]:
        """The slaves found by the scan."""

    def scan(self) -> Sequence[SlaveSide]:
        """Find them."""

    def to_preop(self) -> None:
        """Open the mailboxes."""

    def to_op(self, prepare: Callable[[], object]) -> None:
        """Process data as they are assigned; `prepare` fills the outputs before they go out."""

    def cycle(self) -> bool:
        """Exchange process data."""

    def send_process_data(self) -> None:
        """Send process data; the answer is taken by the next call of these."""

    def look(self) -> bool:
        """Read the inputs alone."""

    def recover(self) -> None:
        """Slaves that a watchdog has taken out of OPERATIONAL go back to it."""


class EtherCatPort:
    """Slaves of one segment, in OPERATIONAL.

    Slaves that are in INIT or PRE_OPERATIONAL get `outputs` and `inputs` mapped; others keep what
    they have.

    Args:
        master: of the segment: in memory, or SOEM's.
        models: the drive model of each slave by the name it goes by, in the order of the slaves;
            one model alone is ``slave``.
        outputs: names of the objects in 1600h, and in the next ones where 8 bytes are full.
        inputs: of those in 1A00h and the next ones.
        now: time (s); that of the bus in memory if not given.
        units: of the drives, where their factors are known.

    Raises:
        ValueError: other slaves than models, an unknown model or name.
        RuntimeError: a slave refuses a state.
    """

    latency = LATENCY
    cyclic = False  # exchange process data after each SDO as well: their watchdog does not wait

    def __init__(
        self,
        master: SegmentMaster,
        models: str | Path | DriveModel | Mapping[str, str | Path | DriveModel],
        *,
        outputs: Sequence[str] = OUTPUTS,
        inputs: Sequence[str] = INPUTS,
        now: Callable[[], float] | None = None,
        units: Units | None = None,
    ):
        named = models if isinstance(models, Mapping) else {"slave": models}
        self.master = master
        self.models = {axis: load(model, "ethercat") for axis, model in named.items()}
        self._units = units or Units()
        self.exchanges = 0  # of process data
        self._now = now or (lambda: master.wire.time * 1e-9)  # type: ignore[attr-defined]
        slaves = master.slaves or master.scan()
        if len(slaves) != len(self.models):
            raise ValueError(f"{len(slaves)} slaves answer, {len(self.models)} models are given: "
                             f"{', '.join(self.models)}; check interface, cable and supply")
        if all(slave.state == AlState.INIT for slave in slaves):
            master.to_preop()
        self.nodes = {
            axis: RemoteObjects(slave, self.models[axis])
            for axis, slave in zip(self.models, slaves, strict=True)
        }
        for node in self.nodes.values():
            if node.slave.state == AlState.PRE_OPERATIONAL:
                node.map(outputs, inputs)
        master.to_op(self._find_places)

    def _find_places(self) -> None:
        for node in self.nodes.values():
            node.find_places()

    def now(self) -> float:
        """Time (s)."""
        return self._now()

    def read(self, axis: str, name: str) -> int | float:
        """An object (drive units), of the process data if they have it, else by SDO."""
        return self.nodes[axis].read(name)

    def upload(self, axis: str, name: str) -> int | float:
        """An object (drive units), by SDO."""
        value = self.nodes[axis].upload(name)
        if self.cyclic:
            self.exchange()
        return value

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Set an object (drive units), by SDO, or with the next exchange of process data."""
        if self.nodes[axis].write(name, value) and self.cyclic:
            self.exchange()

    def exchange(self) -> bool:
        """Exchange process data once; -> whether every working counter was right."""
        self.exchanges += 1
        return self.master.cycle()

    def send(self) -> None:
        """Send process data without waiting for the answer, which the next exchange takes."""
        self.exchanges += 1
        self.master.send_process_data()

    def units(self, axis: str) -> Units:
        """Return the units given at construction."""
        return self._units


class RemoteObjects:
    """Reads and writes objects of one slave; `EtherCatPort` has the arguments and errors."""

    def __init__(self, slave: SlaveSide, model: DriveModel):
        self.slave = slave
        self._model = model
        self._outputs: dict[str, int] = {}  # object -> byte of the process data
        self._inputs: dict[str, int] = {}

    def map(self, outputs: Sequence[str], inputs: Sequence[str]) -> None:
        """Map objects to the first flexible PDOs, as many as they fill, and assign these.

        Where the drive has too few of them, its PDOs stay as it has them; `read` and `write` take
        what these do not carry by SDO.
        """
        shares = [self._shared_out(names) for names in (outputs, inputs)]
        all_pdos, free = (self._model.rpdos, self._model.tpdos), mappable(self._model)
        pdos = [
            [int(pdo.cob_id, 0) for pdo in found[:count]]
            for found, count in zip(all_pdos, free, strict=True)
        ]
        if any(len(wanted) > len(there) for wanted, there in zip(shares, pdos, strict=True)):
            return
        download = self.slave.mailbox.download
        for index in ASSIGNMENTS:
            download(index, 0, b"\0")
        assigned: list[list[int]] = []
        for there, wanted in zip(pdos, shares, strict=True):
            assigned.append(there[: len(wanted)])
            for pdo, words in zip(assigned[-1], wanted, strict=True):
                download(pdo, 0, b"\0")
                for n, word in enumerate(words, 1):
                    download(pdo, n, word.to_bytes(4, "little"))
                download(pdo, 0, bytes([len(words)]))
        self.slave.assign(*assigned)

    def _shared_out(self, names: Sequence[str]) -> list[list[int]]:
        """Mapping entries of objects, in PDOs of 8 bytes."""
        shares: list[list[int]] = [[]]
        free = PDO_BYTES
        for name in names:
            row = self._model.number(name)
            if row.size > free:
                shares.append([])
                free = PDO_BYTES
            shares[-1].append(row.index << 16 | row.subindex << 8 | row.size * 8)
            free -= row.size
        return shares

    def find_places(self) -> None:
        """Read what the process data carry; outputs begin with what the drive has."""
        self._outputs, self._inputs = map(self._places, ASSIGNMENTS)
        for name, at in self._outputs.items():
            data = self._model.number(name).pack(self.upload(name))
            self.slave.outputs[at : at + len(data)] = data

    def _places(self, assignment: int) -> dict[str, int]:
        words = [word for pdo in self._list(assignment) for word in self._list(pdo)]
        return places(self._model.objects, map(mapping_entry, words))[0]

    def _list(self, index: int) -> list[int]:
        """The values of an array from sub-index 1 on."""
        return [self.slave.upload(index, n + 1) for n in range(self.slave.upload(index))]

    def read(self, name: str) -> int | float:
        """An object's value (drive units), of the process data if they have it, else by SDO."""
        at = self._inputs.get(name)
        if at is None:
            return self.upload(name)
        return self._model.number(name).code.unpack_from(self.slave.inputs, at)[0]

    def upload(self, name: str) -> int | float:
        """An object's value (drive units), by SDO."""
        row = self._model.number(name)
        return row.unpack(self.slave.mailbox.upload(row.index, row.subindex))

    def write(self, name: str, value: int | float) -> bool:
        """Set an object (drive units), in the outputs if they have it, else by SDO; -> whether so.

        Raises:
            ValueError: unknown name, or a value that does not fit the object's type.
            SdoAbort: the drive refuses it.
        """
        row = self._model.number(name)
        data = row.pack(value)
        at = self._outputs.get(name)
        if at is None:
            self.slave.mailbox.download(row.index, row.subindex, data)
        else:
            self.slave.outputs[at : at + len(data)] = data
        return at is None
