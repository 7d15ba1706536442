"""Every command that serves says where once it listens: whoever connects then is answered."""

import json
import os
import re
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import can
import pytest
from later import only_with

from servogym.drive.canopen.frame import parse
from servogym.drive.ethercat.frame import UDP_PORT
from servogym.drive.wire.bus import to_frame, to_message

GROUP = "239.74.163.36"
CAN_PORT = 20_000 + os.getpid() % 20_000
ETHERCAT = "127.88.0.36"
IDENTITY = parse("601#4018100100000000")  # upload of 1018h:01
BROADCAST_READ = bytes.fromhex("0D10 0700 0000 0000 0100 0000 00 0000")  # of 0000h, one byte


def a_page(port, can_bus):
    """Anything a web server says is an answer: without the token it refuses."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=30) as answer:
            return answer.status == 200
    except urllib.error.HTTPError as error:
        return error.code == 403


def a_node(port, can_bus):
    """A node answers an SDO request; what it says of itself may come first."""
    can_bus.send(to_message(IDENTITY))
    while (message := can_bus.recv(30)) is not None:
        if to_frame(message).id == 0x581:
            return True
    return False


def a_slave(port, can_bus):
    """A slave adds one to the working counter."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.settimeout(30)
        wire.sendto(BROADCAST_READ, (ETHERCAT, UDP_PORT))
        return wire.recv(2048)[13:15] == b"\x01\x00"


PAGE = ("--no-browser", "--port", "{port}")
CAN = ("-i", "udp_multicast", "-c", GROUP)
needs_nicegui = only_with("nicegui", reason="needs servogym[panel]")
COMMANDS = [
    pytest.param(("panel", *PAGE), r"http://localhost:", a_page, marks=needs_nicegui),
    pytest.param(("classroom", *PAGE), r"http://localhost:", a_page, marks=needs_nicegui),
    (("node", *CAN), r"as node 1 on", a_node),
    (("serve", "LinearAxis-v0", *CAN), r"bus on udp_multicast", a_node),
    (("ethercat", "--udp", ETHERCAT, "--axis", "none"), r"1 slaves on udp", a_slave),
]


@pytest.fixture
def can_bus():
    """A member of the group of the servers here; None where multicast does not work."""
    try:
        with (
            can.Bus(interface="udp_multicast", channel=GROUP, port=CAN_PORT) as bus,
            can.Bus(interface="udp_multicast", channel=GROUP, port=CAN_PORT) as probe,
        ):
            probe.send(to_message(parse("7FF#")))
            yield bus if bus.recv(1.0) else None
    except (OSError, can.CanError, ImportError):
        yield None


@pytest.mark.parametrize(("arguments", "says", "answers"), COMMANDS)
def test_who_connects_as_the_line_appears_is_answered(arguments, says, answers, can_bus):
    if answers is a_node and can_bus is None:
        pytest.skip("udp_multicast does not work here")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [part.format(port=port) for part in arguments]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")} | {
        "PYTHONUNBUFFERED": "1", "COLUMNS": "200", "CAN_CONFIG": json.dumps({"port": CAN_PORT}),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "servogym.training.cli", *command], stdout=subprocess.PIPE,
        env=environment, text=True,
    )
    try:
        said = ""
        while not re.search(says, said):
            line = process.stdout.readline()
            assert line, said
            said += line
        assert answers(port, can_bus)
    finally:
        process.kill()
        process.communicate()
