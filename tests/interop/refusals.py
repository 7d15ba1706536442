"""What `servogym deploy` refuses of drives that are served in another process, before power."""

import subprocess
import sys

import can
from deployed import CAN, _network, _rows, machine_served

BUS = {
    "can": ["-i", CAN["interface"], "-c", CAN["channel"]], "ethercat": ["--ethercat", "vb"],
}
CLOCK = {"can": "real", "ethercat": "frame"}
AXIS, TASK = {"axis": "linear"}, {"task": "LinearAxis-v0"}
OTHER_MODEL = {"can": "festo_cmmp_as", "ethercat": "kollmorgen_akd"}
OPEN = {"x": {"min_position_limit": -(2**31), "max_position_limit": 2**31 - 1}}  # none (607Dh)
UNLIMITED = {"x": {"max_profile_velocity": 2**32 - 1, "max_motor_speed": 2**32 - 1}}
HOMED = ["--home", "17"]
BOTH = ("can", "ethercat")
# the machine, options of the command, the buses, and what the error says
CASES = {
    "not homed": (TASK, [], BOTH, "x is not referenced: home it with --home METHOD"),
    "no position limits": (AXIS | {"write": OPEN}, HOMED, BOTH, r"\(607Dh\), or give .*--limits"),
    "no velocity limit": (AXIS | {"write": UNLIMITED}, HOMED, BOTH, "6080h.*--max-velocity"),
    "another drive": (AXIS, HOMED, BOTH, "vendor_id is .* give the model of the drive that is the"),
    "another task's policy": (
        TASK, [*HOMED, "--policy", "search"], BOTH, "'search' is for servogym/Homing-v0: .* choose",
    ),
    "no such homing method": (TASK, ["--home", "99"], BOTH, "--home 99: .* has the methods .*17"),
    "another SYNC": (TASK, HOMED, ("can",), r"the SYNC 81h \(1005h\): set it to 80h"),
    "another node": (TASK, [*HOMED, "--node-id", "9"], ("can",), "node 9.*check its node-id"),
    "two nodes for a drive": (
        TASK, ["--node-id", "1", "--node-id", "2"], ("can",), "--node-id: 2 are given for .* x",
    ),
}
NOBODY = {"can": "node 1.* no answer .*check its node-id", "ethercat": "0 slaves answer.*check int"}


def refusals(bus):
    """Status, words and states of the drives for each case."""
    _network()
    told = {}
    for case, (machine, options, buses, _) in CASES.items():
        if bus not in buses:
            continue
        rows = _rows("", bus, CLOCK[bus])
        rows["machine"]["axis"] = {"bus": "bus"} | machine
        if bus == "can":
            rows["machine"]["axis"]["node_id"] = 1
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
