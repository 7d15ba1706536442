"""EMCY: emergency messages, error register 1001h and history 1003h (CiA 301, emergency object).

There are two kinds of errors. The control cycle enters faults of the drive in 1001h and 1003h.
Communication errors are *conditions* that the services of the node report and clear; this module
enters them, and sets bit 4 of the error register while one is present. Each event is sent once,
even if a master clears the history in the meantime. When a bit of the register is cleared, an EMCY
with the code 0 is sent.
"""

import struct
from collections import deque
from collections.abc import Callable, Hashable
from enum import IntEnum

from ..drive import Drive
from ..kernel.faults import Cause, Reaction
from ..kernel.record import HISTORY
from .frame import Base

COMMUNICATION = 0x11  # error register: generic and communication
_FRAME = struct.Struct("<HB3xH")


class ErrorCode(IntEnum):
    """Emergency error codes of CiA 301 for communication."""

    NONE = 0x0000
    CONNECTION = 0x8130  # life guard error or heartbeat error
    PDO_TOO_SHORT = 0x8210  # PDO not processed due to length error
    PDO_TOO_LONG = 0x8220  # PDO length exceeded
    SYNC_LENGTH = 0x8240  # unexpected SYNC data length
    RPDO_TIMEOUT = 0x8250


class Emergency:
    """The EMCY producer of a node; `send` takes identifier and data of each message."""

    def __init__(self, drive: Drive, send: Callable[[int, bytes], None]):
        self._drive = drive
        self._send = send
        self._present: set[tuple[ErrorCode, Hashable]] = set()
        own = slice(drive.index, drive.index + 1)
        self._events = drive.axes["error_events"][own]
        self._register = drive.axes["od"]["error_register"][own]

    def configure(self) -> None:
        """Read 1014h and 1015h; a model without 1014h has the default identifier."""
        default = Base.EMCY + self._drive.node_id
        cob_id = self._drive.objects.value(0x1014, default=default)
        self._valid = not cob_id & 0x8000_0000
        self._identifier = cob_id & 0x7FF
        self._inhibit = self._drive.objects.value(0x1015) * 100

    def reset(self) -> None:
        """Regard all earlier events as sent, and no condition as present."""
        for code, source in [*self._present]:
            self.clear(code, source)
        self._queued = self._events.item(0)  # number of events that are queued or sent
        self._reported = self._register.item(0)  # error register in the last EMCY
        self._sent_at = -(1 << 62)
        # code, cause, error register
        self._queue: deque[tuple[int, int, int]] = deque(maxlen=HISTORY)

    def report(self, code: ErrorCode, source: Hashable, cause: Cause = Cause.NONE) -> None:
        """Report a communication error, which is present until `clear`.

        The error is entered in the history here, unless the control cycle will do so because
        `cause` is a fault or a warning of the drive.
        """
        silent = self._drive.model.quirk("only_faults_are_told")
        if silent and cause is Cause.CONNECTION and not self._drive_reports(cause):
            return
        if (code, source) in self._present:
            return
        first = all(code != other for other, _ in self._present)
        self._present.add((code, source))
        if cause and first and self._drive_reports(cause):
            return
        axis, od = self._drive.axis, self._drive.axis.od
        place = axis.error_events % HISTORY
        axis.event_code[place], axis.event_cause[place] = int(code), Cause.NONE
        axis.error_events += 1
        od.error_field[1:] = od.error_field[:-1]
        od.error_field[0] = od.error_code = int(code)
        od.error_count = min(int(od.error_count) + 1, int(axis.history_depth) or HISTORY)
        od.error_register |= COMMUNICATION

    def _drive_reports(self, cause: Cause) -> bool:
        axis = self._drive.axis
        if cause is Cause.CONNECTION and axis.od.abort_connection_option_code != 1:
            return False
        reaction = axis.od.fault_reaction[cause]
        known = axis.warnings if reaction == Reaction.WARNING else axis.faults
        return reaction != Reaction.IGNORE and not int(known) >> cause & 1

    def clear(self, code: ErrorCode, source: Hashable) -> None:
        """Clear a communication error; the last one also clears bit 4 of the error register."""
        if (code, source) not in self._present:
            return
        self._present.remove((code, source))
        if not self._present:
            axis = self._drive.axis
            register = 0
            for cause in Cause:
                if int(axis.faults | axis.warnings) >> cause & 1:
                    register |= int(axis.fault_register[cause])
            axis.od.error_register = register

    def poll(self, time: int) -> None:
        """Send new errors at `time` (µs), no faster than the inhibit time 1015h allows."""
        events, register = self._events.item(0), self._register.item(0)
        if events == self._queued and register == self._reported and not self._queue:
            return
        if self._present and register & COMMUNICATION != COMMUNICATION:
            register |= COMMUNICATION  # a fault reset of the drive has cleared it
            self._register[0] = register
        entered = self._drive.errors_since(self._queued)
        self._queue.extend((code, cause, register) for code, cause in entered)
        self._queued = events
        if time - self._sent_at < self._inhibit:
            return
        if self._queue:
            code, cause, self._reported = self._queue.popleft()
        elif self._reported & ~register:
            code, cause, self._reported = ErrorCode.NONE, Cause.NONE, register
        else:
            self._reported = register
            return
        self._sent_at = time
        if self._valid:
            internal = self._internal(code, cause)
            self._send(self._identifier, _FRAME.pack(code, self._reported, internal))

    def _internal(self, code: int, cause: int) -> int:
        """The manufacturer's fault number for bytes 6 and 7; 0 in models that do not send it."""
        model = self._drive.model
        if not code or not model.quirk("emcy_internal_code"):
            return 0
        return model.fault_key(code, cause, int(self._drive.axis.lost_node))
