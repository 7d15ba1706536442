"""Plays set-points into machines, row by row, in one call of the compiled loop.

A row is a position cycle: values written before it, whether a process image arrives in it, and
values read after it. Many machines can play the same rows in parallel, such as the candidates of a
fit. The process images have a mapping of their own, which may contain any variable or field of a
drive's record; the PDO mapping of the drives does not change.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ...drive.kernel.record import AXIS, OD
from ...drive.memory import address
from . import loop
from .world import PDOS, mapped

KEPT = ("pdos", "delay", "latches", "latches_from", "latches_count")  # of a WORLD, put back later


class Replay:
    """Layout of rows for machines of one kind.

    Args:
        drives: name of the drive, or several in the order of the machine, which then have a column
            each; other drives of a machine are not changed.
        written: variables of the object dictionary, by field name.
        read: fields of the record, or ``od.`` followed by a variable.

    Raises:
        ValueError: a name that is not a field.
    """

    def __init__(self, drives: str | Sequence[str], written: Sequence[str], read: Sequence[str]):
        self._columns = () if isinstance(drives, str) else (len(drives),)
        self._drives = [drives] if isinstance(drives, str) else [*drives]
        self.written, self._rpdos = _image([f"od.{name}" for name in written], "written")
        self.written.names = tuple(written)
        self.read, self._tpdos = _image(read, "read")

    def run(
        self, machines: Sequence[Any], rows: np.ndarray, arrives: np.ndarray | None = None, *,
        delay: int | None = None,
    ) -> np.ndarray:
        """Play the rows on all machines, each from its present state.

        Args:
            machines: machines with equal cycles that have the drives.
            rows: of dtype `written`, or numbers where it has one field; shape ``(n,)``, with
                several drives ``(n, drives)``.
            arrives: whether a process image arrives in a row, shape ``(n,)``; by default in every
                row. A drive interpolates if its period 60C2h covers several rows.
            delay: physics steps by which an image is late; by default those of each machine.

        Returns:
            The values after each row, of dtype `read`, shape ``(len(machines), n)``, with several
            drives ``(len(machines), n, drives)``.

        Raises as `Machine.step` does; an interrupted machine needs a `restore`.
        """
        count, n, columns = len(machines), len(rows), len(self._drives)
        images = np.ascontiguousarray(rows, self.written).reshape(n, columns)
        flags = np.ones(n, np.uint8) if arrives is None else np.ascontiguousarray(arrives, np.uint8)
        found = np.zeros((count * n, columns), self.read)
        worlds = np.repeat([int(m.addresses[0]) for m in machines], n)
        directories, kept = [], []
        for machine in machines:
            directory = np.zeros(len(machine.drives), PDOS)
            for name in self._drives:
                places = address(self._rpdos), 1, address(self._tpdos), 1
                directory[machine.number(name)] = places
            world = machine.world
            kept.append({name: world[name].copy() for name in KEPT})
            world["pdos"], world["latches"] = address(directory), address(flags)
            world["latches_from"], world["latches_count"] = world["tick"], n
            if delay is not None:
                world["delay"] = delay
            directories.append(directory)
        try:
            with machines[0].turn:
                loop.run(
                    worlds, machines[0].physics_steps, np.tile(_bytes(images), (count, 1)),
                    _bytes(found),
                )
        finally:
            for machine, values in zip(machines, kept, strict=True):
                for name, value in values.items():
                    machine.world[name] = value
        return found.reshape(count, n, *self._columns)


def rows_of(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Convert columns of equal length to rows. Raises ValueError for different lengths."""
    arrays = {name: np.atleast_1d(np.asarray(values)) for name, values in columns.items()}
    lengths = {len(values) for values in arrays.values()}
    if len(lengths) != 1:
        raise ValueError(f"rows: the columns {', '.join(arrays)} must be of one length")
    rows = np.zeros(lengths.pop(), [(name, OD[name]) for name in arrays])
    for name, values in arrays.items():
        rows[name] = values
    return rows


def _image(names: Iterable[str], what: str) -> tuple[np.dtype, np.ndarray]:
    """The record of some fields of a drive's record, and a PDO that maps them."""
    kinds, sizes = [], {}
    for name in names:
        table, short = (OD if name.startswith("od.") else AXIS), name.removeprefix("od.")
        if short not in (table.names or ()) or table[short].shape:
            raise ValueError(f"{what}: there is no field {name!r} in the record of a drive")
        start = int(AXIS.fields["od"][1]) if table is OD else 0  # type: ignore[index]
        kinds.append((name, table[short]))
        sizes[start + int(table.fields[short][1])] = table[short].itemsize  # type: ignore[index]
    return np.dtype(kinds), mapped(sizes)


def _bytes(rows: np.ndarray) -> np.ndarray:
    """View rows as rows of bytes."""
    return rows.view(np.uint8).reshape(len(rows), rows.shape[1] * rows.itemsize)
