"""Drives on a bus of python-can: echoes, several nodes, our master, a process of its own."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus

from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.remote import CanOpenPort
from servogym.drive.kernel.words import Mode, State
from servogym.drive.master import BusError, Master, ServoError
from servogym.drive.wire.bus import CanLink, CanPort, Traced, to_frame, to_message
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for
from servogym.training.cli.status import Line

GROUP = "239.74.163.78"
PORT = 40_000 + os.getpid() % 20_000  # one port, one bus, whatever the group; pytest -n has several


class Echoing(UdpMulticastBus):
    """A bus that gives every frame back to its sender, as a multicast group does."""

    def __init__(self):  # opens nothing
        self.sent = []
        self.waiting = []

    def shutdown(self):
        pass

    def send(self, message):
        self.sent.append(str(to_frame(message)))
        self.waiting.append(message)

    def recv(self, timeout=None):
        return self.waiting.pop(0) if self.waiting else None


class Lines(list):
    """A log in memory."""

    def __call__(self, message):
        self.append(message)

    def flush(self):
        pass


def serve(server, text=None):
    """Serve a frame and all that comes of it."""
    server.serve(to_message(parse(text)) if text else None)
    while server.bus.waiting:
        server.serve(server.adapter.recv(0.0))


def test_a_server_drops_what_it_has_sent_itself_and_logs_each_frame_once():
    log = Lines()
    server = Server(Echoing(), [axis_for("generic", 1)], log)
    serve(server)
    serve(server, "601#4001100000000000")
    serve(server, "601#4001100000000000")
    assert server.bus.sent == ["701#00", "581#4F01100000000000", "581#4F01100000000000"]
    assert (server.statistics.received, server.statistics.sent) == (2, 3)
    assert [str(to_frame(m))[:3] for m in log] == ["701", "601", "581", "601", "581"]
    assert [m.is_rx for m in log] == [False, True, False, True, False]


def test_in_a_multicast_group_nobody_hears_himself_and_each_frame_is_logged_once(tmp_path):
    options = {"interface": "udp_multicast", "channel": GROUP, "port": PORT, "fd": False}
    frames = [parse(text) for text in ("080#", "601#4041600000000000", "080#")]
    log = Lines()
    with can.Bus(**options) as here, can.Bus(**options) as there:
        master, link = CanPort(here, 1.0, log), Traced(CanLink(there, 1.0), tmp_path / "all.log")
        assert master.exchange(frames) == []
        assert [*link.receive(0)] == frames
        link.send(parse("080#"), 0)  # as the master's
        link.send(parse("581#4F01100000000000"), 0)
        assert master.exchange([]) == [parse("080#"), parse("581#4F01100000000000")]
        assert [*link.receive(0)] == []
        link.close()
    told = can.LogReader(tmp_path / "all.log")
    assert [message.is_rx for message in log] == [False] * 3 + [True] * 2
    assert [message.is_rx for message in told] == [True] * 3 + [False] * 2


def test_what_comes_later_than_an_echo_is_taken():
    server = Server(Echoing(), [axis_for("generic", 1)])
    serve(server)
    serve(server, "701#00")  # another node with the same node-id
    assert server.statistics.received == 1


def test_nodes_of_one_server_hear_each_other():
    server = Server(Echoing(), [axis_for("generic", 1), axis_for("generic", 2)])
    first, second = (node.drive for node in server.nodes)
    second.write(0x1400, 1, 0x8000_0202)
    second.write(0x1400, 1, 0x181)  # RPDO 1 is TPDO 1 of the other
    serve(server, "000#0100")
    while server.statistics.cycles < 20:
        serve(server)
    assert second.read("controlword") == first.read("statusword") != 0


def test_the_live_line_has_state_frames_a_second_and_the_last_sdo_request():
    server = Server(Echoing(), [axis_for("generic", 1)])
    line = Line(server)
    serve(server)
    assert "0 frames/s" in line.text(10.0).plain
    serve(server, "601#2B40600006000000")
    serve(server, "601#0000000000000000")  # a part of a transfer names no object
    drive = server.nodes[0].drive
    while drive.state != State.READY_TO_SWITCH_ON:
        serve(server)
    frames = server.statistics.received + server.statistics.sent - 1
    told = line.text(12.0).plain
    assert told.startswith("1 READY_TO_SWITCH_ON")
    assert f"{frames / 2:.0f} frames/s" in told
    assert told.endswith("write controlword (6040h:00) = 0006h SHUTDOWN")
    drive.inject("overvoltage")
    while drive.state != State.FAULT:
        serve(server)
    assert line.text(13.0).plain.startswith("1 FAULT 3210h DC link over-voltage")


def test_error_and_fd_frames_are_no_frames():
    assert to_frame(can.Message(is_error_frame=True)) is None
    assert to_frame(can.Message(is_fd=True)) is None
    frames = [
        Frame(0x601, bytes(8)),
        Frame(0x181, remote=True),
        Frame(0x1234567, b"1", False, True),
    ]
    assert [to_frame(to_message(frame)) for frame in frames] == frames


def work(master):
    """What a machine does in a shift; -> the statusword at its end."""
    master.enable()
    master.home(37)
    master.move_to(20_000)
    master.move_to(10_000, relative=True, wait=False)
    master.move_to(0)
    master.set_mode(Mode.PROFILE_VELOCITY)
    master.quick_stop()
    assert master.state == State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("pdo", [False, True], ids=["sdo", "pdo"])
def test_the_master_works_on_a_bus_of_python_can(pdo):
    with (
        can.Bus(interface="virtual", channel="servogym-bus") as there,
        can.Bus(interface="virtual", channel="servogym-bus") as here,
    ):
        server = Server(there, [axis_for("generic", 5)])
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            port = CanOpenPort(CanPort(here), 5)
            if pdo:
                port.use_pdos()
            work(Master(port))
        finally:
            server.stop()
            thread.join(5)


class Full:
    """A bus whose transmit buffer is full for the first messages; it receives nothing."""

    def __init__(self, failures, error=None):
        self.failures, self.sent = failures, []
        self.error = error or can.CanOperationError("Transmit buffer full")

    def send(self, message):
        if self.failures:
            self.failures -= 1
            raise self.error
        self.sent.append(message)

    def recv(self, timeout):
        return None


def test_a_full_transmit_buffer_is_given_time_to_empty():
    bus = Full(20)
    CanPort(bus, wait=0.0).exchange([parse("601#4041600000000000"), parse("080#")])
    assert [str(to_frame(message)) for message in bus.sent] == ["601#4041600000000000", "080#"]
    bus = Full(20)
    CanLink(bus).send(parse("080#"), 0)
    assert len(bus.sent) == 1


@pytest.mark.parametrize(
    "error", [can.CanOperationError("Transmit buffer full"), OSError(100, "Network is down")]
)
def test_a_bus_that_takes_no_frame_is_an_error_of_the_master_with_the_next_step(error):
    master = Master(CanOpenPort(CanPort(Full(10**9, error), wait=0.0), 5))
    with pytest.raises(
        ServoError, match=rf"sending 605#.*{error.args[-1]}.* termination"
    ) as caught:
        master.enable()
    assert isinstance(caught.value, BusError)


def test_a_bus_that_fails_in_receiving_is_an_error_of_the_master():
    bus = Full(0)
    bus.recv = lambda timeout: (_ for _ in ()).throw(can.CanOperationError("device lost"))
    with pytest.raises(BusError, match=r"receiving: .* device lost; .*plugged in"):
        CanPort(bus).exchange([])


@pytest.fixture
def multicast():
    """A member of a multicast group where frames arrive."""
    try:
        bus = can.Bus(interface="udp_multicast", channel=GROUP, port=PORT)
        probe = can.Bus(interface="udp_multicast", channel=GROUP, port=PORT)
    except (OSError, can.CanError, ImportError) as error:
        pytest.skip(f"udp_multicast does not work here: {error}")
    with bus, probe:
        probe.send(to_message(parse("7FF#")))
        if bus.recv(1.0) is None:
            pytest.skip("udp_multicast does not work here: a frame sent does not arrive")
        yield bus


@pytest.fixture
def process(tmp_path):
    """`servogym node` in a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-m", "servogym.training.cli", "node", "--node-id", "7",
         "-i", "udp_multicast", "-c", GROUP, "--log", str(tmp_path / "run.log")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "COLUMNS": "200", "CAN_CONFIG": json.dumps({"port": PORT})},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in background
    )
    yield process
    process.kill()
    process.communicate()


def test_a_node_in_another_process_serves_until_ctrl_c(multicast, process, tmp_path):
    boot, end = parse("707#00"), time.monotonic() + 90
    while (message := multicast.recv(1.0)) is None or to_frame(message) != boot:
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()
    port = CanOpenPort(CanPort(multicast), 7)
    port.use_pdos()
    work(Master(port))
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (0, "")
    statistics = output.splitlines()[-1]
    counts = re.fullmatch(
        r"(\d+) frames received, (\d+) sent, (\d+) position cycles, (\d+) deadlines missed",
        statistics,
    )
    received, sent, cycles, _ = map(int, counts.groups())
    lines = [line.split()[2] for line in (tmp_path / "run.log").read_text().splitlines()]
    assert len(lines) == received + sent
    from_node = [line for line in lines if line[:3] in ("707", "187", "587", "087")]
    assert len(from_node) == sent  # none of them came back
    assert cycles > 100
