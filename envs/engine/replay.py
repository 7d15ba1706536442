"""Plays set-points into machines, row by row, in one call of the compiled loop.

A row is a position cycle: values written before it, whether a process image arrives in it, and
values read after it. Many machines can play the same rows in parallel, such as the candidates of a
fit. The process images have a mapping of their own, which may contain any variable or field of a
drive's record.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...drive.kernel.record import AXIS, OD
from ...drive.memory import address
from . import loop
from .world import PDOS, mapped

KEPT = ("pdos", "latches", "latches_from", "latches_count")


class Replay:
    """Layout of rows for machines of one kind.

    Args:
        drive: name of the drive; other drives of a machine are not changed.
        written: variables of the object dictionary, by field name.
        read: fields of the record, or ``od.`` followed by a variable.

    Raises:
        ValueError: a name that is not a field.
    """

    def __init__(self, drive: str, written: Sequence[str], read: Sequence[str]):
        self._drive = drive
        for name in written:
            if name not in (OD.names or ()) or OD[name].shape:
                raise ValueError(f"written: there is no variable {name!r} in the record of a drive")
        self.written = np.dtype([(name, OD[name]) for name in written])
        start = int(AXIS.fields["od"][1])  # type: ignore[index]
        places = [start + int(OD.fields[name][1]) for name in written]  # type: ignore[index]
        self._rpdos = mapped(_widths(places, self.written))
        fields, sources = [], []
        for name in read:
            table, at, short = AXIS, 0, name
            if name.startswith("od."):
                table, at, short = OD, start, name.removeprefix("od.")
            if short not in (table.names or ()) or table[short].shape:
                raise ValueError(f"read: there is no field {name!r} in the record of a drive")
            fields.append((name, table[short]))
            sources.append(at + int(table.fields[short][1]))  # type: ignore[index]
        self.read = np.dtype(fields)
        self._tpdos = mapped(_widths(sources, self.read))

    def run(
        self, machines: Sequence[Any], rows: np.ndarray, arrives: np.ndarray | None = None
    ) -> np.ndarray:
        """Play the rows on all machines, each from its present state.

        Args:
            machines: machines with equal cycles that have the drive.
            rows: of dtype `written`, shape ``(n,)``.
            arrives: whether a process image arrives in a row, shape ``(n,)``; by default in every
                row. A drive interpolates if its period 60C2h covers several rows.

        Returns:
            The values after each row, of dtype `read`, shape ``(len(machines), n)``.

        Raises as `Machine.step` does; an interrupted machine needs a `restore`.
        """
        count, n = len(machines), len(rows)
        first = machines[0]
        images = np.ascontiguousarray(rows, self.written).view(np.uint8).reshape(n, -1)
        flags = np.ones(n, np.uint8) if arrives is None else np.ascontiguousarray(arrives, np.uint8)
        found = np.zeros((count, n), self.read)
        worlds = np.repeat([int(m.addresses[0]) for m in machines], n)
        directories, kept = [], []
        for machine in machines:
            directory = np.zeros(len(machine.drives), PDOS)
            at = [*machine.drives].index(self._drive)
            directory[at] = address(self._rpdos), 1, address(self._tpdos), 1
            world = machine.world
            kept.append({name: world[name].copy() for name in KEPT})
            world["pdos"], world["latches"] = address(directory), address(flags)
            world["latches_from"], world["latches_count"] = world["tick"], n
            directories.append(directory)
        try:
            with first.turn:
                loop.run(
                    worlds, first.physics_steps, np.tile(images, (count, 1)),
                    found.view(np.uint8).reshape(count * n, -1),
                )
        finally:
            for machine, values in zip(machines, kept, strict=True):
                for name, value in values.items():
                    machine.world[name] = value
        return found


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


def _widths(places: Sequence[int], kinds: np.dtype) -> dict[int, int]:
    """Size of each field by its offset."""
    return {at: kinds[name].itemsize for at, name in zip(places, kinds.names or (), strict=True)}
