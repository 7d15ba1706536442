"""The unmodified `canopen.BaseNode402` against the served node over python-can's virtual bus."""

import threading
import time

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from servogym.training.eds import object_dictionary
from servogym.training.node import Server, axis_for


@pytest.fixture
def node(request):
    interface = getattr(request, "param", "virtual")
    channel = {"virtual": f"servogym-{id(request)}", "udp_multicast": "239.74.163.77"}
    arguments = {"interface": interface, "channel": channel[interface]}
    try:
        bus = can.Bus(**arguments)
    except (OSError, can.CanError) as error:
        pytest.skip(f"{interface} does not work here: {error}")
    server = Server(bus, [axis_for("generic", 5)])
    thread = threading.Thread(target=server.run)
    thread.start()
    network = canopen.Network()
    network.connect(**arguments)
    node = BaseNode402(5, object_dictionary("generic", 5))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 2.0
    for limit in ("STATE_FINAL", "STATE_SINGLE", "OP_MODE"):
        setattr(node, f"TIMEOUT_SWITCH_{limit}", 5.0)  # a loaded test machine is no slow drive
    try:
        yield node
    finally:
        network.disconnect()
        server.stop()
        thread.join(5)
        bus.shutdown()


def until(condition, seconds=15.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_an_unmodified_master_enables_homes_moves_and_resets(node):
    assert node.sdo["manufacturer_device_name"].raw == "servogym generic CiA 402 drive"
    node.nmt.state = "PRE-OPERATIONAL"
    node.sdo[0x1800][5].raw = 50  # ms; the library waits for a TPDO also where nothing changes
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    until(lambda: node.state == "SWITCH ON DISABLED")
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        node.state = state
        assert node.state == state
    for mode in ("PROFILED VELOCITY", "PROFILED TORQUE", "HOMING", "CYCLIC SYNCHRONOUS POSITION"):
        node.op_mode = mode
        assert node.op_mode == mode
    node.sdo[0x6098].raw = 34
    node.sdo[0x6099][2].raw = 50_000
    assert node.homing(timeout=10)
    node.op_mode = "PROFILED POSITION"
    node.state = "OPERATION ENABLED"
    target = node.sdo[0x6064].raw + 30_000
    node.sdo[0x607A].raw = target
    node.sdo[0x6040].raw = 0x0F
    until(lambda: not node.sdo[0x6041].raw & 0x1000)
    node.sdo[0x6040].raw = 0x1F
    until(lambda: abs(node.sdo[0x6064].raw - target) <= 20 and node.sdo[0x6041].raw & 0x400)
    node.state = "SWITCH ON DISABLED"
    node.state = "OPERATION ENABLED"


# On this bus every member hears its own frames; the library then takes its RPDO for a periodic one
# and stops sending it, so its state machine is not used here.
@pytest.mark.parametrize("node", ["udp_multicast"], indirect=True)
def test_a_master_in_another_member_of_a_multicast_group(node):
    for word, status in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        node.sdo[0x6040].raw = word
        until(lambda status=status: node.sdo[0x6041].raw & 0x6F == status)
    assert node.sdo["manufacturer_device_name"].raw == "servogym generic CiA 402 drive"
