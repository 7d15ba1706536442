"""Oscilloscope: channels of a drive by object name or record field, one sample a position cycle.

>>> trace = Trace(drive, ["position_actual_value", "axis.torque"])     # doctest: +SKIP
>>> trace = Trace(drive, ["statusword"], trigger=Trigger("statusword", Edge.CHANGE), before=100)

A channel is an object by name (drive units), or ``axis.`` and a field of the record (SI units).
Without a trigger all samples are kept, or the last `depth`. With one, `before` samples ahead of the
event and `depth` in all are kept; then `done` is True and further samples are ignored. A node on a
bus and a log fill a `Recording` in the same way (`servogym.drive.wire.recording`).
"""

import csv
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from .drive import Drive
from .kernel.record import OD, UNITS


class Edge(IntEnum):
    """Event that a trigger waits for."""

    RISING = 0  # from below the level to the level or above
    FALLING = 1
    ABOVE = 2  # the level or above
    CHANGE = 3  # any change of value, as of a state


@dataclass(frozen=True)
class Trigger:
    """An event on a channel; `level` in the channel's unit."""

    channel: str
    edge: Edge
    level: float = 0.0


class Watch:
    """Detects the event of a trigger, sample by sample."""

    def __init__(self, trigger: Trigger):
        self._edge, self._level = trigger.edge, trigger.level
        self._last: float | None = None

    def event(self, value: float) -> bool:
        """Whether the event occurs with this sample; nan stands for an unknown value."""
        if math.isnan(value):
            return False
        last, self._last = self._last, value
        if self._edge == Edge.ABOVE:
            return value >= self._level
        if last is None:
            return False
        if self._edge == Edge.RISING:
            return last < self._level <= value
        if self._edge == Edge.FALLING:
            return last > self._level >= value
        return value != last


class Recording:
    """Samples of channels around a trigger, row by row, from any source.

    Args:
        units: units of the channels by name.
        depth: number of samples to keep; all by default.
        trigger: event to wait for.
        before: samples that are kept ahead of it.

    Raises:
        ValueError: a depth below 1, a trigger without ``depth > before >= 0``.
    """

    def __init__(
        self, units: Mapping[str, str], *, depth: int | None = None, trigger: Trigger | None = None,
        before: int = 0,
    ):
        self.channels = tuple(units)
        self.units = {"time": "s"} | dict(units)
        self.trigger = trigger
        self._watch = Watch(trigger) if trigger else None
        if depth is not None and depth < 1:
            raise ValueError(f"depth = {depth} samples is out of range 1..")
        if trigger is not None and (depth is None or not 0 <= before < depth):
            raise ValueError(f"a trigger needs depth > before >= 0, not {depth} and {before}")
        self._depth = depth
        self._rows: deque[tuple] = deque(maxlen=before if trigger else depth)
        self.triggered = trigger is None
        self.trigger_time: float | None = None  # s
        self.done = False

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, time: float, values: Iterable[float], watched: float = math.nan) -> None:
        """Add a row at `time` (s); `watched` is the trigger's channel, nan if it is unknown."""
        if self.done:
            return
        if self._watch is not None and not self.triggered:
            self.triggered = self._watch.event(watched)
            if self.triggered:
                self._rows, self.trigger_time = deque(self._rows), time
        self._rows.append((time, *values))
        if self.trigger is not None and self.triggered and len(self._rows) >= (self._depth or 0):
            self.done = True

    def arrays(self) -> dict[str, np.ndarray]:
        """Columns by name, ``time`` first, each of shape ``(samples,)``."""
        columns = zip(*self._rows, strict=True) if self._rows else [()] * (len(self.channels) + 1)
        return {
            name: np.array(column)
            for name, column in zip(("time", *self.channels), columns, strict=True)
        }

    def save(self, path: str | Path) -> None:
        """Write the samples; the suffix chooses the format: .csv, .npz or .parquet.

        Raises:
            ValueError: another suffix.
            ImportError: .parquet without the package pyarrow.
        """
        path = Path(path)
        if path.suffix not in _WRITERS:
            raise ValueError(f"{path}: use one of the suffixes {', '.join(_WRITERS)}")
        _WRITERS[path.suffix](path, self)


class Trace(Recording):
    """Samples of channels of one drive. Raises ValueError for an unknown channel."""

    def __init__(
        self, drive: Drive, channels: Iterable[str], *, depth: int | None = None,
        trigger: Trigger | None = None, before: int = 0,
    ):
        names = tuple(dict.fromkeys(channels))
        self._readers = [reader(drive, name) for name in names]
        self._watched = reader(drive, trigger.channel) if trigger else None
        units = {name: unit_of(drive, name) for name in names}
        super().__init__(units, depth=depth, trigger=trigger, before=before)

    def sample(self, time: float) -> None:
        """Take one sample at `time` (s)."""
        if not self.done:
            watched = self._watched() if self._watched and not self.triggered else math.nan
            self.add(time, [read() for read in self._readers], watched)


def reader(drive: Drive, name: str) -> Callable[[], float]:
    """A function that reads a channel. Raises ValueError for an unknown one."""
    if name.startswith("axis."):
        field = name.removeprefix("axis.")
        fields: Any = drive.axes.dtype.fields
        if field in fields and field != "od" and not fields[field][0].shape:
            view = np.asarray(drive.axes)[field]
            return lambda: view[drive.index].item()
    elif name in drive.objects.names:
        return drive.objects.names[name].get  # type: ignore[return-value]
    elif name in (OD.names or ()) and not OD[name].shape:
        column = np.asarray(drive.axes)["od"][name]  # the model has no object for it
        return lambda: column[drive.index].item()
    raise ValueError(
        f"there is no channel {name!r}: name an object such as position_actual_value, "
        "or a field of the record such as axis.torque"
    )


def unit_of(drive: Drive, name: str) -> str:
    """The unit of a channel."""
    if name.startswith("axis."):
        return UNITS[name.removeprefix("axis.")]
    if name in drive.objects.names:
        return drive.objects.names[name].row.unit
    return UNITS[f"od.{name}"]


def _write_csv(path: Path, trace: Recording) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{n} ({u})" if u else n for n, u in trace.units.items()])
        writer.writerows(trace._rows)


def _write_npz(path: Path, trace: Recording) -> None:
    np.savez_compressed(path, **trace.arrays())  # type: ignore[arg-type]


def _write_parquet(path: Path, trace: Recording) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ImportError("parquet needs pyarrow: pip install pyarrow") from None
    pyarrow.parquet.write_table(pyarrow.table(trace.arrays()), path)


_WRITERS = {".csv": _write_csv, ".npz": _write_npz, ".parquet": _write_parquet}
