"""The parameter sets of a drive: factory defaults, stored values, and present values.

Power-on fills the record with the model's defaults and then with the values that were stored
(1010h) in a file or, without one, in the drive itself.
"""

import functools
import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..kernel.process_data import ENTRIES
from ..kernel.record import AXIS, OD
from ..model.model import DriveModel, load
from ..model.pdo import Mapping
from . import kept, store
from .abort import TEXT, Abort
from .device import Device
from .hooks import hook_of
from .mapping import all_objects
from .reactions import REACTIONS, chosen, of, reaction_code, set_reaction
from .slots import Slot

# objects that loading the defaults does not change (CMMP-AS 5.5, ARS 2000 6.5.2)
KEPT = ("pole_number", "encoder_offset_angle")
# kinds of entries in a parameter file: the number of an object; a value in the units in which it
# was written; a changed reaction to a fault, by main and sub-number; a setting that 1011h keeps
OBJECT, AS_WRITTEN, REACTION, IDENTITY = "object", "as_written", "reaction", "identity"
ALIAS = "alias:0"  # station alias of an EtherCAT slave
LSS = ("lss:0", "lss:1")  # node-id and bit rate (bit/s; 0: none) of LSS


class Entry(NamedTuple):
    """The meaning of an address in a parameter file."""

    kind: str
    first: int = 0  # index, or main number of a fault
    second: int | None = 0  # sub-index, or sub-number of a fault, None: of every one
    part: str = ""  # of a `kept.WrittenValue`


@functools.lru_cache(4096)
def entry(address: str) -> Entry | None:
    """The entry of an address, as ``6065:00``, ``as_written:6065:00:raw`` or ``reaction:17-0``."""
    if address in (ALIAS, *LSS):
        return Entry(IDENTITY)
    if match := re.fullmatch(rf"{REACTION}:(\d+)(?:-(\d+))?", address):  # older: without a sub
        return Entry(REACTION, int(match[1]), int(match[2]) if match[2] else None)
    match = re.fullmatch(rf"({AS_WRITTEN}:)?([0-9A-F]{{4}}):([0-9A-F]{{2}})(?::(\w+))?", address)
    if match and bool(match[1]) == bool(match[4]):
        kind = AS_WRITTEN if match[1] else OBJECT
        return Entry(kind, int(match[2], 16), int(match[3], 16), match[4] or "")
    return None


@functools.cache
def kept_bytes(model: DriveModel) -> np.ndarray:
    """Offsets in the record of the storable objects of a model, and of the settings of 2100h."""
    od = AXIS.fields["od"][1]  # type: ignore[index]
    spans = [
        (row.offset, row.held.size)
        for row in all_objects(model)
        if row.storable and row.area == "axis" and row.format
    ]
    field, offset = OD.fields["reaction_code"][:2]  # type: ignore[index]
    spans.append((offset, field.itemsize))
    return np.concatenate([np.arange(od + at, od + at + size) for at, size in spans])


class Parameters:
    """Parameter sets of a drive; 1010h stores them in `file`, or with None only in the drive."""

    def __init__(self, drive: Device, file: str | Path | None):
        self._drive = drive
        self.file = None if file is None else Path(file)
        self.kept: store.Values | None = None  # stored by 1010h without a file, or delivered
        self.alias = 0  # station alias that a master has written into the EEPROM, 0: none
        self.lss: tuple[int, int] | None = None  # stored by LSS: node-id, bit rate or 0

    def standard_defaults(self) -> None:
        """Give fields without an object the defaults of the model `generic`."""
        od = self._drive.objects.names["statusword"].view
        own = {row.offset for row in self._drive.model.objects.values() if row.area == "axis"}
        for row in load("generic").objects.values():
            if row.area == "axis" and row.format and row.offset not in own:
                Slot(row, od).put(row.default)  # type: ignore[arg-type]

    def defaults(self) -> None:
        """Apply the factory defaults, including PDOs."""
        self._drive.objects.texts.clear()
        for area in ("axis", "more"):
            for slot in self._drive.objects.slots.within(area):
                if slot.row.format:
                    slot.put(self._default(slot))
        self._default_pdos()

    def _default(self, slot: Slot) -> Any:
        """Factory default; the node-id is added to some identifiers."""
        default: Any = slot.row.default
        return default + self._drive.node_id if slot.row.per_node else default

    def _default_cob_id(self, mapping: Mapping) -> int:
        base, _, node = mapping.cob_id.partition("+")
        return int(base, 0) + (self._drive.node_id if node else 0)

    def _default_pdos(self) -> None:
        for pdos, mappings in (
            (self._drive.rpdos, self._drive.model.rpdos),
            (self._drive.tpdos, self._drive.model.tpdos),
        ):
            for pdo, mapping in zip(pdos, mappings, strict=True):
                pdo.cob_id = self._default_cob_id(mapping)
                pdo.transmission_type = mapping.transmission_type
                pdo.inhibit_time = mapping.inhibit_time
                pdo.count = len(mapping.entries)
                pdo.mapping[:] = 0
                pdo.mapping[: pdo.count] = [
                    index << 16 | subindex << 8 | bits for index, subindex, bits in mapping.entries
                ]
        for area in ("rpdo", "tpdo"):
            for slot in self._drive.objects.slots.within(area):
                index, subindex = slot.row.index, slot.row.subindex
                if subindex in (5, 6) and (index & 0xFE00) in (0x1400, 0x1800):
                    slot.put(slot.row.default)  # type: ignore[arg-type]

    def values(self) -> store.Values:
        """All storable values except identifiers that still follow from the node-id."""
        model = self._drive.model
        follow = {
            (base + number, 1): self._default_cob_id(mapping)
            for base, mappings in ((0x1400, model.rpdos), (0x1800, model.tpdos))
            for number, mapping in enumerate(mappings)
        }
        values: store.Values = {
            f"{index:04X}:{subindex:02X}": value  # type: ignore[misc]
            for (index, subindex), slot in self._drive.objects.slots.items()
            if slot.row.storable
            and slot.view is not None
            and (value := slot.get()) != follow.get((index, subindex))
            and not (slot.row.per_node and value == self._default(slot))
        }
        for fault in model.faults:
            if chosen(self._drive, fault):
                address = f"{REACTION}:{fault.main}-{fault.sub or 0}"
                values[address] = reaction_code(self._drive, fault)
        for n, value in kept.kept(self._drive).items():
            row = kept.storable(model)[n]
            for part, number in value._asdict().items():
                values[f"{AS_WRITTEN}:{row.index:04X}:{row.subindex:02X}:{part}"] = number
        return values | self._identity()

    def _identity(self) -> store.Values:
        """Stored settings that are no parameters and stay when 1011h deletes those."""
        values: store.Values = {ALIAS: self.alias} if self.alias else {}
        return values | dict(zip(LSS, self.lss or (), strict=False))

    def react(self) -> None:
        """Apply the reactions that 2100h has set."""
        for fault in self._drive.model.faults:
            if chosen(self._drive, fault):
                set_reaction(self._drive, [fault], reaction_code(self._drive, fault))

    def use(self, file: Path) -> None:
        """Store in a file from now on and load it; values that it lacks stay as they are.

        Raises ValueError if the file exists and cannot be trusted, as its user wants its values and
        not the factory defaults with which a drive would power on.
        """
        try:
            values = store.read(file, self._drive.model.name, self._unfit)
            if refused := self._untried(values):
                raise ValueError(refused)
        except ValueError as error:
            raise ValueError(
                f"parameter file {file}: {error}; store the parameters again (1010h), or take "
                "another file"
            ) from None
        self.file = file
        self.restore(self.stored())
        self._drive.axis.parameters_changed = 1

    def become(self, kept: store.Values | None, alias: int) -> None:
        """Take over the values that another drive has stored without a file."""
        self.kept = kept
        if self.file is None:
            self.stored()
        self.alias = alias

    def stored(self) -> store.Values:
        """The saved values, or none; those of a file replace those of `deliver`."""
        values = dict(self.kept or {})
        if self.file is not None:
            values |= store.load(self.file, self._drive.model.name, self._unfit)
        self.alias = int(values.get(ALIAS, 0))
        self.lss = (int(values[LSS[0]]), int(values.get(LSS[1], 0))) if LSS[0] in values else None
        return values

    def _unfit(self, address: str, value: int | float) -> str:
        """Reason why the drive cannot have a value of a parameter file; empty if it can."""
        found = entry(address)
        if found is None:
            return "has no address of an object"
        if found.kind == IDENTITY:
            low, high = {ALIAS: (0, 0xFFFF), LSS[0]: (1, 255)}.get(address, (0, 1_000_000))
            whole = isinstance(value, int) and (address != LSS[0] or not 127 < value < 255)
            return "" if whole and low <= value <= high else "cannot be stored"
        if found.kind == REACTION:
            known = found.first < 0x100 and value in REACTIONS
            return "" if known else "is not a reaction to a fault"
        slot = self._storable(found)
        if found.kind == AS_WRITTEN:
            known = slot is not None and slot.kept in kept.storable(self._drive.model)
            whole = isinstance(value, int) or found.part == "unit"
            fits = found.part in kept.WrittenValue._fields and whole and abs(value) < 2**62
            return "" if known and fits else "is not a value as it was written"
        if slot is None:
            return ""  # left out
        row = slot.row
        if not (math.isfinite(value) if row.real else isinstance(value, int)):
            return f"is not of type {row.data_type}"
        if slot.kept is not None and slot.kept != kept.FACTOR:
            info = np.iinfo(np.dtype("<" + row.format))  # the range of the row is in other units
            return "" if info.min <= value <= info.max else f"is not of type {row.data_type}"
        if not row.minimum <= value <= row.maximum:
            return f"is out of range {row.minimum:.0f}..{row.maximum:.0f}"
        if row.allowed is not None and value not in row.allowed:
            return "is none of the values that are allowed"
        mapping = row.area in ("rpdo", "tpdo") and row.index & 0x200 and row.subindex == 0
        return f"is more than {ENTRIES} entries" if mapping and value > ENTRIES else ""

    def _ranges(self, values: store.Values) -> store.Ranges:
        """Ranges of the values of objects."""
        found = ((address, entry(address)) for address in values)
        slots = {a: self._storable(e) for a, e in found if e is not None and e.kind == OBJECT}
        return {
            address: [int(slot.row.minimum), int(slot.row.maximum)]
            for address, slot in slots.items() if slot is not None and not slot.row.real
        }

    def _storable(self, found: Entry) -> Slot | None:
        """The slot of an entry, if the model has the object and stores it."""
        slot = self._drive.objects.slots.once((found.first, found.second or 0))
        return slot if slot is not None and slot.row.storable else None

    def restore(self, values: store.Values) -> None:
        """Apply saved values, except those that the model does not store.

        Values that define the units come first: defaults keep their meaning, and the other values
        are numbers in these units or, if saved so, values as they were written. Incompatible values
        cause a warning, and none of them is used.
        """
        self._put(values)
        wrong = self._clash(values)
        if wrong:
            axis = self._drive.axis
            axis.converted, axis.unit[:] = 0, 0.0  # the defaults are in units of their own
            self.defaults()
            store.ignored(self.file or Path("of the drive"), wrong)

    def _clash(self, values: store.Values) -> str:
        """Reason why the present values are incompatible; empty if they are not."""
        for address, value in values.items():
            found = entry(address)
            slot = self._storable(found) if found and found.kind == OBJECT else None
            hook = hook_of(self._drive.model, slot.row.hook) if slot and slot.row.hook else None
            if slot and hook and hook.judges and hook.write:
                abort = hook.write(self._drive.objects, slot.row, int(value))
                if abort is not Abort.NONE:
                    return f"{address} = {value}: {TEXT[abort]}"
        return ""

    def _put(self, values: store.Values) -> None:
        factors: list[tuple[Slot, int | float]] = []
        others: list[tuple[Slot, int | float]] = []
        exact: dict[Any, dict[str, Any]] = {}  # by place
        for address, value in values.items():
            found = entry(address)
            if found is None or found.kind == IDENTITY:
                continue
            if found.kind == REACTION:
                set_reaction(self._drive, of(self._drive, found.first, found.second), int(value))
                continue
            slot = self._storable(found)
            if slot is None or slot.view is None:
                continue
            if found.kind == AS_WRITTEN:
                exact.setdefault(slot.kept, {})[found.part] = value
            else:
                (factors if slot.kept == kept.FACTOR else others).append((slot, value))
        if factors:
            self._drive.objects.put_factors(factors)
        for slot, value in others:
            slot.put(value)
        if self._drive.model.quirk("values_keep_meaning"):
            whole = {n: p for n, p in exact.items() if len(p) == len(kept.WrittenValue._fields)}
            kept.keep(self._drive, {n: kept.WrittenValue(**parts) for n, parts in whole.items()})

    def reset_communication(self) -> None:
        """Communication objects 1000h-1FFFh as after power-on; the rest stays (CiA 301, NMT)."""
        stored = self.stored()
        for (index, _), slot in self._drive.objects.slots.items():
            belongs = slot.row.storable or slot.row.per_node
            if index < 0x2000 and slot.row.area in ("axis", "more") and belongs:
                slot.put(self._default(slot))
        self._default_pdos()
        self.restore({a: v for a, v in stored.items() if a.startswith("1")})

    def keep_alias(self, alias: int) -> bool:
        """Store a station alias alone, or with all parameters if the model does so.

        The alias is no parameter, so 1011h keeps it. Returns False if it failed.
        """
        values = self.values() if self._drive.model.quirk("alias_saves") else self.stored()
        self.alias = alias
        return self._keep({**values, ALIAS: alias})

    def keep_lss(self, node_id: int, bit_rate: int | None) -> bool:
        """Store the configuration by LSS alone, which 1011h keeps. Returns False if it failed."""
        stored = self.stored()
        self.lss = node_id, bit_rate or 0
        return self._keep(stored | self._identity())

    def export(self) -> bytes:
        """The content of a parameter file with the present values."""
        values = self.values()
        return store.encode(self._drive.model.name, values, self._ranges(values)).encode()

    def take(self, content: bytes) -> str:
        """Store a parameter file for the next power-on; return why it is refused, if it is."""
        try:
            values = store.decode(content.decode(), self._drive.model.name, self._unfit)
        except ValueError as error:
            return str(error)
        if refused := self._untried(values):
            return refused
        return "" if self._keep(values) else "it could not be stored"

    def _untried(self, values: store.Values) -> str:
        """Try what power-on will do and undo it; return why it fails, if it does."""
        before = self._drive.snapshot()
        self._put(values)
        wrong = self._clash(values)
        self._drive.restore(before)
        return wrong

    def deliver(self) -> None:
        """Keep the present values for every power-on, as when a commissioned axis is handed over.

        Many masters begin with NMT reset node, which discards values that are not stored. 1011h
        still restores the factory defaults.
        """
        self.kept = self.values()

    def save(self) -> bool:
        """Store all storable objects for the next power-on (1010h); False if it failed."""
        return self._keep(self.values())

    def _keep(self, values: store.Values) -> bool:
        if self.file is None:
            self.kept = values
            return True
        try:
            store.save(self.file, self._drive.model.name, values, self._ranges(values))
        except OSError:
            return False
        return True

    def load_defaults(self) -> None:
        """Apply factory defaults except those of PDOs: 1011h in models where it acts at once."""
        slots = [
            slot
            for slot in self._drive.objects.slots.values()
            if slot.row.index >= 0x2000
            and slot.row.area in ("axis", "more")
            and slot.row.storable
            and slot.row.name not in KEPT
        ]
        makers = [(slot, self._default(slot)) for slot in slots if slot.kept == kept.FACTOR]
        self._drive.objects.put_factors(makers)
        for slot in slots:
            if slot.kept != kept.FACTOR:
                self._drive.objects.put(slot, self._default(slot))
        self._drive.axis.od.reaction_code[:] = 0
        self._drive.model.set_reactions(self._drive.axis)
        self._drive.axis.parameters_changed = 1

    def forget(self) -> bool:
        """Delete the stored values, so that the next power-on loads factory defaults (1011h).

        Returns False if it failed.
        """
        if identity := self._identity():
            return self._keep(identity)
        self.kept = None
        try:
            if self.file is not None:
                self.file.unlink(missing_ok=True)
        except OSError:
            return False
        return True
