"""The unmodified `canopen.BaseNode402`, by SDO, with models that never show FAULT as it expects."""

import threading
import time

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402, OperationMode

from servogym.drive.canopen.eds import object_dictionary
from servogym.drive.kernel.words import State
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for


def until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("model", ["festo_cmmp_as", "metronix_ars2000"])
def test_a_fault_is_reset_by_an_edge_of_bit_7_of_the_controlword(model):
    bus = can.Bus(interface="virtual", channel=f"servogym-{model}")
    server = Server(bus, [axis_for(model, 5)])
    thread = threading.Thread(target=server.run)
    thread.start()
    network = canopen.Network()
    network.connect(interface="virtual", channel=f"servogym-{model}")
    drive = server.nodes[0].drive
    try:
        node = BaseNode402(5, object_dictionary(model, 5))
        network.add_node(node)
        node.nmt.state = "PRE-OPERATIONAL"
        for communication in (0x1400, 0x1800):
            node.sdo[communication][1].raw |= 0x8000_0000
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        # op_mode asks for 6502h, which the CMMP-AS does not have
        node.sdo[0x6060].raw = OperationMode.NAME2CODE["PROFILED VELOCITY"]
        until(lambda: node.op_mode == "PROFILED VELOCITY")
        node.state = "OPERATION ENABLED"
        assert drive.state == State.OPERATION_ENABLED
        drive.inject("overvoltage")
        until(lambda: drive.fault)
        drive.clear_injected()
        until(lambda: node.state == "FAULT REACTION ACTIVE")
        for word in (0x00, 0x80, 0x00):
            node.controlword = word
            time.sleep(0.02)
        until(lambda: node.state == "SWITCH ON DISABLED")
        node.state = "OPERATION ENABLED"
        assert drive.state == State.OPERATION_ENABLED
    finally:
        network.disconnect()
        server.stop()
        thread.join(5)
        bus.shutdown()
