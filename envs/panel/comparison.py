"""Compares the parameters of a drive, of a file and of the factory."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from ...drive.master import ServoError
from ...drive.model.rows import Object
from ...drive.objects import store
from ...drive.objects.abort import SdoAbort
from .bench import Bench


class Difference(NamedTuple):
    """A parameter whose values differ."""

    row: Object
    node: float | None  # None: it could not be read
    factory: float | None
    file: float | None  # None: the file does not have it


def of_file(content: bytes, model: str) -> store.Values:
    """The values of a parameter file by address. Raises ValueError for a damaged or foreign one."""
    return store.decode(content.decode(), model)


def compare(bench: Bench, axis: str, file: Mapping[str, float] | None = None) -> list[Difference]:
    """All storable parameters of a drive that differ from the factory's, or from a file's."""
    found = []
    for row in bench.rows(axis):
        if not row.storable or not row.format or row.access in ("wo", "const"):
            continue
        key = f"{row.index:04X}:{row.subindex:02X}"
        try:
            node: float | None = bench.port.upload(axis, row.name)
        except (ServoError, SdoAbort, ValueError):
            node = None
        kept = file.get(key) if file is not None else None
        factory: Any = None if row.per_node else row.default
        others = [float(value) for value in (factory, kept) if value is not None]
        if any(node is None or value != node for value in others):
            found.append(Difference(row, node, factory, kept))
    return found


def write_back(bench: Bench, axis: str, chosen: Mapping[Object, float]) -> list[str]:
    """Write values to the drive; -> a line for each refused value, with the reason."""
    wrong = []
    for row, value in chosen.items():
        whole = value if row.real else int(value)
        if said := bench.command(axis, row.index, row.subindex, whole):
            wrong.append(f"{row.address} {row.name}: {said}")
    return wrong
