"""The parameter sets of a drive: factory defaults, what is stored, what is in force.

Power-on fills the record with the model's defaults and then with what was stored (1010h), in a file
or, without one, in the drive itself.
"""

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import store
from .hooks.ars import KEPT, set_reaction
from .model import DriveModel, load
from .objects import all_objects
from .record import AXIS, OD
from .rows import Mapping
from .slots import Slot

if TYPE_CHECKING:
    from .drive import Drive

REACTION = "reaction"  # in a parameter file: changed reaction to a main fault number


@functools.cache
def kept_bytes(model: DriveModel) -> np.ndarray:
    """Where in the record the storable objects of a model are, and what 2100h sets."""
    od = AXIS.fields["od"][1]  # type: ignore[index]
    spans = [
        (row.offset, row.size)
        for row in all_objects(model)
        if row.storable and row.area == "axis" and row.format
    ]
    field, offset = OD.fields["reaction_code"][:2]  # type: ignore[index]
    spans.append((offset, field.itemsize))
    return np.concatenate([np.arange(od + at, od + at + size) for at, size in spans])


class Parameters:
    """Parameter sets of `drive`; `file` is where 1010h stores them, None: only in the drive."""

    def __init__(self, drive: "Drive", file: str | Path | None):
        self._drive = drive
        self.file = None if file is None else Path(file)
        self._stored: store.Values | None = None  # without a file

    def standard_defaults(self) -> None:
        """Objects a model lacks behave as the defaults of the standard's own drive."""
        od = self._drive.objects.names["statusword"].view
        own = {row.offset for row in self._drive.model.objects.values() if row.area == "axis"}
        for row in load("generic").objects.values():
            if row.area == "axis" and row.format and row.offset not in own:
                Slot(row, od).put(row.default)  # type: ignore[arg-type]

    def defaults(self) -> None:
        """Put the factory defaults in force, PDOs included."""
        for slot in self._drive.objects.slots.values():
            if slot.row.area == "axis" and slot.row.format:
                slot.put(self._default(slot))
        self._default_pdos()

    def _default(self, slot: Slot) -> Any:
        """Factory default; some identifiers count from the node-id."""
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
        for (index, subindex), slot in self._drive.objects.slots.items():
            timers = subindex in (5, 6) and (index & 0xFE00) in (0x1400, 0x1800)
            if timers and slot.view is not None:
                slot.put(slot.row.default)  # type: ignore[arg-type]

    def values(self) -> store.Values:
        """All storable values, but not identifiers that still follow from the node-id."""
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
        for main, code in enumerate(self._drive.axis.od.reaction_code.tolist()):
            if code:
                values[f"{REACTION}:{main}"] = code - 1
        return values

    def react(self) -> None:
        """Put the reactions in force that 2100h has set."""
        codes = self._drive.axis.od.reaction_code
        for main in np.flatnonzero(codes).tolist():
            set_reaction(self._drive, main, int(codes[main]) - 1)

    def stored(self) -> store.Values:
        """What was saved, empty without it."""
        if self.file is not None:
            return store.load(self.file, self._drive.model.name)
        return self._stored or {}

    def restore(self, values: store.Values) -> None:
        """Put saved values in force; what the model does not store is left out."""
        for address, value in values.items():
            first, _, second = address.partition(":")
            if first == REACTION:
                set_reaction(self._drive, int(second), int(value))
                continue
            index, subindex = int(first, 16), int(second, 16)
            slot = self._drive.objects.slots.once((index, subindex))
            if slot is not None and slot.view is not None and slot.row.storable:
                slot.put(value)

    def reset_communication(self) -> None:
        """Communication objects 1000h-1FFFh as after power-on; the rest stays (CiA 301, NMT)."""
        stored = self.stored()
        for (index, _), slot in self._drive.objects.slots.items():
            belongs = slot.row.storable or slot.row.per_node
            if index < 0x2000 and slot.row.area == "axis" and belongs:
                slot.put(self._default(slot))
        self._default_pdos()
        self.restore({a: v for a, v in stored.items() if a.startswith("1")})

    def save(self) -> bool:
        """What 1010h does: keep all storable objects for the next power-on; False if it failed."""
        values = self.values()
        if self.file is None:
            self._stored = values
            return True
        try:
            store.save(self.file, self._drive.model.name, values)
        except OSError:
            return False
        return True

    def load_defaults(self) -> None:
        """What 1011h does in models where it acts at once: factory defaults, PDOs stay."""
        for slot in self._drive.objects.slots.values():
            kept = slot.row.name in KEPT or not slot.row.storable
            if slot.row.index >= 0x2000 and slot.row.area == "axis" and not kept:
                slot.put(self._default(slot))
        self._drive.axis.od.reaction_code[:] = 0
        self._drive.model.set_reactions(self._drive.axis)
        self._drive.axis.parameters_changed = 1

    def forget(self) -> bool:
        """What 1011h does: the next power-on finds factory defaults; False if it failed."""
        self._stored = None
        try:
            if self.file is not None:
                self.file.unlink(missing_ok=True)
        except OSError:
            return False
        return True
