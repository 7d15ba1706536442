"""What a program gives wrong is refused by name, whatever it is; nothing has changed then."""

import inspect
import math

import pytest

from servogym.drive.drive import Drive
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.faulty import KINDS, Fault, FaultyBus
from servogym.drive.ethercat.frame import Command, Datagram, pack
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave

FRAME = pack([Datagram(Command.BRD, 0, 0x0130, bytes(2))])
WRONG = (None, "7", 7.5, math.nan, -(1 << 70), 1 << 70, [], b"x", True, object())


@pytest.fixture(scope="module")
def segment():
    return Segment([Slave(Drive("generic", bus="ethercat")) for _ in range(2)])


# what it is called with, rightly; each argument is replaced by each wrong value in turn
CALLS = {
    "exchange": dict(frame=FRAME, now=0, port=0),
    "power": dict(slave=0, on=True, now=0),
    "break_link": dict(slave=0, port=1),
    "heal_link": dict(slave=0, port=1),
    "cable": dict(slave=0, port=1),
    "latch": dict(slave=0, unit=0, rising=True, now=0),
    "poll": dict(now=0),
}
FREE = {("power", "on"), ("latch", "rising"), ("power", "now")}  # any truth; only for power-on


@pytest.mark.parametrize("name", CALLS)
def test_a_segment_refuses_what_is_no_number_in_range(segment, name):
    call = getattr(segment, name)
    assert set(CALLS[name]) == set(inspect.signature(call).parameters)
    before = segment.snapshot()
    for argument in CALLS[name]:
        if (name, argument) in FREE:
            continue
        for value in WRONG:
            if argument == "frame" and isinstance(value, bytes):
                continue
            with pytest.raises(ValueError, match=f"^{argument} = "):
                call(**CALLS[name] | {argument: value})
    assert segment.snapshot() == before


@pytest.mark.parametrize("slave", [2, 9, -1])
def test_a_slave_that_is_not_there_has_no_power(segment, slave):
    with pytest.raises(ValueError, match=f"slave = {slave} is not a whole number in 0..1"):
        segment.power(slave, False)


@pytest.mark.parametrize("value", WRONG)
def test_a_bus_and_a_master_refuse_what_is_no_number_in_range(segment, value):
    bus = Bus(segment)
    with pytest.raises(ValueError, match=r"^now = "):
        bus.exchange(FRAME, value)
    with pytest.raises(ValueError, match=r"^port = "):
        bus.exchange(FRAME, 0, value)
    with pytest.raises(ValueError, match=r"^span = "):
        bus.let_pass(value)
    with pytest.raises(ValueError, match=r"^most = "):
        EtherCatMaster(bus, value)
    with pytest.raises(ValueError, match=r"^hop = "):
        Segment(segment.stations, hop=value)
    with pytest.raises(ValueError, match=r"^clocks = "):
        Segment(segment.stations, clocks=[value])
    with pytest.raises(ValueError, match=r"^datagram 1 "):
        pack([Datagram(Command.FPRD, value, 0x0130, b"\0")] if value is not True else [(1,)])


@pytest.mark.parametrize("value", [-(1 << 70), 1 << 70, -1, 1 << 16, "7", None, 7.5])
def test_a_master_in_pre_op_refuses_addresses_that_no_object_has(segment, value):
    master = EtherCatMaster(Bus(segment))
    master.scan()
    master.to_preop()
    slave = master.slaves[0]
    for wrong, name in (
        (lambda: slave.upload(value), "index"),
        (lambda: slave.upload(0x1000, value), "subindex"),
        (lambda: slave.mailbox.download(0x6040, 0, value), "data"),
        (lambda: slave.assign([value], []), "PDO"),
        (lambda: master.sync0(value if value != 1 << 16 else 0), "cycle"),
    ):
        with pytest.raises(ValueError, match=f"^{name} = "):
            wrong()


@pytest.mark.parametrize("value", [-(1 << 70), 1 << 70, 1 << 33, -2, "7", None, 7.5])
@pytest.mark.parametrize("field", ["count", "slave", "port", "code", "frames"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_refuses_a_number_out_of_range(kind, field, value):
    with pytest.raises(ValueError, match=f"^fault {kind}: {field} = "):
        Fault(kind, **{field: value})


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_whose_numbers_are_in_range_does_what_it_says_and_raises_nothing(kind):
    """Each with the largest code there is, on a bus that goes to OP before."""
    segment = Segment([Slave(Drive("generic", bus="ethercat")) for _ in range(2)])
    code = 0xFFFFFFFF if kind == "mailbox_abort" else 0xFFFF
    bus = FaultyBus(segment, faults=[Fault(kind, at="frame:1000000000", code=code)])
    master = EtherCatMaster(bus)
    master.to_op()
    bus.order([Fault(kind, code=code)])
    for _ in range(3):
        master.cycle()
    assert bus.happened[0] == (not kind.startswith("mailbox"))


@pytest.mark.parametrize("code", [0x10000, -1, None, 1 << 33])
def test_a_slave_does_not_show_a_code_that_0134h_cannot_hold(segment, code):
    with pytest.raises(ValueError, match=r"^code = "):
        segment.stations[0].fail(code)
