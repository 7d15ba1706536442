"""The EtherCAT face of a drive: AL states, CoE mailbox and process data, in memory.

No network: whoever owns the slave moves the bytes and lets the drive's cycles pass, so a network
side can be put under it. Source: Kollmorgen AKD EtherCAT communication, 5.1-5.6 and 5.13.
"""

import struct
from enum import IntEnum

from .abort import Abort
from .drive import Drive


class AlState(IntEnum):
    """States of AL Control and AL Status, bits 3-0 (5.3.1)."""

    INIT = 1
    PRE_OPERATIONAL = 2
    BOOTSTRAP = 3
    SAFE_OPERATIONAL = 4
    OPERATIONAL = 8


class AlStatusCode(IntEnum):
    """Codes of AL Status Code 0134h; the drive knows no others (5.3.3)."""

    NO_ERROR = 0x0000
    INVALID_STATE_CHANGE = 0x0011
    INVALID_SYNC_MANAGER = 0x0017


_I, _P, _B, _S, _O = AlState
TRANSITIONS = {
    (_I, _B),
    (_B, _I),
    (_I, _P),
    (_P, _I),
    (_P, _S),
    (_S, _P),
    (_S, _I),
    (_S, _O),
    (_O, _S),
    (_O, _P),
    (_O, _I),
}  # 5.3.4; none other leaves bootstrap (inferred)
# transition -> sync managers whose start address and length are checked
CHECKED = {(_I, _P): (0, 1), (_P, _S): (2, 3)}
WITH_MAILBOX = (_P, _S, _O)
ERROR, ACKNOWLEDGE = 0x10, 0x10  # bit 4 of AL Status and of AL Control
MAILBOX = 512  # bytes of each buffer
START = (0x1800, 0x1C00, 0x1100, 0x1140)  # start addresses of the sync managers (5.1)

FRAME = struct.Struct("<HHBBHBHB4s")  # the 16 bytes of 5.13.1
COE = 3
SDO_REQUEST, SDO_RESPONSE = 2, 3
LENGTH = 10  # bytes from the CoE header on; the manual's reply example prints 14
READ, READ_OK, WRITTEN, ABORTED = 0x40, 0x43, 0x60, 0x80
WRITE = {0x2F: 1, 0x2B: 2, 0x27: 3, 0x23: 4}  # command -> bytes


class Slave:
    """A drive on an EtherCAT segment.

    Args:
        drive: the drive; its model has to be one for this bus.

    Raises:
        ValueError: the model is for another bus.
    """

    def __init__(self, drive: Drive):
        if drive.model.bus != "ethercat":
            raise ValueError(
                f"drive {drive.model.name!r} is for {drive.model.bus}: "
                'choose a model with bus = "ethercat", see `servogym drives`'
            )
        self.drive = drive
        self.state = AlState.INIT
        self.status_code = AlStatusCode.NO_ERROR
        self._acknowledge = 0  # bit 4 of the last AL Control
        self.sync_managers = [(0, 0)] * 4  # start address and length, written by the master

    @property
    def al_status(self) -> int:
        """Register 0130h: the state, bit 4 while an error is not acknowledged."""
        return self.state | (ERROR if self.status_code else 0)

    def al_control(self, value: int) -> None:
        """Register 0120h: request a state; bit 4 acknowledges an error."""
        edge = value & ACKNOWLEDGE and not self._acknowledge
        self._acknowledge = value & ACKNOWLEDGE
        if self.status_code and not edge:
            return
        self.status_code = AlStatusCode.NO_ERROR
        wanted = value & 0x0F
        if wanted == self.state:
            return
        if (self.state, wanted) not in TRANSITIONS:
            self.status_code = AlStatusCode.INVALID_STATE_CHANGE
            return
        step = (self.state, AlState(wanted))
        for number in CHECKED.get(step, ()):
            if self.sync_managers[number] != (START[number], self._length(number)):
                self.status_code = AlStatusCode.INVALID_SYNC_MANAGER
                return
        self.state = AlState(wanted)

    def _length(self, number: int) -> int:
        return (MAILBOX, MAILBOX, self.drive.rpdo_size, self.drive.tpdo_size)[number]

    def configure(self) -> None:
        """Write the sync managers as a master does that has read the description file."""
        self.sync_managers = [(START[n], self._length(n)) for n in range(4)]

    # -------------------------------------------------------------- mailbox

    def mailbox(self, request: bytes) -> bytes:
        """The 16-byte answer to a 16-byte CoE telegram, nothing where there is no mailbox.

        What is no SDO request is not answered (inferred).
        """
        if self.state not in WITH_MAILBOX or len(request) != FRAME.size:
            return b""
        _, address, channel, kind, coe, command, index, subindex, data = FRAME.unpack(request)
        if kind & 0x0F != COE or coe >> 12 != SDO_REQUEST:
            return b""
        reply, data = self._sdo(command, index, subindex, data)
        return FRAME.pack(
            LENGTH, address, channel, kind, SDO_RESPONSE << 12, reply, index, subindex, data
        )

    def _sdo(self, command: int, index: int, subindex: int, data: bytes) -> tuple[int, bytes]:
        objects = self.drive.objects
        value, abort = b"", Abort.COMMAND_SPECIFIER
        if command == READ:
            value, abort = objects.read(index, subindex)
            if len(value) > 4:
                abort = Abort.UNSUPPORTED_ACCESS  # no segmented transfer (inferred)
        elif command in WRITE:
            abort = objects.write(index, subindex, data[: WRITE[command]])
        if abort:
            return ABORTED, struct.pack("<I", abort)
        if command == READ:
            return READ_OK | (4 - len(value)) << 2, value.ljust(4, b"\0")
        return WRITTEN, bytes(4)

    # --------------------------------------------------------- process data

    def outputs(self, image: bytes) -> bool:
        """Take the set-points of one frame (sync manager 2); False where they are not used."""
        if self.state != AlState.OPERATIONAL or len(image) != self.drive.rpdo_size:
            return False
        self.drive.latch(image)
        return True

    def inputs(self) -> bytes:
        """The actual values (sync manager 3), nothing below SAFE_OPERATIONAL."""
        if self.state not in (AlState.SAFE_OPERATIONAL, AlState.OPERATIONAL):
            return b""
        return self.drive.collect()
