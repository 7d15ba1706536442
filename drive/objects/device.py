"""What the dictionary and its hooks need of a drive, and hooks of the dictionary: two Protocols.

`drive.Drive` is such a device and `dictionary.ObjectDictionary` such a dictionary; neither is known
here, so that what an object does can be written, read and tested without them.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from ..kernel.record import Axis
from ..model.model import DriveModel
from ..model.rows import Object
from .abort import Abort


class Place(Protocol):
    """An object and where its bytes are, as `slots.Slot`."""

    row: Object
    offset: int

    def get(self) -> int | float | str:
        """The value as it stands."""

    def put(self, value: int | float) -> None:
        """Store a checked value."""


class ParameterSets(Protocol):
    """Factory defaults and stored values, as `parameters.Parameters`."""

    def save(self) -> bool:
        """What 1010h does; False if it failed."""

    def forget(self) -> bool:
        """What 1011h does; False if it failed."""

    def load_defaults(self) -> None:
        """What 1011h does in models where it acts at once."""


class Dictionary(Protocol):
    """The objects of a device."""

    drive: "Device"
    results: dict[int, bytes]
    texts: dict[tuple[int, int], bytes]

    @property
    def slots(self) -> Mapping[tuple[int, int], Any]:
        """Places by index and sub-index."""

    @property
    def names(self) -> Mapping[str, Any]:
        """Places by name."""

    def put(self, slot: Any, value: int | float) -> None:
        """Store a checked value."""

    def put_factors(self, values: Any) -> None:
        """Store values that make the units."""

    def find(self, index: int, subindex: int) -> tuple[Any, Abort]:
        """The place of an object, or why there is none."""

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
        """Its `ParameterSets`."""

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
