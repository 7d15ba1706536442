"""Arrays on a warp device with one row per machine, and copies to and from the host."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...drive.kernel.record import accessible


def aligned(record: np.dtype) -> np.dtype:
    """Return a dtype with the same fields, each aligned to a multiple of its size."""
    return np.dtype([(name, record[name]) for name in record.names or ()], align=True)


class Rows:
    """An array on a device with one row per machine, and waiting rows that can replace them.

    Args:
        wp: warp.
        memory: contiguous memory on the device, owned by the caller.
        n: number of rows.
    """

    def __init__(self, wp: Any, memory: Any, n: int):
        self._wp, self.memory = wp, memory
        size = wp.types.type_size_in_bytes(memory.dtype) * memory.size // n
        self._number = np.dtype(np.uint8 if size % 4 else np.int32)
        number, shape = wp.dtype_from_numpy(self._number), (n, size // self._number.itemsize)
        self._live = wp.array(ptr=memory.ptr, dtype=number, shape=shape, device=memory.device)
        self._waiting = wp.clone(self._live)

    def send(self, rows: Sequence[int], values: np.ndarray) -> None:
        """Copy `values` to rows of the device."""
        self._write(self._live, rows, values)

    def keep(self, rows: Sequence[int], values: np.ndarray) -> None:
        """Copy `values` to the waiting rows."""
        self._write(self._waiting, rows, values)

    def begin(self, rows: Sequence[int]) -> None:
        """Replace these rows by the waiting ones."""
        at = self._at(rows)
        self._wp.copy(
            self._wp.indexedarray(self._live, at), self._wp.indexedarray(self._waiting, at)
        )

    def fetch(self, rows: Sequence[int]) -> np.ndarray:
        """Copy rows back, shape ``(len(rows), bytes)``."""
        some = self._wp.empty((len(rows), self._live.shape[1]), dtype=self._live.dtype,
                              device=self._live.device)
        self._wp.copy(some, self._wp.indexedarray(self._live, self._at(rows)))
        return some.numpy().view(np.uint8)

    def _write(self, target: Any, rows: Sequence[int], values: np.ndarray) -> None:
        wp, plain = self._wp, np.ascontiguousarray(values)
        numbers = plain.view(np.uint8).reshape(len(rows), -1).view(self._number)
        brought = wp.array(numbers, dtype=target.dtype, device=target.device)
        wp.copy(wp.indexedarray(target, self._at(rows)), brought)

    def _at(self, rows: Sequence[int]) -> list[Any]:
        wp = self._wp
        at = wp.array(np.asarray(rows, np.int32), dtype=wp.int32, device=self._live.device)
        return [at, None]


class Records:
    """An array of a batch and its copy on the device, as records that a GPU can read.

    Args:
        wp: warp.
        device: the warp device.
        here: array of the batch with one row per environment.
        kind: record type on the device.
        columns: number of columns; 0 for one dimension.
        memory: memory on the device; by default allocated here.
    """

    def __init__(
        self, wp: Any, device: Any, here: np.ndarray, kind: np.dtype, columns: int = 0,
        memory: Any = None,
    ):
        self._wp = wp
        self.kind, self._columns, self._here = kind, columns, here.view(np.ndarray)
        self._staged = np.zeros((len(here), max(columns, 1)), kind)
        if memory is None:
            memory = wp.zeros(self._staged.nbytes, dtype=wp.uint8, device=device)
        self.rows = Rows(wp, memory, len(here))
        self._staged_bytes = wp.array(
            self._staged.view(np.uint8).reshape(-1), dtype=wp.uint8, device="cpu", copy=False
        )
        same = here.dtype.itemsize == kind.itemsize or not columns
        self._same = same and here.nbytes == self._staged.nbytes

    def view(self) -> np.ndarray:
        """The records on the device, if it is a CPU."""
        records = self.rows.memory.numpy().view(accessible(self.kind))
        return records.reshape(-1, self._columns) if self._columns else records

    def numbers(self, number: Any) -> Any:
        """The records on the device as a torch tensor, shape ``(n, numbers)``, same memory."""
        return self._wp.to_torch(self.rows.memory).view(number).view(len(self._here), -1)

    def keep(self, rows: Sequence[int]) -> None:
        """Copy rows to the waiting rows of the device."""
        rows = list(rows)
        self._move(self._here, self._staged, rows)
        self.rows.keep(rows, self._staged[rows])

    def fetch(self, target: np.ndarray) -> None:
        """Copy all rows back."""
        self._wp.copy(self._staged_bytes, self.rows.memory)
        self._wp.synchronize_device(self.rows.memory.device)
        self._move(self._staged, target.view(np.ndarray), slice(None))

    def _move(self, source: np.ndarray, target: np.ndarray, rows: Any) -> None:
        if self._same:
            target.view(np.uint8).reshape(len(target), -1)[rows] = source.view(np.uint8).reshape(
                len(source), -1
            )[rows]
            return
        for name in self.kind.names or ():
            target[name][rows] = source[name][rows]
