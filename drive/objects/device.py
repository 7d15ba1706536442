"""What the dictionary and its hooks need of a drive, and hooks of the dictionary: two Protocols.

`drive.Drive` is such a device and `dictionary.ObjectDictionary` such a dictionary; neither is known
here, so that what an object does can be written, read and tested without them.
"""

from collections.abc import Mapping
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
        """Store values that make the units."""

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
    synchronisation: Any  # what EtherCAT measures, by the names of hooks.ethercat; None without
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
        """Whether the state feeds the motor."""

    def reset(self) -> None:
        """Power on."""

    def snapshot(self) -> bytes:
        """Everything it is."""

    def restore(self, snapshot: bytes) -> None:
        """Become what `snapshot` was."""

    def image_changed(self) -> None:
        """Forget what was derived from the PDO mapping."""
