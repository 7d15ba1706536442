"""The process data interface (PDI): the drive's access to its slave controller."""

from typing import NamedTuple

import numpy as np

from .record import Event
from .registers import FULL, READ, REPEAT, WRITTEN, R

OUT, IN = 0, 1  # sync managers of the mailbox


class SyncManager(NamedTuple):
    """The present registers of one sync manager."""

    start: int
    length: int
    control: int
    status: int
    activate: int
    pdi: int

    @property
    def enabled(self) -> bool:
        """Whether the master has enabled it."""
        return bool(self.activate & 1)


class Pdi:
    """Registers, mailboxes and events of one slave, as seen from its services.

    Args:
        escs: the ESC records of the segment.
        index: the slave's record.
    """

    def __init__(self, escs: np.ndarray, index: int):
        self._escs = escs
        self._index = index
        self.memory: np.ndarray = escs["memory"][index]

    def get(self, address: int, size: int) -> int:
        """Read a register of `size` bytes."""
        return int.from_bytes(self.memory[address : address + size].tobytes(), "little")

    def set(self, address: int, size: int, value: int) -> None:
        """Write a register of `size` bytes."""
        self.memory[address : address + size] = list(value.to_bytes(size, "little"))

    # ----------------------------------------------------------- AL registers

    def al_control(self) -> int:
        """Read 0120h; the master may then write it again."""
        self.memory[R.AL_EVENT] &= 0xFE
        return self.get(R.AL_CONTROL, 2)

    def al_status(self, status: int, code: int = 0) -> None:
        """Write 0130h (bit 4 = error) and 0134h."""
        if status != self.get(R.AL_STATUS, 2):
            self.memory[R.ECAT_EVENT] |= 1 << 3
        self.set(R.AL_STATUS, 2, status)
        self.set(R.AL_STATUS_CODE, 2, code)

    @property
    def alias(self) -> int:
        """Configured station alias 0012h."""
        return self.get(R.STATION_ALIAS, 2)

    @property
    def sii(self) -> bytes:
        """The present content of the EEPROM."""
        record = self._escs[self._index]
        return bytes(record["sii"][: int(record["sii_size"])])

    # ---------------------------------------------------------- sync managers

    def sync_manager(self, n: int) -> SyncManager:
        """Configuration of sync manager `n`."""
        at = R.SYNC_MANAGER + 8 * n
        raw = self.memory[at : at + 8].tolist()
        return SyncManager(raw[0] | raw[1] << 8, raw[2] | raw[3] << 8, *raw[4:])

    def _status(self, n: int) -> int:
        return R.SYNC_MANAGER + 8 * n + 5

    # ---------------------------------------------------------------- mailbox

    def mailbox_take(self) -> bytes:
        """Read and empty the buffer of SM0; b"" if it is empty."""
        if not self.memory[self._status(OUT)] & FULL:
            return b""
        manager = self.sync_manager(OUT)
        self.memory[self._status(OUT)] &= 0xFF ^ (FULL | WRITTEN)
        self.memory[R.AL_EVENT + 1] &= 0xFF ^ 1 << OUT
        return self.memory[manager.start : manager.start + manager.length].tobytes()

    @property
    def mailbox_waiting(self) -> bool:
        """Whether SM1 holds a telegram that the master has not read."""
        return bool(self.memory[self._status(IN)] & FULL)

    def mailbox_put(self, data: bytes) -> bool:
        """Fill SM1; False if it is off or still full, and the caller has to keep the data."""
        record = self._escs[self._index]
        if self.mailbox_waiting or not record["sm_length"][IN]:
            return False
        self._fill(data)
        return True

    def _fill(self, data: bytes) -> None:
        manager = self.sync_manager(IN)
        whole = data[: manager.length].ljust(manager.length, b"\0")
        self.memory[manager.start : manager.start + manager.length] = np.frombuffer(whole, np.uint8)
        status = self._status(IN)
        self.memory[status] = int(self.memory[status]) & ~READ | FULL
        self.memory[R.AL_EVENT + 1] &= 0xFF ^ 1 << IN

    @property
    def repeat(self) -> bool:
        """Whether the master requests the last mailbox again: bit 1 of 080Eh and 080Fh differs."""
        manager = self.sync_manager(IN)
        return bool((manager.activate ^ manager.pdi) & REPEAT)

    def mailbox_repeat(self, data: bytes) -> None:
        """Replace the content of SM1 by `data` (unless empty) and acknowledge the request."""
        if data:
            self._fill(data)
        manager = self.sync_manager(IN)
        at = R.SYNC_MANAGER + 8 * IN + 7
        self.memory[at] = manager.pdi & ~REPEAT | manager.activate & REPEAT

    def mailboxes_reset(self) -> None:
        """Empty both mailboxes."""
        for n in (OUT, IN):
            self.memory[self._status(n)] &= 0xFF ^ (FULL | WRITTEN | READ)
        self.memory[R.AL_EVENT + 1] &= 0xFC

    def take_events(self) -> int:
        """Return and clear the `Event` bits, except PROCESS_DATA."""
        record = self._escs[self._index]
        events = int(record["events"]) & ~Event.PROCESS_DATA
        record["events"] = int(record["events"]) & Event.PROCESS_DATA
        return events
