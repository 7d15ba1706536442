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
        for _ in range(soem.SCANS):
            try:
                return struct.unpack("<H", slave.sdo_read(0x6041, 0))[0] & 0x6F
            except (pysoem.MailboxError, pysoem.PacketError, pysoem.WkcError):
                time.sleep(0.02)  # late, or of what was asked before
        raise RuntimeError("the statusword did not go on in time")

    for word, reached in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        slave.sdo_write(0x6040, 0, struct.pack("<H", word))
        for _ in range(200):
            if status() == reached:
                break
            time.sleep(0.005)
    before = status()
    found = observe(soem.PORT)
    after = status()
    state = master.state_check(pysoem.PREOP_STATE, 50_000)
    master.close()
    written = [where for where, one in found["objects"].items() if "write" in one]
    return {"read_only": found["read_only"], "before": before, "after": after, "state": state,
            "written": written}
