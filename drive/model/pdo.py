"""PDOs and their default mapping in a drive model (`pdo.csv`)."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..kernel.process_data import DUMMY_BITS, ENTRIES, MAX_BITS
from .rows import Object, integer, lines_of

PDO_COLUMNS = (
    "direction", "number", "cob_id", "transmission_type", "inhibit_time", "index", "subindex",
    "bits",
)


@dataclass(frozen=True)
class Mapping:
    """A PDO of pdo.csv: default communication parameters and mapped objects."""

    number: int
    cob_id: str
    transmission_type: int
    inhibit_time: int
    entries: tuple[tuple[int, int, int], ...]  # index, subindex, bits


def mapping_entry(word: int) -> tuple[int, int, int]:
    """Index, sub-index and length (bits) in an entry of 1600h … 1BFFh (CiA 301, 7.5.2.36)."""
    return word >> 16, word >> 8 & 0xFF, word & 0xFF


def places(
    objects: dict[tuple[int, int], Object], entries: Iterable[tuple[int, int, int]]
) -> tuple[dict[str, int], int]:
    """The offsets of mapped objects in bytes, by name, and the total number of bytes.

    Args:
        objects: objects of the model.
        entries: mapping of the drive. Objects that the model does not have in this length have no
            offset; they are transferred by SDO.
    """
    found, bits = {}, 0
    for index, subindex, length in entries:
        row = objects.get((index, subindex))
        if row is not None and length == 8 * row.size and bits % 8 == 0:
            found[row.name] = bits // 8
        bits += length
    return found, -(-bits // 8)


def read_pdos(
    path: Path, objects, max_bits: int
) -> tuple[tuple[Mapping, ...], tuple[Mapping, ...]]:
    """Receive and transmit PDOs. Raises ValueError with file, line and reason."""
    found: dict[str, dict[int, Mapping]] = {"rx": {}, "tx": {}}
    for row, where in lines_of(path, PDO_COLUMNS):
        direction = row["direction"].lower()
        if direction not in found:
            raise ValueError(f"{where}: direction {row['direction']!r} is neither rx nor tx")
        number = integer(row["number"], where, "number")
        before = found[direction].get(number)
        entries = before.entries if before else ()
        if row["index"]:  # a row without one is a PDO that is free for mapping
            entries = (*entries, _pdo_entry(row, where, direction, objects, max_bits > MAX_BITS))
        if sum(bits for _, _, bits in entries) > max_bits or len(entries) > ENTRIES:
            raise ValueError(f"{where}: PDO {number} is longer than {max_bits} bits")
        cob_id = row["cob_id"].replace(" ", "")
        if not re.fullmatch(r"0x[0-9A-Fa-f]+(\+node_id)?", cob_id):
            raise ValueError(f"{where}: cob_id {cob_id!r} is not like 0x200+node_id")
        if int(cob_id.partition("+")[0], 0) + 127 >= 1 << 32:
            raise ValueError(f"{where}: cob_id {cob_id} has more than 32 bits")
        found[direction][number] = Mapping(
            number, cob_id, integer(row["transmission_type"], where, "transmission_type", 8),
            integer(row["inhibit_time"] or "0", where, "inhibit_time", 16), entries,
        )
    for pdos in found.values():
        if sorted(pdos) != list(range(1, len(pdos) + 1)):
            raise ValueError(f"{path.name} ({path.parent.name}): PDO numbers have a gap")
    return tuple(tuple(pdos[n] for n in sorted(pdos)) for pdos in found.values())  # type: ignore


def _pdo_entry(row, where, direction, objects, partly: bool) -> tuple[int, int, int]:
    """Index, sub-index and bits; `partly`: the lower bytes of an object may stand alone."""
    index, subindex, bits = (integer(row[key], where, key) for key in ("index", "subindex", "bits"))
    target = objects.get((index, subindex))
    if direction == "rx" and DUMMY_BITS.get(index) == bits and subindex == 0:
        return index, subindex, bits
    size = target.size * 8 if target else 0
    fits = bits == size or (partly and bits % 8 == 0 and bits < size)
    if target is None or not fits or direction not in target.pdo:
        raise ValueError(
            f"{where}: {index:04X}h:{subindex:02X}h with {bits} bits cannot be mapped to a "
            f"{direction} PDO"
        )
    return index, subindex, bits
