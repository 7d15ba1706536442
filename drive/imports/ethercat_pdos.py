"""PDOs of an imported EtherCAT drive, in the form of ethercat_pdo.csv.

PDOs are whole objects here. Gaps, parts of bytes and objects without a usable type become objects
that do nothing, so that all the other entries keep their places.
"""

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace

from ..canopen.sheet import Entry
from ..ethercat.description import (
    FIXED,
    INPUTS,
    OUTPUTS,
    UNASSIGNED,
    Description,
    Pdo,
    describe,
)
from ..ethercat.description import Entry as PdoEntry
from ..ethercat.esi_reader import UNSIGNED, EsiObject
from ..kernel.process_data import ENTRIES, parameter_place
from ..model.drive_toml import BUSES
from ..model.ethercat import PROTOCOLS
from ..model.made import PdoRow, line
from ..model.model import load
from ..model.rows import FORMATS, SIZES
from .rows import NEEDED, ObjectRows

Mapped = tuple[int, int, int]  # index (0 of a gap), sub-index, bits
SOURCE = "EtherCAT"  # of a row, as its section
_LONGEST = BUSES["ethercat"]  # bits of a PDO
_AREAS = {"rx": range(0x1600, 0x1A00), "tx": range(0x1A00, 0x1C00)}
_PADDING = 0x5FF0  # our object for bits of a PDO that no object of ours has (inferred)


def assignment(manager: int) -> int:
    """The object that lists the PDOs of a sync manager: 1C12h for outputs, 1C13h for inputs."""
    return 0x1C10 + manager


# ----------------------------------------------------- descriptions that list no PDOs


def with_pdos(device: Description, objects: Sequence[EsiObject]) -> tuple[Description, str]:
    """Give a description without PDOs those of its dictionary, or else those of `generic`.

    Returns:
        The description, and a note about the PDOs, which is empty if it has its own.
    """
    if device.rpdos or device.tpdos or not device.protocols >> PROTOCOLS.index("CoE") & 1:
        return device, ""
    values = {(row.index, row.subindex): row for row in objects}
    rpdos, tpdos = _listed(values, 0x1600, OUTPUTS), _listed(values, 0x1A00, INPUTS)
    whose = "those of its objects 1600h and 1A00h on"
    if not (rpdos or tpdos):
        usual = describe(load("generic", "ethercat"))
        rpdos, tpdos = _possible(usual.rpdos, values), _possible(usual.tpdos, values)
        whose = "`inferred`, those of `generic`"
    return (replace(device, rpdos=rpdos, tpdos=tpdos),
            f"PDOs: {whose}; the description lists none.")


def _listed(
    values: Mapping[tuple[int, int], EsiObject], first: int, manager: int
) -> tuple[Pdo, ...]:
    """The PDOs of a direction, from the values of a dictionary (ETG.1000.6, 5.6.7.4)."""

    def numbers(index: int) -> list[int]:
        def value(subindex: int) -> int:
            text = values[index, subindex].default if (index, subindex) in values else ""
            try:
                return int(text, 16 if text[:2] == "0x" else 10)
            except ValueError:
                return 0

        return [value(n) for n in range(1, min(value(0), 254) + 1)]

    assigned, pdos = numbers(assignment(manager)), []
    for index in sorted({index for index, _ in values if first <= index < first + 0x200}):
        entries = tuple(PdoEntry(row >> 16, row >> 8 & 0xFF, row & 0xFF, 0)
                        for row in numbers(index))
        fixed = all(values[index, n].access == "ro" for n in range(2) if (index, n) in values)
        if entries:
            pdos.append(Pdo(index, values[min(a for a in values if a[0] == index)].group,
                            manager if index in assigned else UNASSIGNED, FIXED * fixed, entries))
    return tuple(pdos)


def _possible(pdos: Sequence[Pdo], values: Container[tuple[int, int]]) -> tuple[Pdo, ...]:
    """PDOs with those of their entries that a dictionary has; all, if it is not that of a drive."""
    if not all((index, 0) in values for index in NEEDED):
        return tuple(pdos)
    kept = ((pdo, tuple(e for e in pdo.entries if (e.index, e.subindex) in values)) for pdo in pdos)
    return tuple(replace(pdo, entries=entries) for pdo, entries in kept if entries)


# ------------------------------------------------------------------- descriptions to rows


class EthercatPdos:
    """The PDOs of a device as rows, and their default assignment.

    Args:
        device: the device.
        objects: rows of its objects; objects that only a PDO has are added to them.
        whole: whether the device brings a dictionary; otherwise its objects are those of `generic`.
    """

    def __init__(self, device: Description, objects: ObjectRows, *, whole: bool):
        self.device = device
        self.objects = objects
        self.whole = whole
        self.rows: list[PdoRow] = []
        self.assigned: dict[int, list[int]] = {}  # PDOs by sync manager
        self.mappable: list[int] = []  # PDOs of each direction whose content can be changed
        self.padding = 0  # objects that do nothing
        self._as_generic: set[tuple[int, int]] = set()  # objects mapped with the type of `generic`

    def make(self) -> list[PdoRow]:
        """Make the rows."""
        for direction, manager, pdos in (
            ("rx", OUTPUTS, self.device.rpdos), ("tx", INPUTS, self.device.tpdos)
        ):
            kept = [(pdo, entries) for pdo in pdos
                    if (entries := self._mapped(direction, pdo)) is not None]
            order = sorted(kept, key=lambda row: row[0].flags & FIXED)  # those that are mappable
            self.mappable.append(sum(not pdo.flags & FIXED for pdo, _ in kept))
            self.rows += _rows(direction, order)
            self.assigned[manager] = self._chosen(manager, [pdo for pdo, _ in order])
        return self.rows

    @property
    def counts(self) -> tuple[int, int]:
        """The numbers of RPDOs and TPDOs."""
        rx, tx = (len({row.number for row in self.rows if row.direction == direction})
                  for direction in _AREAS)
        return rx, tx

    def bytes_of(self, manager: int) -> int:
        """Bytes of the PDOs that are assigned to a sync manager, or of its longest PDO."""
        direction = "rx" if manager == OUTPUTS else "tx"
        bits: dict[int, int] = {}
        for row in self.rows:
            if row.direction == direction and isinstance(row.bits, int):
                index = int(row.cob_id, 0)
                bits[index] = bits.get(index, 0) + row.bits
        assigned = sum(bits.get(index, 0) for index in self.assigned[manager])
        return max([assigned, *bits.values()], default=0) // 8

    def _repair(self, where: str, says: str, taken: str, why: str) -> None:
        self.objects.sheet.tell(0, where, says, taken, why)

    def _mapped(self, direction: str, pdo: Pdo) -> list[Mapped] | None:
        """Convert entries for the model; None if the PDO is left out, which is reported."""
        where = f"{pdo.index:04X}h"
        if pdo.index not in _AREAS[direction]:
            self._repair(where, "a PDO", "left out", "PDOs of this direction have other indices")
            return None
        entries: list[Mapped] = []
        loose = 0  # bits that no object of ours carries, before the next that one does

        def fill() -> None:
            nonlocal loose
            if loose:
                entries.extend(_gaps(-(-loose // 8)))
                self._repair(where, f"{loose} bits: gaps or parts of bytes", "objects that do "
                             "nothing", "PDOs are whole objects here")
            loose = 0

        for entry in pdo.entries:
            whole = loose % 8 == 0 and entry.index and entry.bits % 8 == 0
            if whole and self._can_map(direction, entry):
                fill()
                entries.append((entry.index, entry.subindex, entry.bits))
            else:
                loose += entry.bits
        fill()
        if len(entries) > ENTRIES:
            self._shorten(where, entries)
        if len(entries) > ENTRIES or sum(bits for *_, bits in entries) > _LONGEST:
            self._repair(where, f"{len(entries)} entries", "left out",
                         f"at most {ENTRIES} entries and {_LONGEST} bits here")
            return None
        return [entry if entry[0] else self._filler(direction, entry[2]) for entry in entries]

    def _shorten(self, where: str, entries: list[Mapped]) -> None:
        """Limit the entries of a PDO: adjacent manufacturer-specific objects become one gap."""
        own = [entry[:2] not in self.objects.base.objects for entry in entries]
        at = len(entries)
        while at and len(entries) > ENTRIES:
            end = at
            while at and own[at - 1]:
                at -= 1
            if end - at > 1:
                bits = sum(bits for *_, bits in entries[at:end])
                names = ", ".join(f"{i:04X}h:{s:02X}h" for i, s, _ in entries[at:end] if i)
                entries[at:end] = _gaps(bits // 8)
                self._repair(where, names, "objects that do nothing",
                             f"at most {ENTRIES} entries here")
            at -= bool(at)

    def _filler(self, direction: str, bits: int) -> Mapped:
        """An object that does nothing, for a gap."""
        self.padding += 1
        index, subindex = _PADDING + self.padding // 255, self.padding % 255 + 1
        self.objects.take(
            Entry(index, subindex, f"padding {self.padding}", "RECORD", UNSIGNED[bits],
                  "rw" if direction == "rx" else "ro", True, "", "", "", 0)
        )
        return index, subindex, bits

    def _can_map(self, direction: str, entry: PdoEntry) -> bool:
        """Whether an object can be mapped in this length; a missing object is created."""
        address = entry.index, entry.subindex
        rows, own = self.objects.rows, "rw" if direction == "rx" else "ro"
        known = None if self.whole else self.objects.base.objects.get(address)
        if parameter_place(*address) is not None:
            return False  # communication parameters
        if known is not None and address not in rows:
            if 8 * known.size == entry.bits:
                self._as_generic.add(address)
                if direction not in known.pdo:
                    rows[address] = {"index": f"0x{entry.index:04X}",
                                     "pdo": "rxtx" if known.pdo else direction,
                                     "subindex": f"0x{entry.subindex:02X}"}
                return True
            if address in self._as_generic:
                return False
        if address not in rows:
            if entry.bits not in UNSIGNED:
                return False
            self.objects.take(
                Entry(*address, entry.name or "mapped", "VAR",
                      entry.data_type or UNSIGNED[entry.bits],
                      own if known is None else known.access, True, "", "", "", 0)
            )
        row = rows.get(address)
        if row is None or row.get("access") == "const":
            return False
        if "data_type" in row:
            letter = FORMATS[row["data_type"]]
            if not letter or 8 * SIZES[letter] != entry.bits:
                return False
        if direction not in row["pdo"]:
            row["pdo"] = "rxtx" if row["pdo"] else direction
        return True

    def _chosen(self, manager: int, order: Sequence[Pdo]) -> list[int]:
        """The PDOs that are assigned by default, as 1C12h and 1C13h accept them here."""
        places = {pdo.index: n for n, pdo in enumerate(order)}
        wanted = [pdo.index for pdo in self.device.assigned(manager)]
        found = sorted((index for index in wanted if index in places), key=places.__getitem__)
        where = f"{assignment(manager):04X}h"
        if not found and order and wanted:
            self._repair(where, "PDOs that were left out", f"{order[0].index:04X}h",
                         "it is the first that remains")
            return [order[0].index]
        apart = {pdo.index: pdo.excludes for pdo in order}
        if wrong := [index for index in found if {*apart[index]} & {*found}]:
            self._repair(where, ", ".join(f"{index:04X}h" for index in found), f"{found[0]:04X}h",
                         f"{wrong[0]:04X}h excludes the others")
            return found[:1]
        return found


def _gaps(size: int) -> Iterator[Mapped]:
    """Gaps of so many bytes together, each as long as an object can be."""
    while size:
        part = next(part for part in (8, 4, 2, 1) if part <= size)
        size -= part
        yield 0, 0, 8 * part


def _rows(direction: str, order: Sequence[tuple[Pdo, list[Mapped]]]) -> Iterator[PdoRow]:
    for number, (pdo, entries) in enumerate(order, 1):
        head = PdoRow(direction, number, f"0x{pdo.index:04X}", note=line(pdo.name), section=SOURCE)
        for place, (index, subindex, bits) in enumerate(entries, 1):
            yield replace(head, position=place, index=f"0x{index:04X}",
                          subindex=f"0x{subindex:02X}", bits=bits)
        if not entries:
            yield head
