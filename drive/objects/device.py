"""Protocols: what dictionary and hooks need of a drive, and hooks of the dictionary.

`drive.Drive` is a `Device` and `dictionary.ObjectDictionary` a `Dictionary`. Hooks depend only on
the protocols, so they can be written and tested without the classes.
"""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from ..kernel.record import Axis
from ..model.model import DriveModel
from .abort import Abort


class Dictionary(Protocol):
    """The objects of a device."""

    drive: "Device"
    results: dict[int, bytes]
    texts: dict[tuple[int, int], bytes]

    @property
    def slots(self) -> Mapping[tuple[int, int], Any]:
        """Each `slots.Slot` by index and sub-index."""

    @property
    def names(self) -> Mapping[str, Any]:
        """Each `slots.Slot` by name."""

    def put(self, slot: Any, value: int | float) -> None:
        """Store a checked value."""

    def put_factors(self, values: Any) -> None:
        """Store values that define the units."""

    def find(self, index: int, subindex: int) -> tuple[Any, Abort]:
        """The slot of an object, or why there is none."""

    def read(self, index: int, subindex: int) -> tuple[bytes, Abort]:
        """SDO upload."""

    def write(self, index: int, subindex: int, data: bytes) -> Abort:
        """SDO download."""


class Device(Protocol):
    """A drive: its record, PDOs, objects and parameter sets."""

    model: DriveModel
    axis: Axis
    axes: np.ndarray
    index: int
    node_id: int
    operational: bool
    synchronisation: Callable[[], Mapping[int, int]]  # values of 1C32h and 1C33h by sub-index
    communication_version: int
    wanted_node_id: int | None
    rpdos: np.ndarray
    tpdos: np.ndarray

    @property
    def objects(self) -> Any:
        """Its `Dictionary`."""

    @property
    def parameters(self) -> Any:
        """Its `parameters.Parameters`."""

    @property
    def energised(self) -> bool:
        """Whether the motor has power in the present state."""

    def reset(self) -> None:
        """Switch the drive on."""

    def snapshot(self) -> bytes:
        """Return the complete state."""

    def restore(self, snapshot: bytes) -> None:
        """Restore the state of a snapshot."""

    def image_changed(self) -> None:
        """Discard everything derived from the PDO mapping."""
