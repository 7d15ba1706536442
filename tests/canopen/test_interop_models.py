"""The unmodified `canopen.BaseNode402` with every CANopen model, as the how-to says: SDO and PDO.

The recipe of docs/how-to/canopen.md is run as it stands there, see `recipe`.
"""

import re
import threading
import time
from pathlib import Path

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from servogym.drive.canopen.eds import object_dictionary
from servogym.drive.kernel.words import State
from servogym.drive.model.model import load, model_names
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for

MODELS = [name for name in model_names() if "can" in load(name).buses]
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "canopen.md"


def recipe(name):
    """A function of the page."""
    text = PAGE.read_text(encoding="utf-8")
    block = next(b for b in re.findall(r"^```python\n(.*?)^```", text, re.S | re.M) if name in b)
    scope = {}  # of imports and functions only: the rest of the block serves a node of its own
    definitions = re.findall(r"^(?:from|import) [^\n]*|^def .*?(?=^\S|\Z)", block, re.S | re.M)
    exec("\n".join(definitions), scope)
    return scope[name]


def until(condition, seconds=15.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def be_patient(node):
    """A loaded machine is slower than the time limits of the library."""
    node.sdo.RESPONSE_TIMEOUT = 10.0
    for name in dir(node):
        if name.startswith("TIMEOUT_") and name != "TIMEOUT_RESET_FAULT":  # which it sleeps through
            setattr(node, name, 10.0)


@pytest.fixture(params=MODELS)
def served(request):
    """A drive with node-id 5, and the library's node for it, in PRE-OPERATIONAL."""
    model, channel = request.param, f"servogym-402-{request.param}"
    bus = can.Bus(interface="virtual", channel=channel)
    server = Server(bus, [axis_for(model, 5)])
    thread = threading.Thread(target=server.run)
    thread.start()
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # s; it is as long in closing
    network.connect(interface="virtual", channel=channel)
    try:
        node = BaseNode402(5, object_dictionary(model, 5))
        network.add_node(node)
        be_patient(node)
        node.nmt.state = "PRE-OPERATIONAL"
        yield node, server.nodes[0].drive
    finally:
        network.disconnect()
        server.stop()
        thread.join(5)
        bus.shutdown()


@pytest.mark.parametrize("way", ["sdo", "pdo"])
def test_the_library_enables_resets_a_fault_and_moves_as_the_page_says(served, way):
    node, drive = served
    inverter = drive.model.name == "bonfiglioli_act"
    recipe("prepare")(node, drive.model.name, pdo=way == "pdo")
    assert (0x6041 in node.tpdo_pointers) == (way == "pdo"), "what the library uses"
    assert (0x6040 in node.rpdo_pointers) == (way == "pdo")
    until(lambda: node.state == "SWITCH ON DISABLED")
    node.op_mode = "VELOCITY" if inverter else "PROFILED VELOCITY"
    until(lambda: drive.mode == (2 if inverter else 3))
    node.state = "OPERATION ENABLED"
    assert drive.state == State.OPERATION_ENABLED
    node.sdo[0x6042 if inverter else 0x60FF].raw = 300
    until(lambda: abs(float(drive.axis.velocity)) > 0)
    if not inverter:  # which resets a fault 15 s after it came, at the earliest (9.2)
        drive.inject("overvoltage")
        until(lambda: node.state == "FAULT")
        drive.clear_injected()
        node.reset_from_fault()
        assert drive.state == State.OPERATION_ENABLED
    node.state = "SWITCH ON DISABLED"
    until(lambda: drive.state == State.SWITCH_ON_DISABLED)


def test_the_library_homes_every_model_that_can_as_the_page_says(served):
    node, drive = served
    if not drive.model.homing_methods:
        pytest.skip("a frequency inverter does not home")
    recipe("prepare")(node, drive.model.name, pdo=False)
    until(lambda: node.state == "SWITCH ON DISABLED")
    node.sdo[0x6098].raw = drive.model.homes_here
    # on the spot it may see target reached of before its command and take it for an interruption
    assert node.homing(timeout=30) or node.homing(timeout=30)
    assert drive.axis.homed
    assert node.is_homed()
