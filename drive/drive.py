"""Drive: the Python interface of one record.

>>> drive = Drive("generic")
>>> drive.write("controlword", 0x0006)
>>> torque = drive.cycle(angle=0.0, speed=0.0)
>>> drive.state.name
'SWITCH_ON_DISABLED'
"""

import functools
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from .advice import describe, meaning, refusal
from .kernel import cycle, process_data, record
from .kernel.factors import units_changed
from .kernel.faults import Cause
from .kernel.record import Axis
from .kernel.words import Mode, State
from .model.foreign import Key
from .model.given import finite, refuse_unknown
from .model.model import DriveModel, load
from .model.names import hint, named
from .model.pdo import mapping_entry
from .model.plugins import install_modes
from .objects import snapshot as snapshots
from .objects.abort import Abort, SdoAbort
from .objects.dictionary import ObjectDictionary
from .objects.hooks import hook_of
from .objects.hooks.ethercat import ASSIGNMENTS, assign
from .objects.kept import factors, keep, kept, written
from .objects.map_by_name import map_by_name
from .objects.mapping import compile_default
from .objects.parameters import Parameters, kept_bytes
from .objects.reactions import reaction_to
from .objects.slots import Slot
from .objects.store import Values


class Drive:
    """An emulated drive: its record, its PDOs, and the access to both that a master has.

    Args:
        model: name of a drive model, path of a model folder, or a loaded `DriveModel`.
        bus: field bus, "can" or "ethercat"; by default the first one of the model.
        axes: array of records, shape ``(n,)``, made by `record.make`, that holds the drive's state;
            by default the drive has a record of its own.
        index: position of the drive in `axes`.
        node_id: CANopen node-id 1..127, which determines the default identifiers of the PDOs.
        parameter_file: file in which 1010h stores parameters, loaded at power-on.

    Raises:
        ValueError: unknown model, one that is not for `bus`, node-id out of range.
    """

    def __init__(
        self, model: str | Path | DriveModel = "generic", *, bus: str | None = None,
        axes: np.ndarray | None = None, index: int = 0, node_id: int = 1,
        parameter_file: str | Path | None = None,
    ):
        self.model = load(model, bus)
        self.operational = False  # whether the bus exchanges process data, set by node or slave
        self.synchronisation: Callable[[], Mapping[int, int]] = dict  # on EtherCAT, see its slave
        self.communication_version = 0  # grows with each change of an object 1000h-1FFFh
        self.wanted_node_id: int | None = None  # to be adopted after the drive has reset itself
        if not 1 <= node_id <= 127:
            raise ValueError(f"node_id = {node_id} is out of range 1..127")
        self.node_id = node_id
        self.axes = record.make(1) if axes is None else axes
        self.index = index
        self.axis: Axis = self.axes[index]
        self.rpdos = process_data.make(len(self.model.rpdos))
        self.tpdos = process_data.make(len(self.model.tpdos))
        self.memory = process_data.memory(self.axes)
        od_offset = record.AXIS.fields["od"][1]  # type: ignore[index]
        self._record = process_data.raw(self.memory[index])
        self._more = bytearray(self.model.more)
        self._commissioned: dict[str, int] = {}
        self.objects = ObjectDictionary(
            self,
            {
                "axis": self._record[od_offset : od_offset + record.OD.itemsize],
                "rpdo": process_data.raw(self.rpdos),
                "tpdo": process_data.raw(self.tpdos),
                "more": memoryview(self._more),
                "constant": None,
            },
        )
        self.parameters = Parameters(self, parameter_file)
        self._kept = kept_bytes(self.model)
        self._power_on_changed()
        self.reset()

    def __repr__(self) -> str:
        fault = f", fault {self.fault}" if self.fault else ""
        return f"Drive({self.model.name}, {self.state.name}, {self.mode.name}{fault})"

    # ------------------------------------------------------------------ power

    def reset(self, *, keep_parameters: bool = False) -> None:
        """Switch the drive on: not ready to switch on, not referenced, stored or factory values.

        With `keep_parameters` storable objects and the PDO mapping keep their present values, as
        if they had been stored before.
        """
        if keep_parameters and self._powered_on[0] == (self.node_id, factors(self)):
            record = self.memory[self.index]
            stored, as_written = record[self._kept], kept(self)
            record[:] = self._powered_on[1]
            record[self._kept] = stored
            keep(self, as_written)
            self.parameters.react()
        else:
            self._power_on(
                self.parameters.values() if keep_parameters else self.parameters.stored()
            )
            self._compile_pdos()
        for name in {row.hook for row in self.model.objects.values() if row.hook}:
            if power_on := hook_of(self.model, name).power_on:
                power_on(self)

    def _power_on(self, values: Values) -> None:
        """Fill the record: defaults, then `values`; `reset` begins from its bytes next time."""
        self._record[:] = bytes(len(self._record))
        if self.model.name != "generic":
            self.parameters.standard_defaults()
        self.model.power_on(self.axis)
        self.axis.own_modes = install_modes(self.model)
        for name, value in self._commissioned.items():
            if name not in self.objects.names:
                setattr(self.axis.od, name, value)
        self.parameters.defaults()
        self._put_commissioned()
        self.parameters.restore(values)
        if self.model.quirk("values_keep_meaning"):
            units_changed(self.axes, self.index)  # as `restore` does where factors are stored
        self._powered_on = (self.node_id, factors(self)), self.memory[self.index].copy()

    def _power_on_changed(self) -> None:
        """Make the next `reset` fill the record from defaults and stored values."""
        # the record after power-on, with the node-id and the units it depends on
        self._powered_on = (0, b""), np.empty(0)

    def _put_commissioned(self) -> None:
        """Set the objects that only the manufacturer's tool can write."""
        for name, value in self._commissioned.items():
            slot = self.objects.names.get(name)
            if slot is not None and slot.view is not None:
                slot.put(value)

    def use_parameter_file(self, file: str | Path) -> None:
        """Store parameters (1010h, LSS) in a file from now on, and load what it already holds.

        Raises ValueError if the file exists but is damaged or belongs to another model.
        """
        self.parameters.use(Path(file))
        self._power_on_changed()
        self._compile_pdos()

    def use_parameters(self, content: bytes) -> str:
        """Load the content of a parameter file. Returns why it is refused, or an empty text."""
        if wrong := self.parameters.take(content):
            return wrong
        self.parameters.restore(self.parameters.stored())
        self.axis.parameters_changed = 1
        self._power_on_changed()
        self._compile_pdos()
        return ""

    def _compile_pdos(self) -> None:
        for pdos, receive in ((self.rpdos, True), (self.tpdos, False)):
            for pdo in pdos:
                compile_default(self.objects, pdo, receive)
        if self.model.bus == "ethercat":
            for index in ASSIGNMENTS:
                assign(self.objects, index, int(self.read(index)))
        self.image_changed()

    def reset_communication(self) -> None:
        """Reset the communication objects 1000h-1FFFh to their power-on values (CiA 301, NMT)."""
        self.parameters.reset_communication()
        self._compile_pdos()

    def commission(self, values: Mapping[str, float]) -> None:
        """Set parameters by name: objects if the model has them, otherwise fields of `AXIS.od`.

        Such fields stand for settings that only the manufacturer's own tool can reach, for example
        the inertia for feed-forward; they survive resets. A name that only other models have is
        skipped, so that one list can serve several models. Values are rounded.

        Raises ValueError for a value the model refuses (with its range), for a value that is not a
        number, and for a name that no model has.
        """
        for name, given in named("values", values, '{"max_torque": 3000}').items():
            value = finite(name, given)
            if name in self.objects.names and not self.objects.names[name].writable:
                self._commissioned[name] = int(round(value))  # by the maker's tool
                self._put_commissioned()
                self._power_on_changed()
            elif name in self.objects.names:
                try:
                    self.write(name, round(value))
                except SdoAbort as error:
                    raise ValueError(
                        f"drive model {self.model.name!r} refuses {name} = {round(value)}, which "
                        f"its axis needs: {error}"
                    ) from None
            elif name in record.OD.names:  # type: ignore[operator]
                self._commissioned[name] = int(round(value))
                setattr(self.axis.od, name, round(value))
                if self.model.quirk("values_keep_meaning") and name in record.PLACES:
                    written(self, record.PLACES[name])
                self._power_on_changed()
            else:
                refuse_unknown(name, [*self.objects.names, *(record.OD.names or ())])
        self.axis.parameters_changed = 1

    # ---------------------------------------------------------------- objects

    def read(self, index: int | str, subindex: int = 0) -> Any:
        """Read an object (drive units) by address or name. Raises SdoAbort if the drive refuses."""
        slot = self.objects.slot(index, subindex)
        if slot.row.access == "wo":
            raise SdoAbort(Abort.WRITE_ONLY, slot.row.index, slot.row.subindex)
        value = self.objects.shown(slot)
        if isinstance(value, Abort):
            raise SdoAbort(value, slot.row.index, slot.row.subindex)
        return value

    def write(self, index: int | str, *arguments: int | float) -> None:
        """Write an object (drive units): ``write(index, subindex, value)``, ``write(name, value)``.

        Raises:
            SdoAbort: the abort, with its `code`, that the drive would send on the bus; nothing has
                changed.
            TypeError: the value is not a number, or there are too few or too many arguments.
        """
        if not 1 <= len(arguments) <= (1 if isinstance(index, str) else 2):
            raise TypeError(
                f"write{(index, *arguments)}: give name and value, or index, sub-index and value"
            )
        *subindex, value = arguments
        slot = self.objects.slot(index, subindex[0] if subindex else 0)  # type: ignore[arg-type]
        if not isinstance(value, int | float | np.integer | np.floating):
            raise TypeError(f"{slot.row.name}: {value!r} is not a number")
        if not slot.row.real:
            if value != value or value in (float("inf"), float("-inf")) or int(value) != value:
                raise TypeError(f"{slot.row.name}: {value!r} is not a whole number")
            value = int(value)
        abort = self.objects.store(slot, value)
        if abort:
            raise SdoAbort(abort, slot.row.index, slot.row.subindex, slot.accepts)

    # ----------------------------------------------------------- process data

    def map_pdos(
        self, rpdos: Iterable[Iterable[str]] | None = None,
        tpdos: Iterable[Iterable[str]] | None = None,
    ) -> None:
        """Map objects into PDOs by the procedure of CiA 301, one list of names for each PDO.

        PDOs that are not given are disabled. On an EtherCAT drive the flexible PDOs are mapped and
        assigned to the sync managers.

        Raises SdoAbort if the drive refuses an entry, ValueError for too many PDOs.
        """
        map_by_name(self, (rpdos, tpdos))

    def image_changed(self) -> None:
        """Discard everything derived from the PDO mapping."""
        self.communication_version += 1
        self._layouts: dict[str, list[tuple[Slot, int]]] = {}
        self._sizes: dict[str, int] = {}

    def _size(self, direction: str) -> int:
        if direction not in self._sizes:
            pdos = self.rpdos if direction == "rx" else self.tpdos
            self._sizes[direction] = int(pdos["width"][pdos["valid"] == 1].sum())
        return self._sizes[direction]

    @property
    def rpdo_size(self) -> int:
        """Size of the RPDO image (bytes): all valid RPDOs, one after the other."""
        return self._size("rx")

    @property
    def tpdo_size(self) -> int:
        """Size of the TPDO image (bytes): all valid TPDOs, one after the other."""
        return self._size("tx")

    def latch(self, rpdo: bytes) -> None:
        """Apply an RPDO image. Raises ValueError if its length differs from that of the mapping."""
        if len(rpdo) != self.rpdo_size:
            raise ValueError(f"the RPDO image has {self.rpdo_size} bytes, {len(rpdo)} were given")
        image = np.frombuffer(rpdo, np.uint8)
        process_data.latch_axis(self.memory, self.axes, self.index, self.rpdos, image)

    def collect(self) -> bytes:
        """Return the TPDO image of the last position cycle."""
        image = np.empty(self.tpdo_size, np.uint8)
        process_data.collect_axis(self.memory, self.index, self.tpdos, image)
        return image.tobytes()

    def exchange(self, rpdo: bytes) -> bytes:
        """Apply an RPDO image and return the TPDO image of the last position cycle."""
        self.latch(rpdo)
        return self.collect()

    def pack(self, **values: int) -> bytes:
        """Build an RPDO image from values by object name; other objects keep their last values.

        Raises ValueError for a name that is not mapped or a value outside the range of its type.
        """
        image = bytearray(self.rpdo_size)
        layout = self.mapped("rx")
        unknown = values.keys() - {slot.row.name for slot, _ in layout}
        if unknown:
            raise ValueError(f"{', '.join(sorted(unknown))}: not mapped to an RPDO, see map_pdos")
        for slot, at in layout:
            value = values.get(slot.row.name)
            value = slot.get() if value is None else value  # type: ignore[assignment]
            try:
                slot.code.pack_into(image, at, value)
            except Exception as error:
                raise ValueError(f"{slot.row.name} = {value!r}: {error}") from None
        return bytes(image)

    def unpack(self, tpdo: bytes) -> dict[str, int]:
        """Return the values of a TPDO image by object name."""
        if len(tpdo) != self.tpdo_size:
            raise ValueError(f"the TPDO image has {self.tpdo_size} bytes, {len(tpdo)} were given")
        return {s.row.name: s.code.unpack_from(tpdo, at)[0] for s, at in self.mapped("tx")}

    def mapped(self, direction: str) -> list[tuple[Slot, int]]:
        """Return the mapped objects of a direction, "rx" or "tx", and their places in the image."""
        if direction not in self._layouts:
            pdos = self.rpdos if direction == "rx" else self.tpdos
            layout, at = [], 0
            for pdo in pdos[pdos["valid"] == 1]:
                for word in pdo.mapping[: pdo.count].tolist():
                    index, subindex, bits = mapping_entry(word)
                    slot = self.objects.slots.get((index, subindex))
                    if slot is not None:
                        layout.append((slot, at))
                    at += bits // 8
            self._layouts[direction] = layout
        return self._layouts[direction]

    # ------------------------------------------------------------------ cycle

    def cycle(self, angle: float, speed: float = 0.0) -> float:
        """Run one position-controller cycle at a shaft angle (rad) and speed (rad/s).

        Returns the motor torque (Nm). Raises TypeError if an argument is not a number.
        """
        try:
            angle, speed = float(angle), float(speed)
        except (TypeError, ValueError):
            raise TypeError(f"angle (rad) and speed (rad/s): {angle!r}, {speed!r}") from None
        return cycle.run(self.axes, self.index, angle, speed)

    @property
    def state(self) -> State:
        """State of the device control (CiA 402-2)."""
        return State(int(self.axis.state))

    @property
    def mode(self) -> Mode:
        """Active mode of operation (6061h)."""
        return Mode(int(self.axis.mode))

    @property
    def energised(self) -> bool:
        """Whether the motor is supplied with power in the present state."""
        return State.OPERATION_ENABLED <= self.state <= State.FAULT_REACTION_ACTIVE

    @property
    def fault(self) -> str:
        """Code and meaning of the fault that stopped the drive; empty if there is none."""
        return meaning(self.model, self.axis, int(self.axis.fault))

    @property
    def faults(self) -> tuple[str, ...]:
        """Codes and meanings of all pending faults; the one that stopped the drive comes first."""
        first = int(self.axis.fault)
        others = (c for c in Cause if int(self.axis.faults) >> c & 1 and c != first)
        meanings = (meaning(self.model, self.axis, int(cause)) for cause in (first, *others))
        return tuple(filter(None, meanings))

    def errors_since(self, seen: int) -> list[tuple[int, int]]:
        """Codes and causes of the faults after the first `seen` ones, oldest first.

        The record remembers a limited number of faults. A master that clears 1003h does not affect
        them.
        """
        axis = self.axis
        last = int(axis.error_events)
        first = last - min(max(last - seen, 0), record.HISTORY)
        places = [event % record.HISTORY for event in range(first, last)]
        return [(int(axis.event_code[n]), int(axis.event_cause[n])) for n in places]

    def describe(self) -> str:
        """Return the statusword in words."""
        axis = self.axis
        return describe(int(axis.od.statusword), int(axis.mode), self.model.own_modes)

    def why(self) -> str:
        """Explain why the last command was refused: command, state, and what is missing."""
        return refusal(self.axis)

    @property
    def injectable(self) -> tuple[str, ...]:
        """Names that `inject` accepts: causes, "index_missing", the maker's fault numbers."""
        causes = dict.fromkeys(
            fault.cause.name.lower() for fault in self.model.faults if fault.cause
        )
        numbers = dict.fromkeys(fault.name for fault in self.model.faults if fault.name)
        return (*causes, "index_missing", *numbers)

    def inject(self, cause: Cause | str) -> None:
        """Make the cause of a fault present until `clear_injected` is called.

        Args:
            cause: one of `injectable`, such as "encoder_loss" or, on a model that numbers its
                faults, "17-0"; "index_missing" suppresses the index pulse.

        Raises:
            ValueError: the model has no such cause.
        """
        name = cause.name.lower() if isinstance(cause, Cause) else str(cause).lower()
        if name not in self.injectable:
            raise ValueError(f"unknown cause {cause!r}: {hint(str(cause), self.injectable)}")
        if name == "index_missing":
            self.axis.index_missing = 1
        elif name.upper() in Cause.__members__:
            self.axis.injected |= 1 << Cause[name.upper()]
        else:
            self._inject_number(name)

    def _inject_number(self, number: str) -> None:
        """Inject a fault by number; one without a cause is an external fault with its own code."""
        fault = next(fault for fault in self.model.faults if fault.name == number)
        cause = fault.cause or Cause.EXTERNAL
        if not fault.cause:
            if self.axis.fault_code[cause] != fault.code:
                self.axis.faults &= ~(1 << cause)  # another fault than the one that had its place
            self.axis.fault_code[cause] = fault.code
            self.axis.fault_register[cause] = 1 | 1 << fault.register
            self.axis.od.fault_reaction[cause] = reaction_to(self, fault)
        self.axis.injected |= 1 << cause

    def clear_injected(self) -> None:
        """Remove all injected causes; the faults they led to remain until they are reset."""
        self.axis.injected = 0
        self.axis.index_missing = 0

    # --------------------------------------------------------------- snapshot

    def _identity(self) -> dict[str, Any]:
        sizes = [len(self._record), self.rpdos.nbytes, self.tpdos.nbytes, len(self._more)]
        return {
            "kind": "drive", "model": self.model.name, "bus": self.model.bus,
            "objects": _layout(self.model),
            "record": RECORD, "sizes": sizes,
        }

    def snapshot(self) -> bytes:
        """Return the complete state as bytes; `restore` continues from it bit by bit.

        Parameters stored by 1010h and commissioned values are included, a parameter file is not.
        """
        state = {
            "operational": bool(self.operational),
            "commissioned": self._commissioned,
            "stored": self.parameters.kept,
            "alias": self.parameters.alias,
            "texts": [[*at, data.hex()] for at, data in self.objects.texts.items()],
        }
        parts = [bytes(self._record), self.rpdos.tobytes(), self.tpdos.tobytes(), bytes(self._more)]
        return snapshots.seal(self._identity(), state, parts)

    def restore(self, snapshot: bytes) -> None:
        """Restore the state of a `snapshot`.

        Raises:
            ValueError: not a snapshot, altered, or of another model or version; nothing changes.
        """
        self.take(self.opened(snapshot))

    def opened(self, snapshot: bytes) -> tuple[dict[str, Any], list[bytes]]:
        """Check and unpack a snapshot for `take`. Raises ValueError as `restore` does."""
        identity = self._identity()
        return snapshots.unseal(snapshot, identity, STATE, identity["sizes"])

    def take(self, opened: tuple[dict[str, Any], list[bytes]]) -> None:
        """Restore a state that was unpacked by `opened`."""
        state, parts = opened
        views: Any = (
            self._record,
            process_data.raw(self.rpdos),
            process_data.raw(self.tpdos),
            self._more,
        )
        for view, part in zip(views, parts, strict=True):
            view[:] = part
        self.operational = state["operational"]
        texts = {(index, sub): bytes.fromhex(data) for index, sub, data in state["texts"]}
        self.objects.texts.clear()
        self.objects.texts.update(texts)
        self.parameters.become(state["stored"], state["alias"])
        if state["commissioned"] != self._commissioned:
            self._commissioned = state["commissioned"]
            self._power_on_changed()
        self.image_changed()

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy or a pickle is a drive of its own, as this one is now."""
        return _rebuild, (self.model, self.node_id, self.parameters.file, self.snapshot())


def _rebuild(model: DriveModel, node_id: int, file: Path | None, snapshot: bytes) -> Drive:
    drive = Drive(model, node_id=node_id, parameter_file=file)
    drive.restore(snapshot)
    return drive


STATE = {  # of a snapshot, beside the arrays
    "operational": Key(bool, True), "commissioned": Key(dict, True),
    "stored": Key((dict, NoneType), True), "alias": Key(int, True),
    "texts": Key(list, True),
}
RECORD = zlib.crc32(repr(record.AXIS.descr).encode())  # identifies the layout of the record


@functools.cache
def _layout(model: DriveModel) -> int:
    """Checksum of the places of all objects, which distinguishes models of the same name."""
    places = [(key, row.area, row.offset, row.format) for key, row in model.objects.items()]
    return zlib.crc32(repr(sorted(places, key=repr)).encode())
