"""A node lives through its bus: what fails is counted, told once, tried again; logs are whole."""

import itertools
import os
import signal
import subprocess
import sys
import time

import can
import pytest

from servogym.drive.canopen.frame import parse
from servogym.drive.wire import adapter as adapters
from servogym.drive.wire.adapter import Adapter
from servogym.drive.wire.bus import to_frame, to_message
from servogym.drive.wire.log import LogFile, messages
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for
from servogym.training import cli


class Bad:
    """A bus that fails while `error` is set."""

    def __init__(self, error=None):
        self.error, self.sent, self.closed = error, [], False

    def send(self, message):
        if self.error:
            raise self.error
        self.sent.append(str(to_frame(message)))

    def recv(self, timeout=None):
        if isinstance(self.error, can.CanOperationError):
            raise self.error
        return None

    def shutdown(self):
        self.closed = True


TROUBLE = [
    can.CanOperationError("Failed to transmit: No buffer space available [Error Code 105]"),
    can.CanTimeoutError("bus-off"),
    OSError(19, "No such device"),
]


@pytest.fixture
def clock(monkeypatch):
    """Time that passes when it is told to."""

    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

        def sleep(self, seconds):
            self.now += seconds

    clock = Clock()
    monkeypatch.setattr(adapters, "time", clock)
    return clock


def message(n=0):
    return to_message(parse(f"{0x181 + n:03X}#00"))


@pytest.mark.parametrize("error", TROUBLE, ids=lambda e: type(e).__name__)
def test_what_the_bus_refuses_is_sent_when_it_works_again_in_its_order(clock, error):
    bus, told = Bad(error), []
    adapter = Adapter(bus, tell=told.append)
    for n in range(3):
        adapter.send(message(n))
        adapter.recv(0.001)
    assert (bus.sent, len(told)) == ([], 1)
    assert str(error.args[-1]) in told[0]
    bus.error = None
    adapter.recv(0.001)
    assert bus.sent == ["181#00", "182#00", "183#00"]
    assert adapter.failed >= 3
    assert adapter.lost == 0
    assert told[1].startswith("the bus works again after 0.0 s, 0 frames were lost")
    assert len(told) == 2


def test_what_waits_too_long_or_is_too_much_is_lost_and_counted(clock):
    bus = Bad(TROUBLE[0])
    adapter = Adapter(bus)
    for _ in range(adapters.QUEUE + 10):
        adapter.send(message())
    assert adapter.lost == 10
    clock.now += adapters.PATIENCE + 0.1
    adapter.send(message(5))
    bus.error = None
    adapter.flush()
    assert bus.sent == ["186#00"]
    assert adapter.lost == 10 + adapters.QUEUE


def test_a_busy_machine_loses_no_message_of_a_bus_that_works(clock, monkeypatch):
    """It may stand still for longer than a message waits, between any two lines."""
    bus, looks = Bad(), itertools.count(100.0, 2 * adapters.PATIENCE)
    monkeypatch.setattr(clock, "monotonic", lambda: next(looks))
    adapter = Adapter(bus)
    for n in range(3):
        adapter.send(message(n))
    assert bus.sent == ["181#00", "182#00", "183#00"]
    assert adapter.lost == 0


def test_an_adapter_that_was_pulled_is_opened_anew_when_it_is_back(clock):
    pulled, found, told, tries = Bad(TROUBLE[2]), Bad(), [], []

    def reopen():
        tries.append(clock.now)
        if len(tries) < 3:
            raise can.CanInitializationError("no such device")
        return found

    adapter = Adapter(pulled, reopen, told.append)
    for _ in range(500):
        adapter.send(message())
        clock.now += 0.01
        if adapter.bus is found:
            break
    adapter.send(message(7))
    assert len(tries) == 3
    assert all(b - a >= adapters.PATIENCE for a, b in itertools.pairwise(tries))
    assert pulled.closed
    assert found.sent[-1] == "188#00"
    assert len(told) == 2


@pytest.mark.parametrize("error", TROUBLE, ids=lambda e: type(e).__name__)
def test_a_served_drive_goes_on_while_the_bus_is_gone_and_answers_afterwards(error, monkeypatch):
    monkeypatch.setattr(adapters, "PATIENCE", 600.0)  # no frame ages on a slow machine
    bus = Bad(error)
    server = Server(bus, [axis_for("generic", 1)])
    end = time.monotonic() + 15.0
    while not server.statistics.cycles:
        assert time.monotonic() < end
        server.serve(server.adapter.recv(0.001))
    bus.error = None
    server.serve(to_message(parse("601#4001100000000000")))
    server.serve(None)
    assert bus.sent == ["701#00", "581#4F01100000000000"]


# ---------------------------------------------------------------------------------- logs


def test_a_full_disk_ends_the_log_and_not_the_drive(tmp_path):
    (tmp_path / "run.log").symlink_to("/dev/full")
    told = []
    server = Server(Bad(), [axis_for("generic", 1)], LogFile(tmp_path / "run.log", told.append))
    server.serve(None)
    server.serve(to_message(parse("601#4001100000000000")))
    assert server.bus.sent == ["701#00", "581#4F01100000000000"]
    assert len(told) == 1
    assert "No space left on device; the log ends here, the drive goes on" in told[0]
    server.close()


@pytest.fixture
def node(tmp_path):
    """`servogym node` on a bus of its own, with a log of any format."""
    processes = []

    def start(suffix):
        log = tmp_path / f"run{suffix}"
        port = 50_000 + os.getpid() % 9_000
        process = subprocess.Popen(
            [sys.executable, "-m", "servogym.training.cli", "node", "-i", "udp_multicast",
             "-c", "239.74.163.79", "--bus-kwargs", f"port={port}", "--log", str(log)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "COLUMNS": "200"},
        )
        processes.append(process)
        line = process.stdout.readline()
        while "as node" not in line:
            assert line, process.communicate()
            line = process.stdout.readline()
        assert "on --interface udp_multicast --channel 239.74.163.79 " in line, "as it was given"
        time.sleep(0.5)
        return process, log

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def test_sigterm_ends_the_node_as_ctrl_c_does_and_leaves_a_whole_blf(node):
    process, log = node(".blf")
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (0, "")
    assert "frames received" in output
    assert [str(to_frame(m)) for m in messages(log)][:1] == ["701#00"]


def test_a_killed_node_leaves_a_readable_log(node):
    process, log = node(".log")
    process.kill()
    process.communicate()
    (boot, *_) = messages(log)
    assert str(to_frame(boot)) == "701#00"
    assert not boot.is_rx, "frames that we send are marked as sent"


# ---------------------------------------------------------------------------- command line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["-i", "socketcan", "-c", "nocan0"], "no bus on --interface socketcan --channel nocan0"),
        (["-i", "pcan", "-c", "x"], "no bus on --interface pcan"),
        (["-i", "kvaser", "-c", "0"], "no bus on --interface kvaser"),
        (["-i", "slcan", "-c", "/dev/nothing"], "no bus on --interface slcan"),
        (["-i", "udp_multicast", "-c", "nowhere"], "no bus on --interface udp_multicast"),
        (
            ["-i", "udp_multicast", "--bus-kwargs", "prot=4"],
            "prot: unknown to -i udp_multicast; did you mean port",
        ),
        (["-i", "virtual", "--bus-kwargs", "preserve_timestamp=1"], "mean preserve_timestamps"),
        (["--bus-config", "nothing"], "no bus on --bus-config nothing"),
        (["--drive", "kollmorgen_akd"], "use `servogym ethercat`"),
        (["--parameter-file", "/nowhere/p.json"], "there is no folder /nowhere; make it first"),
        (["--log", "run.xyz"], "use .log, .asc or .blf"),
    ],
)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of python-can
def test_a_mistake_is_one_line_and_status_2(refused, monkeypatch, tmp_path, arguments, says):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert says in refused(["node", *arguments])


def test_keywords_that_an_interface_takes_without_naming_them_are_known():
    from can.interfaces.kvaser import KvaserBus
    from can.interfaces.pcan import PcanBus

    from servogym.drive.wire.interfaces import _keywords

    assert {"f_clock_mhz", "nom_brp", "state"} <= _keywords(PcanBus.__init__)
    assert {"accept_virtual", "tseg1"} <= _keywords(KvaserBus.__init__)


def test_without_options_the_bus_needs_no_hardware_and_speaks_classical_can():
    from servogym.training.cli.bus import opened

    options = cli.parser().parse_args(["node"])
    try:
        bus = opened(options)
    except ValueError as error:
        pytest.skip(str(error))
    with bus:
        assert bus.protocol == can.CanProtocol.CAN_20
