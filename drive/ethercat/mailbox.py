"""Mailbox: telegrams in sync managers 0 and 1 as whole buffers (ETG.1000.4, 5.6; ETG.1000.6, 5.6).

A header of six bytes precedes each body: length of the body, address, channel and priority, type
and counter. Every telegram is answered; one without a service gets a mailbox error.
"""

import struct
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from typing import ClassVar

HEADER = struct.Struct("<HHBB")
ERROR_BODY = struct.Struct("<HH")
ERROR_COMMAND = 1  # first word of an error body
QUEUE = 8  # telegrams waiting for the master, at which no further request is accepted
COUNTERS = 7  # 1..7; 0 marks a telegram without a counter


class Kind(IntEnum):
    """Type of a mailbox telegram: ETG.1000.4, table 29."""

    ERROR = 0
    AOE = 1
    EOE = 2
    COE = 3
    FOE = 4
    SOE = 5
    VOE = 15


class MailboxError(IntEnum):
    """Detail of a mailbox error: ETG.1000.4, table 30."""

    SYNTAX = 1
    UNSUPPORTED_PROTOCOL = 2
    INVALID_CHANNEL = 3
    SERVICE_NOT_SUPPORTED = 4
    INVALID_HEADER = 5
    SIZE_TOO_SHORT = 6
    NO_MEMORY = 7
    INVALID_SIZE = 8
    SERVICE_IN_WORK = 9


Answer = Iterable[bytes] | MailboxError
Service = Callable[[bytes, int], Answer]  # body, longest body of an answer (bytes)


def pack(kind: int, body: bytes, counter: int = 0, address: int = 0, channel: int = 0) -> bytes:
    """Pack a telegram."""
    return HEADER.pack(len(body), address, channel, kind | counter << 4) + body


class Mailbox:
    """Receives telegrams and sends answers in order.

    `services` take the body of a request and the longest body of an answer (`size`, bytes), and
    return the bodies of the answers, or an error.
    """

    KEPT: ClassVar = ("size", "_waiting", "_counter", "_request", "_sent")  # in a snapshot

    def __init__(self, services: Mapping[int, Service]):
        self.services = services
        self.size = 0
        self.reset()

    def reset(self) -> None:
        """Empty the mailbox, as after INIT."""
        self._waiting: list[tuple[int, bytes, int, int]] = []
        self._counter = 0  # of the last telegram sent
        self._request = b""  # the last one with a counter, until its answer has been fetched
        self._sent = b""  # the last telegram sent

    @property
    def ready(self) -> bool:
        """Whether there is room for the answer to one more request."""
        return len(self._waiting) < QUEUE

    def receive(self, buffer: bytes) -> None:
        """Process a buffer of sync manager 0.

        A telegram with the same counter that is repeated before the answer was fetched comes from
        the master's link layer and is not served twice.
        """
        if len(buffer) < HEADER.size:
            self._refuse(MailboxError.INVALID_SIZE, 0, 0)
            return
        length, address, channel, kind = HEADER.unpack_from(buffer)
        body = buffer[HEADER.size : HEADER.size + length]
        if kind >> 4 & 7:
            if self._request == buffer:
                return
            self._request = buffer
        if len(body) < length:
            answer: Answer = MailboxError.INVALID_SIZE
        elif not body:
            answer = MailboxError.SIZE_TOO_SHORT
        elif service := self.services.get(kind & 0x0F):
            answer = service(body, self.size)
        else:
            answer = MailboxError.UNSUPPORTED_PROTOCOL
        if isinstance(answer, MailboxError):
            self._refuse(answer, address, channel)
        else:
            for reply in answer:
                self._waiting.append((kind & 0x0F, reply, address, channel))

    def _refuse(self, error: MailboxError, address: int, channel: int) -> None:
        body = ERROR_BODY.pack(ERROR_COMMAND, error)
        self._waiting.append((int(Kind.ERROR), body, address, channel))

    def post(self, kind: Kind, body: bytes) -> None:
        """Queue an unsolicited telegram, such as an emergency."""
        self._waiting.append((int(kind), body, 0, 0))

    def next(self) -> bytes:
        """The next telegram for sync manager 1, empty if there is none; `sent` removes it."""
        if not self._waiting:
            return b""
        kind, body, address, channel = self._waiting[0]
        return pack(kind, body, self._counter % COUNTERS + 1, address, channel)

    def sent(self) -> None:
        """Note that the telegram of `next` is in the buffer of sync manager 1."""
        self._sent = self.next()
        self._waiting.pop(0)
        self._counter = self._counter % COUNTERS + 1

    def fetched(self) -> None:
        """Note that the master has read sync manager 1."""
        if not self._waiting:
            self._request = b""

    def again(self) -> bytes:
        """The last telegram, for a repeat request (080Eh bit 1); empty if there was none."""
        return self._sent
