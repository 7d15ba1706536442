"""What `servogym deploy` refuses of drives that are served in another process, before power."""

import subprocess
import sys

import can
from deployed import CAN, _network, _rows, machine_served

ONLY = (-(2**31), 2**31 - 1)  # of 607Dh: no position limits
OTHER_MODEL = {"can": "festo_cmmp_as", "ethercat": "kollmorgen_akd"}
BUS = {
    "can": ["-i", CAN["interface"], "-c", CAN["channel"]], "ethercat": ["--ethercat", "vb"],
}
CLOCK = {"can": "real", "ethercat": "frame"}
AXIS = {"bus": "bus", "axis": "linear"}
LIMITS = dict(zip(("min_position_limit", "max_position_limit"), ONLY, strict=True))
NO_SPEED = {"max_profile_velocity": 2**32 - 1, "max_motor_speed": 2**32 - 1}
TASK = {"bus": "bus", "task": "LinearAxis-v0"}
# the machine, options of the command, and which buses it is about
CASES = {
    "not homed": (TASK, [], ("can", "ethercat")),
    "no position limits": (
        AXIS | {"write": {"x": LIMITS}}, ["--home", "17"], ("can", "ethercat"),
    ),
    "another drive": (AXIS, ["--home", "17"], ("can", "ethercat")),
    "another task's policy": (TASK, ["--home", "17", "--policy", "search"], ("can", "ethercat")),
    "no such homing method": (TASK, ["--home", "99"], ("can", "ethercat")),
    "no velocity limit": (AXIS | {"write": {"x": NO_SPEED}}, ["--home", "17"], ("can", "ethercat")),
    "another SYNC": (TASK, ["--home", "17"], ("can",)),
    "another node": (TASK, ["--home", "17", "--node-id", "9"], ("can",)),
    "two nodes for one drive": (TASK, ["--node-id", "1", "--node-id", "2"], ("can",)),
    "a second drive": (TASK | {"task": "GantryContour-v0"}, ["--home", "17"], ("ethercat",)),
}


def refusals(bus):
    """Status, words and states of the drives for each case."""
    _network()
    told = {}
    for case, (machine, options, buses) in CASES.items():
        if bus not in buses:
            continue
        rows = _rows("", bus, CLOCK[bus])
        rows["machine"]["axis"] = machine | ({"node_id": 1} if bus == "can" else {})
        if case == "another drive":
            rows["machine"]["axis"]["drive"] = OTHER_MODEL[bus]
        with machine_served(rows) as ask:
            if case == "another SYNC":
                _wait_for_another_sync()
            told[case] = _deployed(bus, options, lambda: [state for state, *_ in ask("look")])
    told["nobody"] = _deployed(bus, ["--home", "17"], list)
    return told


def _wait_for_another_sync():
    """Another master has left the node with a SYNC of its own (1005h)."""
    with can.Bus(fd=False, **CAN) as bus:
        data = bytes.fromhex("2305100081000000")
        bus.send(can.Message(arbitration_id=0x601, data=data, is_extended_id=False))
        while bus.recv(5.0).data[0] != 0x60:
            pass


def _deployed(bus, options, look):
    command = [sys.executable, "-m", "servogym.training.cli", "deploy", "LinearAxis-v0", "--yes",
               *BUS[bus], *options]
    seen = set()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        while process.poll() is None:
            seen |= {*look()}
        output, error = process.communicate()
    return {"status": process.returncode, "output": output, "error": error,
            "states": sorted(seen | {*look()})}
