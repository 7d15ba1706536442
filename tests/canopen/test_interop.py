"""The unmodified `canopen.BaseNode402`, with its own time limits, against the served node."""

import os
import threading
import time

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402, OperationMode

from servogym.drive.canopen.eds import object_dictionary
from servogym.drive.kernel.words import State
from servogym.drive.model.model import load
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for

# What drives send: EMCY, TPDO and SDO answers have bit 7 of the identifier, and error control. On a
# multicast group every member hears its own frames too, and the library takes the echo of its RPDO
# for a periodic PDO of somebody else and does not send it any more. A filter of the user's bus
# keeps the echoes away.
FROM_DRIVES = [{"can_id": 0x080, "can_mask": 0x080}, {"can_id": 0x700, "can_mask": 0x780}]
PORT = 20_000 + os.getpid() % 20_000  # one port, one bus, whatever the group; pytest -n has several
BUSES = {
    "virtual": {"channel": "servogym-interop"},
    "udp_multicast": {"channel": "239.74.163.77", "port": PORT, "can_filters": FROM_DRIVES},
}


def by_sdo(node):
    """No PDO: the library does everything by SDO."""
    for communication in (0x1400, 0x1800):
        node.sdo[communication][1].raw |= 0x8000_0000


def by_event(node):
    """The default mapping, sent on change; the library also waits where nothing changes."""
    node.sdo[0x1800][5].raw = 20  # ms


def by_event_with_modes(node):
    """Modes of operation in the PDOs, mapped by the library."""
    for pdo, objects in ((node.rpdo[1], (0x6040, 0x6060)), (node.tpdo[1], (0x6041, 0x6061))):
        pdo.read()
        pdo.clear()
        for index in objects:
            pdo.add_variable(index)
    node.tpdo[1].event_timer = 20
    node.rpdo[1].save()
    node.tpdo[1].save()


def by_sync(node):
    """The TPDO at each SYNC of the library."""
    node.sdo[0x1800][2].raw = 1
    node.network.sync.start(0.01)


@pytest.fixture(params=BUSES)
def network(request):
    """A served drive with node-id 5, and the library's network on another member of its bus."""
    arguments = {key: value for key, value in BUSES[request.param].items() if key != "can_filters"}
    try:
        bus = can.Bus(interface=request.param, **arguments)
    except (OSError, can.CanError) as error:
        pytest.skip(f"{request.param} does not work here: {error}")
    server = Server(bus, [axis_for("generic", 5)])
    thread = threading.Thread(target=server.run)
    thread.start()
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # s; it is as long in closing
    network.connect(interface=request.param, **BUSES[request.param])
    try:
        yield network, next(iter(server.machines[0].drives.values()))
    finally:
        network.sync.stop()
        network.disconnect()
        server.stop()
        thread.join(5)
        bus.shutdown()


@pytest.fixture(params=[by_sdo, by_event, by_event_with_modes, by_sync], ids=lambda f: f.__name__)
def node(request, network):
    """The library's node, with its own time limits, OPERATIONAL and ready to switch on."""
    network, drive = network
    node = BaseNode402(5, object_dictionary("generic", 5))
    network.add_node(node)
    node.drive = drive
    node.nmt.state = "PRE-OPERATIONAL"
    request.param(node)
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    until(lambda: node.state == "SWITCH ON DISABLED")
    return node


def until(condition, seconds=15.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


TO = {
    "SWITCH ON DISABLED": ["SWITCH ON DISABLED"],
    "READY TO SWITCH ON": ["READY TO SWITCH ON"],
    "SWITCHED ON": ["SWITCHED ON"],
    "QUICK STOP ACTIVE": ["OPERATION ENABLED", "QUICK STOP ACTIVE"],
}


def test_the_library_enables_from_every_state(node):
    node.sdo[0x605A].raw = 6
    for state, way in TO.items():
        for target in way:
            node.state = target
        assert node.drive.describe().split()[1] == state.replace(" ", "_")
        node.state = "OPERATION ENABLED"
        assert node.drive.state == State.OPERATION_ENABLED


def test_the_library_resets_a_fault(node):
    node.state = "OPERATION ENABLED"
    node.drive.inject("external")
    until(lambda: node.state == "FAULT")
    node.drive.clear_injected()
    node.reset_from_fault()
    assert node.drive.state == State.OPERATION_ENABLED


def test_the_library_switches_all_modes_the_model_has(node):
    modes = [name for name in OperationMode.NAME2CODE if node.is_op_mode_supported(name)]
    assert len(modes) == 1 + len(load("generic").modes)  # and NO MODE
    for mode in modes:
        node.op_mode = mode
        assert node.drive.mode == OperationMode.NAME2CODE[mode]
        assert node.op_mode == mode


def test_the_library_homes_and_the_axis_moves(node):
    node.sdo[0x6098].raw = 34
    node.sdo[0x6099][2].raw = 50_000
    # the library may see a statusword of before its command, target reached and homing not yet
    # attained, and take it for an interruption; where there is one, asked again it is still there
    assert node.homing(timeout=60) or node.homing(timeout=60)
    assert node.is_homed()
    node.controlword = 0x0F  # in time: two RPDOs of one position cycle make no edge of bit 4
    node.op_mode = "PROFILED POSITION"
    node.state = "OPERATION ENABLED"
    target = node.sdo[0x6064].raw + 30_000
    node.sdo[0x607A].raw = target
    until(lambda: not node.statusword & 0x1000)
    node.controlword = 0x1F
    until(lambda: node.statusword & 0x1000)
    node.controlword = 0x0F
    until(lambda: node.check_statusword() & 0x1400 == 0x400)
    assert abs(node.sdo[0x6064].raw - target) <= 1456  # 6067h
