"""`servogym ethercat`: mistakes in one line, a clean end, drives behind a UDP socket."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from servogym.drive.ethercat.frame import UDP_PORT
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.wire import ethernet
from servogym.drive.wire.ethernet import UdpPort

HEADER = 14  # bytes of Ethernet in front of what goes by UDP
# of the servers here: others use the one that is the default, and pytest -n has several processes
ADDRESS = f"127.88.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF or 1}"
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="raw sockets of Linux")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "name one interface with -i, two for redundancy, or use --udp"),
        (["-i", "a", "-i", "b", "-i", "c"], "name one interface with -i, two for redundancy"),
        (["-i", "a", "--udp"], "name one interface with -i, two for redundancy, or use --udp"),
        (["--udp", "--clock", "sun"], "--clock = 'sun': use one of frame, dc, real"),
        (["--udp", "--log", "run.txt"], "captures are .pcapng"),
        (["--udp", "--slaves", "0"], "--slaves: 0 is out of range 1.."),
        (["--udp", "--slaves", "70000"], "--slaves = 70000: give 1 to 65535, a segment has at"),
        (
            ["--udp", "--drive", "generic", "--drive", "generic", "--slaves", "40000"],
            "--slaves = 40000: give 1 to 32767",
        ),
        (
            ["--udp", "--fault", "retreat code=0x1FFFFFFFF"],
            "fault retreat: code = 8589934591 is not a whole number in 0..65535",
        ),
        (["--udp", "--fault", "break_link port=4"], "fault break_link: port = 4 is not a whole"),
        (["--udp", "--fault", "explode"], "fault 'explode': choose one of drop, "),
        (["--udp", "--fault", "drop at=noon:1"], "at=noon:1: give one of frame, "),
        (["--udp", "--fault", "drop when=1"], "'when' is unknown: use "),
        (["--udp", "--fault", "drop count=1 count=2"], "'count' is given twice"),
    ],
)
def test_a_mistake_is_one_line_that_says_the_next_step(refused, arguments, says):
    assert says in refused(["ethercat", *arguments])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--drive", "metronix_ars2000"], "is not for ethercat, but for can: use `servogym node`"),
        (["--drive", "nobody"], "unknown drive model 'nobody': choose one of"),
        (["--axis", "ring"], "--axis = 'ring': choose one of linear"),
    ],
)
def test_what_cannot_be_served_is_told_and_the_port_is_given_back(refused, arguments, says):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((ADDRESS, UDP_PORT))
        except OSError:
            pytest.skip(f"UDP port {UDP_PORT} is in use here")
    for _ in range(2):
        assert says in refused(["ethercat", "--udp", ADDRESS, *arguments])


@LINUX
def test_an_unknown_interface_is_told_with_those_there_are(refused, monkeypatch):
    class NoSuchDevice(socket.socket):
        def __init__(self, *_):
            super().__init__(socket.AF_INET, socket.SOCK_DGRAM)

        def bind(self, _):
            raise OSError(19, "No such device")

    monkeypatch.setattr(ethernet.socket, "socket", NoSuchDevice)
    error = refused(["ethercat", "-i", "nowhere0"])
    assert "interface nowhere0 does not exist: choose one of " in error
    assert "lo" in error


@LINUX
def test_a_missing_right_is_told_with_the_command_that_gives_it(refused, monkeypatch):
    def forbidden(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(ethernet.socket, "socket", forbidden)
    error = refused(["ethercat", "-i", "eth0"])
    assert "sudo setcap cap_net_raw+ep" in error


class UdpWire:
    """A master's side of the UDP socket."""

    def __init__(self, address):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(2.0)
        self._address = address

    def exchange(self, frame, now=0):
        self._socket.sendto(frame[HEADER:], self._address)
        try:
            return frame[:HEADER] + self._socket.recv(2048)
        except TimeoutError:
            return None

    def close(self):
        self._socket.close()


@pytest.fixture
def served(tmp_path):
    """The command in a process of its own, with a capture; ended by SIGTERM."""
    try:
        UdpPort(ADDRESS).close()
    except ValueError as error:
        pytest.skip(str(error))
    log = tmp_path / "run.pcapng"
    command = [sys.executable, "-W", "error", "-m", "servogym.training.cli", "ethercat", "--udp",
               ADDRESS, "--axis", "none", "--slaves", "2", "--log", str(log)]
    server = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        yield server, log
    finally:
        if server.poll() is None:
            server.kill()
        server.communicate()


def test_a_master_reaches_op_over_udp_and_sigterm_ends_it_clean(served):
    server, log = served
    line = ""
    while "slaves on" not in line:
        line = server.stdout.readline()
        assert server.poll() is None, server.stderr.read()
    assert f"2 slaves on udp {ADDRESS}:{UDP_PORT}, clock frame" in line
    wire = UdpWire((ADDRESS, UDP_PORT))
    master = EtherCatMaster(wire)
    assert [slave.description.order for slave in master.scan()] == ["AKD", "AKD"]
    master.to_op()
    assert all(master.cycle() for _ in range(200))
    wire.close()
    server.send_signal(signal.SIGTERM)
    out, err = server.communicate(timeout=30)
    assert server.returncode == 0, err
    assert err == ""
    assert "0 deadlines missed" in " ".join(out.split())
    assert log.stat().st_size > 200 * 60, "each frame is in the capture"


def test_a_second_server_on_the_port_is_refused(served, refused):
    server, _ = served
    while "slaves on" not in server.stdout.readline():
        assert server.poll() is None, server.stderr.read()
    begin = time.monotonic()
    assert "is another `servogym ethercat` running?" in refused(["ethercat", "--udp", ADDRESS])
    assert time.monotonic() - begin < 5
