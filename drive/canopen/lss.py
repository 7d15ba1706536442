"""LSS slave: node-id and bit rate over the bus (CiA 305).

A slave waits until a master selects it, by switching all slaves or by the identity 1018h. A new
node-id becomes active at the next NMT reset communication; a slave without a node-id (255) adopts
it as soon as it is switched back to the waiting state.
"""

import struct
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

UNCONFIGURED = 255  # node-id of a slave that has none
BIT_RATES = {  # bit timing table 0 -> bit/s; 5 and 9 (automatic) are not supported
    0: 1_000_000, 1: 800_000, 2: 500_000, 3: 250_000, 4: 125_000, 6: 50_000, 7: 20_000, 8: 10_000,
}
CONFIRM = 0x80  # "bit checked" of a Fastscan that asks for any unconfigured slave


class LssState(IntEnum):
    """CiA 305, LSS state machine."""

    WAITING = 0
    CONFIGURATION = 1


class Command(IntEnum):
    """Command specifiers (CiA 305).

    SWITCH_SELECTIVE, IDENTIFY_REMOTE and INQUIRE_IDENTITY are the first of several, one for each
    field of the identity.
    """

    SWITCH_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE = 0x17
    SWITCH_SELECTIVE = 0x40
    SELECTED = 0x44
    IDENTIFY_REMOTE = 0x46
    IDENTIFY_NON_CONFIGURED = 0x4C
    IDENTIFIED = 0x4F
    NON_CONFIGURED = 0x50
    FASTSCAN = 0x51
    INQUIRE_IDENTITY = 0x5A
    INQUIRE_NODE_ID = 0x5E


class BitRateSwitch(NamedTuple):
    """Activate bit timing: silence until `resume`, the new rate from `at` on (µs)."""

    at: int
    resume: int
    bit_rate: int  # bit/s


class LssSlave:
    """The LSS slave of a node.

    Args:
        identity: vendor-id, product code, revision number, serial number (1018h).
        node_id: active node-id, 255 without one.
        send: takes the eight bytes of each response.
        bit_rate: the stored bit rate (bit/s); None if there is none.
        store: keeps node-id and bit rate for the next power-on; False if it failed.
    """

    def __init__(
        self, identity: tuple[int, int, int, int], node_id: int, send: Callable[[bytes], None],
        bit_rate: int | None = None,
        store: Callable[[int, int | None], bool] = lambda node_id, bit_rate: True,
    ):
        self._identity = identity
        self._send = send
        self._keep = store
        self.stored_node_id = node_id  # active after the next power-on
        self.stored_bit_rate = bit_rate  # bit/s; None: never stored
        self.active_node_id = node_id
        self.bit_rate: int | None = None  # bit/s, activated by the master; None: unchanged
        self.bit_rate_switch: BitRateSwitch | None = None  # in progress
        self.power_on()

    def power_on(self) -> None:
        """Start in the waiting state with the stored node-id."""
        self.node_id = self.stored_node_id  # pending: active at the next reset communication
        self._bit_rate = self.stored_bit_rate  # pending
        self.state = LssState.WAITING
        self._selected = self._identified = self._scanned = 0

    def request(self, data: bytes, time: int) -> None:
        """Process a message of the master at `time` (µs); an invalid one is ignored."""
        if len(data) != 8:
            return
        command = data[0]
        configuration = self.state == LssState.CONFIGURATION
        if 0 <= (field := command - Command.SWITCH_SELECTIVE) < 4:
            self._switch_selective(field, data)
        elif 0 <= (step := command - Command.IDENTIFY_REMOTE) < 6:
            self._identify(step, data)
        elif configuration and 0 <= (field := command - Command.INQUIRE_IDENTITY) < 4:
            self._answer(command, struct.pack("<I", self._identity[field]))
        elif command in _ALWAYS:
            _ALWAYS[command](self, data, time)
        elif configuration and command in _CONFIGURATION:
            _CONFIGURATION[command](self, data, time)

    def switching(self, time: int) -> bool:
        """Whether the bit rate is being switched, when no frame passes (inferred)."""
        switch = self.bit_rate_switch
        if switch is None:
            return False
        if time >= switch.at:
            self.bit_rate = switch.bit_rate
        if time >= switch.resume:
            self.bit_rate_switch = None
        return time < switch.resume

    def _answer(self, command: int, data: bytes = b"") -> None:
        self._send(bytes([command]) + data.ljust(7, b"\0"))

    def _enter(self, state: LssState) -> None:
        self.state = state
        self._selected = self._scanned = 0

    # ------------------------------------------------------- switch, identify

    def _switch_global(self, data: bytes, time: int) -> None:
        if data[1] in (LssState.WAITING, LssState.CONFIGURATION):
            self._enter(LssState(data[1]))

    def _switch_selective(self, field: int, data: bytes) -> None:
        """Four messages in order, each with one field of the identity."""
        matches = struct.unpack_from("<I", data, 1)[0] == self._identity[field]
        if self.state != LssState.WAITING or not matches or field not in (0, self._selected):
            self._selected = 0
        elif field < 3:
            self._selected = field + 1
        else:
            self._enter(LssState.CONFIGURATION)
            self._answer(Command.SELECTED)

    def _identify(self, step: int, data: bytes) -> None:
        """Six messages in order: vendor-id, product code, ranges of revision and serial number."""
        vendor, product, revision, serial = self._identity
        value = struct.unpack_from("<I", data, 1)[0]
        fits = (
            value == vendor, value == product,
            value <= revision, revision <= value, value <= serial, serial <= value,
        )
        if not fits[step] or step not in (0, self._identified):
            self._identified = 0
            return
        self._identified = step + 1
        if step == 5:
            self._identified = 0
            self._answer(Command.IDENTIFIED)

    def _without_node_id(self) -> bool:
        return self.active_node_id == UNCONFIGURED and self.node_id == UNCONFIGURED

    def _identify_non_configured(self, data: bytes, time: int) -> None:
        if self._without_node_id():
            self._answer(Command.NON_CONFIGURED)

    def _fastscan(self, data: bytes, time: int) -> None:
        """Slaves without a node-id confirm a field of their identity bit by bit."""
        if not self._without_node_id() or self.state != LssState.WAITING:
            return
        number, bit, field, following = struct.unpack_from("<IBBB", data, 1)
        if bit == CONFIRM:
            self._scanned = 0
            self._answer(Command.IDENTIFIED)
            return
        if bit > 31 or field > 3 or following > 3 or field != self._scanned:
            return
        if (number ^ self._identity[field]) >> bit:
            return
        if bit == 0:
            self._scanned = following
            if following < field:  # all four fields are found
                self._enter(LssState.CONFIGURATION)
        self._answer(Command.IDENTIFIED)

    # ----------------------------------------------------------- configuration

    def _configure_node_id(self, data: bytes, time: int) -> None:
        """Error code 1: out of range."""
        good = 1 <= data[1] <= 127 or data[1] == UNCONFIGURED
        if good:
            self.node_id = data[1]
        self._answer(data[0], bytes([not good]))

    def _configure_bit_timing(self, data: bytes, time: int) -> None:
        """Error code 1: bit timing not supported."""
        good = data[1] == 0 and data[2] in BIT_RATES
        if good:
            self._bit_rate = BIT_RATES[data[2]]
        self._answer(data[0], bytes([not good]))

    def _activate_bit_timing(self, data: bytes, time: int) -> None:
        """Start two delays, between which the bit rate changes; there is no answer."""
        if self._bit_rate is not None:
            delay = struct.unpack_from("<H", data, 1)[0] * 1000
            self.bit_rate_switch = BitRateSwitch(time + delay, time + 2 * delay, self._bit_rate)

    def _store(self, data: bytes, time: int) -> None:
        """Error code 2: the medium cannot be accessed."""
        kept = self._keep(self.node_id, self._bit_rate)
        if kept:
            self.stored_node_id, self.stored_bit_rate = self.node_id, self._bit_rate
        self._answer(data[0], bytes([0 if kept else 2]))

    def _inquire_node_id(self, data: bytes, time: int) -> None:
        self._answer(data[0], bytes([self.active_node_id]))


_Handler = Callable[[LssSlave, bytes, int], None]
_ALWAYS: dict[int, _Handler] = {
    Command.SWITCH_GLOBAL: LssSlave._switch_global,
    Command.IDENTIFY_NON_CONFIGURED: LssSlave._identify_non_configured,
    Command.FASTSCAN: LssSlave._fastscan,
}
_CONFIGURATION: dict[int, _Handler] = {
    Command.CONFIGURE_NODE_ID: LssSlave._configure_node_id,
    Command.CONFIGURE_BIT_TIMING: LssSlave._configure_bit_timing,
    Command.ACTIVATE_BIT_TIMING: LssSlave._activate_bit_timing,
    Command.STORE: LssSlave._store,
    Command.INQUIRE_NODE_ID: LssSlave._inquire_node_id,
}
