"""SOEM's master, through pysoem, for drives on a real segment.

>>> master = SoemMaster("eth0")
>>> axis = Master(EtherCatPort(master, {"x": "kollmorgen_akd"}, now=time.monotonic))

Its methods are those of `drive.ethercat.master.EtherCatMaster`, so that a program moves an emulated
drive in memory and a real one with the same calls.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from ..ethercat.al import AlState
from ..ethercat.esi_reader import EsiObject
from ..ethercat.port import SlaveSide
from ..objects.abort import SdoAbort
from .ethernet import raw_socket

TIMEOUT = 0.1  # s, for the reply to process data
ANSWER = 2e-3  # s, for the reply to any other frame, before SOEM reuses its index
STATE_TIMEOUT = 5_000_000  # µs
AGAIN = 2  # repetitions of a lost frame
TRIES = 200  # cycles until all are in OPERATIONAL
INPUTS = 0x0818  # register: start and length of sync manager 3
VISIBLE_STRING = 0x09
FLOATS = {0x08: "<f", 0x11: "<d"}  # data types of CiA 301


def check_access(interface: str) -> None:
    """Check, before anything slow, whether a `SoemMaster` can open an interface.

    Raises:
        ImportError: pysoem is not installed.
        ValueError: no such interface, or no permission for raw sockets; with the remedy.
    """
    _library()
    raw_socket(interface).close()


def _library() -> Any:
    """Return pysoem. Raises ImportError with the remedy."""
    try:
        import pysoem
    except ImportError:
        raise ImportError("pysoem is not installed: pip install pysoem") from None
    return pysoem


class SoemMailbox:
    """SDO transfers of one slave, with the exceptions of `mailbox_client.MailboxClient`."""

    def __init__(self, soem: Any, slave: Any):
        self._soem = soem
        self._slave = slave

    def upload(self, index: int, subindex: int = 0) -> bytes:
        """Read the bytes of an object. Raises SdoAbort, TimeoutError."""
        return self._tried(index, subindex, lambda: self._slave.sdo_read(index, subindex))

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object. Raises SdoAbort, TimeoutError."""
        self._tried(index, subindex, lambda: self._slave.sdo_write(index, subindex, bytes(data)))

    def _tried(self, index: int, subindex: int, action: Any) -> Any:
        try:
            for _ in range(AGAIN):  # SOEM waits 2 ms for an answer
                with suppress(self._soem.WkcError, self._soem.PacketError):
                    return action()
            return action()
        except self._soem.SdoError as error:
            raise SdoAbort(error.abort_code, index, subindex) from None
        except (self._soem.WkcError, self._soem.PacketError, self._soem.MailboxError) as error:
            raise TimeoutError(
                f"{index:04X}h:{subindex:02X}h: no answer ({type(error).__name__}); "
                "is the slave in PRE_OP or higher?"
            ) from None
        except Exception as error:  # from SOEM's error list, about an earlier telegram
            if not str(error).startswith("unexpected error"):
                raise
            raise TimeoutError(f"{index:04X}h:{subindex:02X}h: {error}") from None


class SoemSlave(SlaveSide):
    """A slave that SOEM has found."""

    def __init__(self, soem: Any, slave: Any, answer: int = round(1e6 * ANSWER)):
        self._soem = soem
        self._slave, self._answer = slave, answer  # µs
        self.emergencies: list[Any] = []  # without a callback, SOEM would raise them
        slave.add_emergency_callback(self.emergencies.append)
        self.mailbox = SoemMailbox(soem, slave)
        self.outputs = bytearray()
        self.inputs = b""
        self._buffer: tuple[int, int] | None = None  # start and length in the slave's memory

    @property
    def state(self) -> AlState:
        """State without the error bit; INIT if the slave does not answer."""
        for _ in range(AGAIN + 1):  # SOEM reports a lost answer as state 0
            self._slave.state_check(0, 0)
            if self._slave.state & 0x0F:
                break
        return AlState(self._slave.state & 0x0F or AlState.INIT)

    def request(self, state: int) -> None:
        """Request a state without waiting for it."""
        self._slave.state = state
        self._slave.write_state()

    def exchanged(self) -> None:
        """Store the inputs of the last cycle."""
        self.inputs = bytes(self._slave.input)

    def prepare(self) -> None:
        """Pass the outputs to the next cycle."""
        if self.outputs:
            self._slave.output = bytes(self.outputs)

    def sized(self) -> None:
        """Set the buffers to the sizes that SOEM has mapped."""
        self.outputs = bytearray(bytes(self._slave.output))
        self.inputs = bytes(self._slave.input)
        self._buffer = struct.unpack("<HH", self.read(INPUTS, 4))

    def read(self, address: int, size: int) -> bytes:
        """Read registers of the slave controller. Raises TimeoutError if it does not answer."""
        for _ in range(AGAIN + 1):
            if (data := self.fprd(address, size, self._answer)) is not None:
                return data
        raise TimeoutError(f"the slave does not answer at {address:04X}h")

    def read_inputs(self) -> bytes:
        """Read the input buffer. Raises TimeoutError if the slave does not answer."""
        start, length = self._buffer or (0, 0)
        return self.read(start, length) if length else b""

    def fprd(self, address: int, size: int, timeout: int) -> bytes | None:
        """Read registers; None if the slave does not answer within the timeout (µs)."""
        try:
            return bytes(self._slave._fprd(address, size, timeout))
        except self._soem.WkcError:
            return None

    def fpwr(self, address: int, data: bytes, timeout: int) -> bool:
        """Write registers; -> whether the slave has confirmed it within the timeout (µs)."""
        try:
            self._slave._fpwr(address, data, timeout)
        except self._soem.WkcError:
            return False
        return True

    def read_words(self, word: int) -> bytes:
        """Read 4 bytes of the EEPROM."""
        return self._slave.eeprom_read(word)[:4]

    def objects(self) -> "Iterator[EsiObject]":
        """Read the dictionary by SDO information, with values; nothing if it is not offered."""
        try:
            dictionary = self._slave.od
        except (self._soem.SdoInfoError, self._soem.WkcError, self._soem.PacketError):
            return
        for item in dictionary:
            name = _text(item.name)
            entries = [(n, entry) for n, entry in enumerate(item.entries) if entry.bit_length]
            kind = {7: "VAR", 8: "ARRAY", 9: "RECORD"}.get(item.object_code, "VAR")
            for subindex, entry in entries or [(0, item)]:
                bits = entry.bit_length
                data_type, access = entry.data_type, entry.obj_access
                readable, writable = access & 0x07, access & 0x38
                value = self._value(item.index, subindex, data_type) if readable else ""
                yield EsiObject(
                    item.index, subindex, _text(entry.name) or name, name, kind, data_type,
                    "rw" if readable and writable else "wo" if writable else "ro",
                    "R" * bool(access & 0x40) + "T" * bool(access & 0x80), value, "", "", bits,
                )

    def _value(self, index: int, subindex: int, data_type: int) -> str:
        try:
            data = self.mailbox.upload(index, subindex)
        except (SdoAbort, TimeoutError):
            return ""
        if data_type == VISIBLE_STRING:
            return _text(data)
        if len(data) == struct.calcsize(FLOATS.get(data_type, "0s")) > 0:
            return str(struct.unpack(FLOATS[data_type], data)[0])
        return str(int.from_bytes(data, "little")) if 0 < len(data) <= 8 else ""


def _text(data: bytes | str) -> str:
    text = data.decode("latin-1") if isinstance(data, bytes) else data
    return text.rstrip("\0")


class SoemMaster:
    """Commands the slaves at a network interface.

    Args:
        interface: name, such as ``eth0``; needs the permission for raw sockets.
        second: interface of the second port (redundancy).
        timeout: for the reply to process data (s). If it is longer than `TIMEOUT`, as for slaves
            that simulate before they answer, it applies to all frames, because after 16 frames
            SOEM would take a late reply for that of another frame.

    Raises:
        ImportError: pysoem is not installed.
        ConnectionError: the interface cannot be opened.
    """

    def __init__(self, interface: str, second: str | None = None, timeout: float = TIMEOUT):
        self._timeout = round(1e6 * timeout)  # µs
        self._answer = round(1e6 * ANSWER) if timeout <= TIMEOUT else self._timeout
        self._soem = pysoem = _library()
        pysoem.settings.timeouts.ret = self._answer  # applies to the whole process
        self._master = pysoem.Master()
        self.slaves: list[SoemSlave] = []
        self.wrong = 0  # cycles that were lost or had a wrong working counter
        self._under_way = False  # process data whose answer has not been received
        try:
            self._master.open(interface, *([second] if second else []))
        except ConnectionError as error:
            for name in (interface, second or interface):
                try:
                    raw_socket(name).close()
                except ValueError as why:
                    raise ConnectionError(f"{why}") from None
            raise ConnectionError(f"interface {interface}: {error}") from None

    def scan(self) -> list[SoemSlave]:
        """Find the slaves; they are in PRE_OPERATIONAL."""
        for _ in range(AGAIN + 1):  # a scan finds nothing if its first frame is lost
            if self._master.config_init() > 0:
                break
        self.slaves = [SoemSlave(self._soem, s, self._answer) for s in self._master.slaves]
        return self.slaves

    def to_preop(self) -> None:
        """Do nothing, because SOEM's scan does it."""

    def to_op(self, prepare: Callable[[], object] = lambda: None) -> None:
        """Map process data and go to OPERATIONAL. Raises RuntimeError if a slave refuses.

        Args:
            prepare: fills the outputs before they are first sent.
        """
        if all(slave.state == AlState.OPERATIONAL for slave in self.slaves):
            prepare()
            return
        self._master.config_map()
        reached = self._master.state_check(self._soem.SAFEOP_STATE, STATE_TIMEOUT)
        if reached != self._soem.SAFEOP_STATE:
            raise RuntimeError(f"SAFE_OP is not reached: {self._reasons()}")
        for slave in self.slaves:
            slave.sized()
        prepare()
        self.cycle()
        self._master.state = self._soem.OP_STATE
        self._master.write_state()
        self._reach_op()

    def recover(self) -> None:
        """Bring slaves back to OPERATIONAL after a watchdog error."""
        fallen = [s for s in self.slaves if s.state != AlState.OPERATIONAL]
        if not fallen:
            return
        for state in (self._soem.SAFEOP_STATE + self._soem.STATE_ACK, self._soem.OP_STATE):
            for slave in fallen:
                slave.request(state)
            self.cycle()
        self._reach_op()

    def _reach_op(self) -> None:
        """Exchange process data until all slaves are in OPERATIONAL."""
        for _ in range(TRIES):
            self.cycle()
            if self._master.state_check(self._soem.OP_STATE, 1000) == self._soem.OP_STATE:
                return
        raise RuntimeError(f"OP is not reached: {self._reasons()}")

    def _reasons(self) -> str:
        self._master.read_state()
        text = self._soem.al_status_code_to_string
        return "; ".join(f"{s.name}: {text(s.al_status)}" for s in self._master.slaves)

    def cycle(self) -> bool:
        """Exchange process data once; -> whether the working counter was right."""
        self.send_process_data()
        return self._receive()

    def send_process_data(self) -> None:
        """Send process data; the next call of a method here receives the answer."""
        self._receive()
        for slave in self.slaves:
            slave.prepare()
        self._master.send_processdata()
        self._under_way = True

    def _receive(self) -> bool:
        if not self._under_way:
            return True
        self._under_way = False
        right = self._master.receive_processdata(self._timeout) == self._master.expected_wkc
        self.wrong += not right
        if right:
            for slave in self.slaves:
                slave.exchanged()
        return right

    def look(self) -> bool:
        """Read the inputs only, slave by slave; -> whether all have answered.

        SOEM's only logical frame would carry outputs, so the input buffer of each slave (sync
        manager 3, 0818h) is read instead.
        """
        self._receive()
        right = True
        for slave in self.slaves:
            try:
                slave.inputs = slave.read_inputs()
            except TimeoutError:
                right = False
        self.wrong += not right
        return right

    def close(self) -> None:
        """Take the slaves to INIT and close the interface."""
        self._master.state = self._soem.INIT_STATE
        self._master.write_state()
        self._master.close()
