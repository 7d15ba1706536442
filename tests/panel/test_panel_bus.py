"""The panel on a running node: watched by SDO, commanded if asked to, and without a word sent."""

import time

import pytest

from servogym.drive.canopen.node import NmtCommand, Node
from servogym.drive.canopen.port import NodePort
from servogym.drive.canopen.remote import CanOpenPort
from servogym.drive.kernel.words import State
from servogym.drive.master import Master, Units
from servogym.envs.panel.bus import BusBench
from servogym.envs.panel.clock import Clock
from servogym.envs.plants.linear_axis import linear_axis

SI = Units(1e-6, 1e-6, "m")
AXIS = "node 5"


class Line(NodePort):
    """A bus that can be cut, and that remembers what was sent and what came."""

    def __init__(self, machine, node):
        super().__init__(machine, node)
        self.cut, self.sent, self.came = False, [], []

    def exchange(self, frames):
        frames = list(frames)
        self.sent += frames
        came = super().exchange(() if self.cut else frames)
        self.came += came
        return [] if self.cut else came


class Ear:
    """Another member of that bus; it hears all and may not speak."""

    def __init__(self, line):
        self.line, self.at = line, 0

    def now(self):
        return self.line.now()

    def exchange(self, frames):
        assert not list(frames)
        heard = [*self.line.came, *self.line.sent][self.at :]
        self.line.came, self.line.sent = [], []
        return heard


@pytest.fixture
def line():
    machine = linear_axis()
    machine.reset(positions={"x": 0.12})
    drive = machine.drives["x"]
    drive.node_id = 5
    drive.reset_communication()
    return Line(machine, Node(drive))


@pytest.fixture
def bench(line):
    bench = BusBench(line, {AXIS: 5}, units=SI, rate=50.0)
    bench.advance(0.5)
    return bench


def seen(bench):
    return bench.shown()["axes"][AXIS]


def drive_of(line):
    return line.nodes[0].drive


def test_a_node_is_enabled_homed_and_moved_like_a_machine_of_ones_own(bench):
    assert "Enable" in bench.move(AXIS, 0.2)
    assert bench.enable(AXIS) == ""
    assert bench.home(AXIS, 37) == ""
    assert bench.move(AXIS, 0.2) == ""
    bench.advance(0.2)
    assert seen(bench)["position"] == pytest.approx(200.0, abs=0.02)
    assert State(seen(bench)["state"]) is State.OPERATION_ENABLED
    assert bench.quick_stop() == ""
    bench.advance(0.2)
    assert State(seen(bench)["state"]) is State.SWITCH_ON_DISABLED


def test_watching_sends_nothing_but_sdo_requests(bench, line):
    bench.advance(1.0)
    assert {frame.id for frame in line.sent} == {0x605}
    assert State(drive_of(line).axis.state) is State.SWITCH_ON_DISABLED


def test_what_the_node_refuses_is_said_with_its_abort_code(bench, line):
    assert "does not fit UNSIGNED16" in bench.write(AXIS, "max_torque", 70_000)
    assert "(06090030h)" in bench.write(AXIS, "homing_method", 99)
    assert bench.write(AXIS, 0x6072, 0, 1234) == ""
    assert drive_of(line).read("max_torque") == 1234
    assert bench.value(AXIS, "max_torque") == 1234
    assert "no object" in bench.write(AXIS, 0x5FFF, 0, 1)


def test_the_scope_samples_at_the_rate_that_was_asked_for(bench):
    before = bench.scope.count
    bench.advance(2.0)
    assert bench.scope.count - before == pytest.approx(100, abs=2)
    assert bench.rate == pytest.approx(50.0, rel=0.02)


def test_a_rate_the_node_cannot_hold_is_not_claimed(line):
    bench = BusBench(line, {AXIS: 5}, rate=1000.0)  # four objects a sample, each takes a cycle
    bench.advance(1.0)
    assert 50 < bench.rate < 600
    assert "of 1000 samples/s" in bench.pulse()


def test_a_node_that_falls_silent_is_told_once_and_found_again(bench, line):
    line.cut = True
    bench.advance(3.0)
    assert not seen(bench)["answers"]
    assert sum("no answer" in event.text for event in bench.messages) == 1
    assert "no answer" in bench.enable(AXIS)
    line.cut = False
    bench.advance(1.5)
    assert seen(bench)["answers"]
    assert bench.messages[-1][2] == f"{AXIS} answers again"
    assert bench.enable(AXIS) == ""


def test_a_fault_comes_by_its_emergency_with_the_remedy(bench, line):
    bench.enable(AXIS)
    drive_of(line).inject("overvoltage")
    bench.advance(0.5)
    assert any("EMCY 3210h DC link over-voltage" in event.text for event in bench.messages)
    assert seen(bench)["fault"] == "3210h DC link over-voltage"
    assert "brake" in seen(bench)["remedy"]
    assert "still present" in bench.reset_fault(AXIS)


def test_a_word_that_leads_nowhere_is_explained(bench):
    assert bench.control_word(AXIS, 0x000F) == ""
    bench.advance(0.3)
    assert "shutdown (0006h)" in seen(bench)["refused"]


def test_listening_sends_nothing_and_sees_the_pdos_of_another_master(line):
    other = CanOpenPort(line, 5)
    bench = BusBench(Ear(line), {AXIS: 5}, listen=True, units=SI)
    assert seen(bench)["state"] == -1
    other.use_pdos()
    master = Master(other)
    master.enable()
    for _ in range(40):
        other.exchange()
        bench.exchange()
    assert State(seen(bench)["state"]) is State.OPERATION_ENABLED
    assert "--listen" in bench.move(AXIS, 0.1)
    assert "--listen" in bench.write(AXIS, "max_torque", 1)


def test_the_bytes_of_the_pdos_that_pass_are_seen(bench):
    assert bench.mapped(AXIS, "tx") == []
    bench.bus.nmt(NmtCommand.START)
    bench.control_word(AXIS, 6)
    bench.advance(0.1)
    assert [row.name for row in bench.mapped(AXIS, "tx")] == ["statusword"]
    assert seen(bench)["tpdo"] == bytes.fromhex("3102")  # ready to switch on, voltage, remote


def test_the_clock_does_not_pace_a_bus(bench):
    clock = Clock(bench)
    clock._rebase()
    bench.time += 4.0  # its time is not that of the clock
    begin = time.monotonic()
    clock._pace()
    assert time.monotonic() - begin < 2.0


def test_time_of_a_bus_is_not_ours(bench):
    clock = Clock(bench)
    for stop in (lambda: clock.pause(True), clock.single, lambda: clock.set_speed(2.0)):
        with pytest.raises(ValueError, match="cannot be stopped"):
            stop()


@pytest.mark.parametrize(
    ("nodes", "rate", "said"), [({AXIS: 0}, 20, "node_id"), ({AXIS: 5}, 0, "rate")]
)
def test_what_cannot_be_a_node_or_a_rate_is_refused(line, nodes, rate, said):
    with pytest.raises(ValueError, match=said):
        BusBench(line, nodes, rate=rate)
