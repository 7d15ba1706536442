"""Slots: the objects of a drive and the places of their bytes.

All drives of a model share a pattern of each slot; a slot of a drive adds a view of its memory.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ..model.rows import Object
from .abort import Abort
from .hooks import Hook


class Slot:
    """An object and the place of its bytes; without a `view`, a pattern for all drives."""

    __slots__ = ("code", "hook", "kept", "offset", "raw", "reads", "row", "view", "writable")

    def __init__(
        self, row: Object, view: memoryview | None, rule: Callable[..., Abort] | None = None,
        kept: int | None = None, read_rule: Callable[..., Any] | None = None,
        hook: Hook | None = None,
    ):
        self.row = row
        self.view = view
        self.offset = row.offset
        self.code = row.code
        self.writable = row.access not in ("ro", "const")
        self.reads = hook.read if hook else read_rule
        self.hook = (hook and hook.write) or rule
        self.raw = hook and hook.raw
        self.kept = kept  # `kept.place`

    def of(self, views: Mapping[str, memoryview | None]) -> "Slot":
        """Return the slot in the memory of one drive; `views` are its areas."""
        slot = Slot.__new__(Slot)
        slot.row, slot.offset, slot.code, slot.writable = (
            self.row, self.offset, self.code, self.writable
        )
        slot.reads, slot.hook, slot.raw, slot.kept = self.reads, self.hook, self.raw, self.kept
        slot.view = views[self.row.area]
        return slot

    def get(self) -> int | float | str:
        """The stored value."""
        if self.view is None:
            return self.row.default
        value = self.row.held.unpack_from(self.view, self.offset)[0]
        return self.row.shown(value) if self.row.stored else value

    def put(self, value: int | float) -> None:
        """Store a checked value."""
        assert self.view is not None
        self.row.held.pack_into(self.view, self.offset, value)

    @property
    def accepts(self) -> str:
        """Description of the values that a master may write."""
        row = self.row
        if row.possible or row.allowed is not None:
            return f"{row.name} may be one of {sorted(row.possible or row.allowed or ())}"
        if row.format and row.access == "rw":
            limits = f"{row.minimum:.0f}..{row.maximum:.0f}"
            return f"{row.name} {row.data_type} {limits} {row.unit}".strip()
        return row.name


class Slots(Mapping[tuple[int, int], Slot]):
    """The slots of one drive by address; those requested singly are cached."""

    def __init__(self, shared: dict[tuple[int, int], Slot], views: Mapping[str, memoryview | None]):
        self._shared = shared
        self._views = views
        self._made: dict[tuple[int, int], Slot] = {}

    def get(self, address: tuple[int, int], default: Any = None) -> Any:
        """The slot of an address, `default` if there is none."""
        slot = self._made.get(address)
        if slot is None:
            pattern = self._shared.get(address)
            if pattern is None:
                return default
            slot = self._made[address] = pattern.of(self._views)
        return slot

    def once(self, address: tuple[int, int]) -> Slot | None:
        """The slot of an address, if there is one, for a single use; it is not cached."""
        pattern = self._shared.get(address)
        return pattern and pattern.of(self._views)

    def __getitem__(self, address: tuple[int, int]) -> Slot:
        slot = self.get(address)
        if slot is None:
            raise KeyError(address)
        return slot

    def __contains__(self, address: object) -> bool:
        return address in self._shared

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self._shared)

    def __len__(self) -> int:
        return len(self._shared)

    def items(self) -> Any:
        """Addresses and slots, for one pass."""
        return ((address, slot.of(self._views)) for address, slot in self._shared.items())

    def values(self) -> Any:
        """Slots, for one pass."""
        return (slot.of(self._views) for slot in self._shared.values())

    def within(self, area: str) -> Any:
        """Slots of one area, for one pass."""
        return (slot.of(self._views) for slot in self._shared.values() if slot.row.area == area)


class Names(Mapping[str, Slot]):
    """The slots of one drive by name."""

    def __init__(self, shared: dict[str, tuple[int, int]], slots: Slots):
        self._shared = shared
        self._slots = slots

    def __getitem__(self, name: str) -> Slot:
        return self._slots[self._shared[name]]

    def __contains__(self, name: object) -> bool:
        return name in self._shared

    def __iter__(self) -> Iterator[str]:
        return iter(self._shared)

    def __len__(self) -> int:
        return len(self._shared)
