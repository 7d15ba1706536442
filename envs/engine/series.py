"""Runs many cycles of a machine in the compiled loop, with values for each cycle.

Each cycle has a process image with a mapping of its own, which may contain any field of a drive's
record.
"""

from collections.abc import Sequence

import numpy as np

from ...drive.kernel.record import AXIS, OD
from ...drive.memory import address
from . import loop
from .machine import Machine
from .world import PDOS, mapped


class Series:
    """Values to be written before and read after each cycle.

    Args:
        machine: the machine; its PDO mapping does not change.
        drives: names of the drives, in the order of the machine.
        written: an object of each drive, by field name.
        read: fields of each drive's record.
    """

    def __init__(self, machine: Machine, drives: Sequence[str], written: str, read: Sequence[str]):
        self._machine = machine
        self._value = OD[written]
        self._row = np.dtype([(name, AXIS[name]) for name in read])
        of_od = int(AXIS.fields["od"][1]) + int(OD.fields[written][1])  # type: ignore[index]
        self._rpdos = mapped({of_od: self._value.itemsize})
        self._tpdos = mapped(
            {int(AXIS.fields[name][1]): AXIS[name].itemsize for name in read}  # type: ignore[index]
        )
        self._count = len(drives)
        self._directory = np.zeros(len(machine.drives), PDOS)
        for i, name in enumerate(machine.drives):
            if name in drives:
                self._directory[i] = address(self._rpdos), 1, address(self._tpdos), 1

    def run(self, values: np.ndarray) -> np.ndarray:
        """Run a cycle for each row of `values`, shape ``(n, drives)``; -> the values read.

        Raises as `Machine.step` does; an interrupted machine needs a `restore`.
        """
        machine, count = self._machine, self._count
        images = np.ascontiguousarray(values, self._value).reshape(len(values), count)
        rows = np.zeros((len(values), count), self._row)
        worlds = np.repeat(machine.addresses, len(values))
        with machine.turn:
            world = machine.world
            kept = {name: world[name].copy() for name in ("pdos", "delay")}
            world["pdos"], world["delay"] = address(self._directory), 0
            try:
                loop.run(worlds, machine.physics_steps, _bytes(images), _bytes(rows))
            finally:
                for name, value in kept.items():
                    world[name] = value
        return rows


def _bytes(rows: np.ndarray) -> np.ndarray:
    """View rows as rows of bytes."""
    return rows.view(np.uint8).reshape(len(rows), rows.shape[1] * rows.itemsize)
