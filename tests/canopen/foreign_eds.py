"""What becomes of data sheets of other makers: imported, served, moved by a foreign master.

    python tests/canopen/foreign_eds.py FOLDER > table.md

Each .eds and .dcf of the folder becomes a model, the model a node on a virtual bus with a linear
axis, and an unmodified ``canopen.BaseNode402`` enables it, homes it where the drive can, and moves
it 100 mm in the drive's own position units; the machine says where the axis then stands.
"""

import logging
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import can
import canopen
from canopen.profiles.p402 import BaseNode402

from servogym.drive.canopen.eds import object_dictionary
from servogym.drive.imports.eds import import_eds
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for

DISTANCE = 0.1  # m
TOLERANCE = 1e-3  # m
NODE = 5


@dataclass
class Outcome:
    """Of one file."""

    name: str
    imported: str = ""
    repairs: int = 0
    objects: int = 0
    started: str = ""
    enabled: str = ""
    homed: str = ""
    moved: str = ""
    can_move: bool = True  # it has the objects for it

    def __str__(self) -> str:
        return (f"| {self.name} | {self.imported} | {self.objects} | {self.repairs} | "
                f"{self.started} | {self.enabled} | {self.homed} | {self.moved} |")


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {seconds:g} s")
        time.sleep(0.01)


def outcome(file, place):
    """Import, serve, enable, home, move."""
    found = Outcome(file.name)
    try:
        made = import_eds(file, place / "model")
    except ValueError as error:
        found.imported = str(error).replace(f"{file.parent}/", "")[:120]
        return found
    found.imported, found.repairs, found.objects = "yes", len(made.repairs), made.objects
    bus = can.Bus(interface="virtual", channel=f"foreign-{file.name}")
    try:
        server = Server(bus, [axis_for(str(made.folder), NODE)])
    except Exception as error:
        found.started = f"{type(error).__name__}: {error}"[:160]
        bus.shutdown()
        return found
    found.started = "yes"
    thread = threading.Thread(target=server.run)
    thread.start()
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(interface="virtual", channel=f"foreign-{file.name}")
    try:
        work(found, network, server, made)
    except Exception as error:
        said = f"{type(error).__name__}: {error}"[:160]
        for step in ("enabled", "homed", "moved"):
            if not getattr(found, step):
                setattr(found, step, said)
                break
    finally:
        network.disconnect()
        server.stop()
        thread.join(10)
        bus.shutdown()
    return found


def work(found, network, server, made):
    drive = server.nodes[0].drive
    machine = server.machines[0]
    node = BaseNode402(NODE, object_dictionary(made.folder, NODE))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = node.TIMEOUT_CHECK_TPDO = 10.0
    node.TIMEOUT_SWITCH_STATE_SINGLE = node.TIMEOUT_SWITCH_STATE_FINAL = 10.0
    node.TIMEOUT_SWITCH_OP_MODE = 10.0
    od = node.object_dictionary
    if 0x6502 not in od:
        node.is_op_mode_supported = lambda mode: True
    if 0x6061 not in od or 0x6060 not in od:
        found.can_move = False
    node.nmt.state = "OPERATIONAL"
    until(lambda: node.state == "SWITCH ON DISABLED")
    node.state = "OPERATION ENABLED"
    until(lambda: node.state == "OPERATION ENABLED")
    found.enabled = "yes"
    names = {mode.name for mode in drive.model.modes}
    if "HOMING" not in names or 0x6098 not in od:
        found.homed = "the drive has no homing"
    elif not node.sdo[0x6098].raw:
        found.homed = "homing method 0: none is chosen"
    elif any(node.homing(timeout=40) for _ in range(4)):  # it may look too early, see lesson 7
        # the library is content with target reached, which may be that of before its command
        until(lambda: node.statusword & 0x3400 in (0x1400, 0x2400, 0x2000), 60)
        found.homed = f"method {node.sdo[0x6098].raw}" if drive.axis.homed else drive.describe()
    else:
        found.homed = f"no: {drive.describe()}"
    node.controlword = 0x0F
    unit = server_unit(machine, drive)
    if "PROFILE_POSITION" in names and 0x607A in od and 0x6081 in od:
        node.op_mode = "PROFILED POSITION"
        begin = float(machine.data.qpos[0])
        node.state = "OPERATION ENABLED"
        node.sdo[0x607A].raw = node.sdo[0x6064].raw + round(DISTANCE / unit)
        until(lambda: not node.statusword & 0x1000)
        node.controlword = 0x1F  # new set-point
        until(lambda: node.statusword & 0x1000)
        node.controlword = 0x0F
        until(lambda: node.statusword & 0x1400 == 0x400, 30)
        went = float(machine.data.qpos[0]) - begin
        right = abs(went - DISTANCE) < TOLERANCE + abs(unit)
        found.moved = "100 mm" if right else f"{went * 1e3:.1f} mm of {DISTANCE * 1e3:.0f}"
    else:
        found.can_move = False
        found.moved = f"no pp: {' '.join(sorted(names))}"


def server_unit(machine, drive):
    """One position unit of the drive at the load (m)."""
    number = [*machine.drives.values()].index(drive)
    return float(drive.axis.rad_per_position_unit) / float(machine.couplings[number].gear)


HEAD = """| file | imported | objects | repairs | started | enabled | homed | moved |
|---|---|---|---|---|---|---|---|"""


def main(folder):
    logging.disable(logging.CRITICAL)
    files = sorted(p for p in Path(folder).iterdir() if p.suffix.lower() in (".eds", ".dcf"))
    print(HEAD)
    found = []
    for file in files:
        with tempfile.TemporaryDirectory() as place:
            found.append(outcome(file, Path(place)))
        print(found[-1], flush=True)
    imported = [o for o in found if o.imported == "yes"]
    started = [o for o in imported if o.started == "yes"]
    movable = [o for o in started if o.can_move]
    moved = [o for o in movable if o.moved == "100 mm"]
    print(f"\n{len(files)} files: {len(imported)} imported, {len(started)} started, "
          f"{len(moved)} of {len(movable)} with the objects for it moved 100 mm")


if __name__ == "__main__":
    main(sys.argv[1])
