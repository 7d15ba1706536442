"""`servogym observe --ethercat` at the other end of the wire."""

import struct
import time

import pysoem
import pysoem_master as soem

from servogym.drive.wire.ethercat_observe import observe


def observed():
    return observe(soem.PORT)


def while_in_op():
    """Beside a master that exchanges process data."""
    master = soem.opened()
    soem.to_op(master)
    try:
        observe(soem.PORT)
    except ValueError as error:
        said = str(error)
    wrong = soem.cycle(master, 20)
    state = master.state_check(pysoem.OP_STATE, 50_000)
    master.close()
    return {"error": said, "state": state, "wrong": wrong}


def while_enabled():
    """A drive that somebody has enabled by SDO in PRE_OP."""
    master = soem.opened()
    soem.scan_of(master)
    slave = master.slaves[0]

    def status():
        return struct.unpack("<H", soem.read_again(slave, 0x6041))[0] & 0x6F

    for word in (0x06, 0x07, 0x0F):
        slave.sdo_write(0x6040, 0, struct.pack("<H", word))
        for _ in range(200):
            if status() == soem.COMMANDS.get(word, 0):
                break
            time.sleep(0.005)
    before = status()
    found = observe(soem.PORT)
    after = status()
    state = master.state_check(pysoem.PREOP_STATE, 50_000)
    master.close()
    written = [where for where, one in found["objects"].items() if "write" in one]
    return {"read_only": found["read_only"], "before": before, "after": after, "state": state,
            "written": written}  # fmt: skip
