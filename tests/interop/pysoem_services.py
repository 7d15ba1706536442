"""Mailbox services as an unmodified pysoem uses them, beside `servogym ethercat`."""

import struct

import pysoem
from pysoem_master import opened, read_again, scan_of


def refused(action, *arguments, **options):
    """Class and abort code of what a master is told."""
    try:
        action(*arguments, **options)
    except (pysoem.SdoError, pysoem.MailboxError, pysoem.PacketError, pysoem.WkcError) as error:
        return type(error).__name__, getattr(error, "abort_code", 0)
    return "accepted", 0


def sdo():
    """What is read and refused in PRE_OP."""
    master = opened()
    scan_of(master)
    drive = master.slaves[0]
    result = {
        "name": drive.sdo_read(0x1008, 0, size=4096).decode(),
        "identity": [int.from_bytes(drive.sdo_read(0x1018, n), "little") for n in range(1, 4)],
        "types": [drive.sdo_read(0x1C00, n)[0] for n in range(5)],
        "read_only": refused(drive.sdo_write, 0x6041, 0, struct.pack("<H", 1)),
        "wrong_value": refused(drive.sdo_write, 0x6060, 0, b"\x63"),
        "missing": refused(drive.sdo_read, 0x5FFF, 0),
        "too_long": refused(drive.sdo_write, 0x6060, 0, bytes(4)),
        "accepted": refused(drive.sdo_write, 0x6060, 0, b"\x08"),
        "complete": refused(drive.sdo_read, 0x1C12, 0, ca=True),
    }
    if result["complete"][0] == "accepted":
        result["assignment"] = drive.sdo_read(0x1C12, 0, ca=True).hex()
        written = struct.pack("<BxHH", 2, 0x1600, 0x1601)
        result["written"] = refused(drive.sdo_write, 0x1C12, 0, written, ca=True)
        result["then"] = drive.sdo_read(0x1C12, 0, ca=True).hex()
    master.close()
    return result


def _entries(o):
    """Name, type, bits and access of each; a variable has them itself."""
    entries = o.entries or [o]
    return [[e.name.decode(), e.data_type, e.bit_length, e.obj_access] for e in entries]


def dictionary():
    """SDO information: index, name and entries."""
    master = opened()
    scan_of(master)
    try:
        objects = master.slaves[0].od
        found = [[o.index, o.name.decode(), _entries(o)] for o in objects]
    except pysoem.SdoInfoError as error:
        found = type(error).__name__
    except (pysoem.MailboxError, pysoem.PacketError) as error:
        raise RuntimeError("the dictionary did not go on in time") from error
    master.close()
    return found


def files():
    """The parameter file, read and written back with another value."""
    master = opened()
    scan_of(master)
    drive = master.slaves[0]
    content = drive.foe_read("parameters", 0, 65536)
    if content.startswith(b"{"):
        drive.foe_write("parameters", 0, content)
    master.close()
    if not content.startswith(b"{"):
        raise RuntimeError("the file did not go on in time")  # inferred: what SOEM's buffer held
    return content.decode()


def eeprom():
    """Vendor, product and revision from the EEPROM, and a word that is written."""
    master = opened()
    scan_of(master)
    drive = master.slaves[0]
    words = [drive.eeprom_read(address).hex() for address in (0x08, 0x0A, 0x0C)]
    before = drive.eeprom_read(0x04)
    drive.eeprom_write(0x04, b"\x42\0")
    after = drive.eeprom_read(0x04)
    master.close()
    return {"identity": words, "before": before[:2].hex(), "after": after[:2].hex()}


def lossy(line, times=60):
    """SDO while frames get lost on their way back; -> what was read, and of the first try."""
    import wire

    with wire.forked(["kollmorgen_akd"], [line]):
        master = opened()
        scan_of(master)
        drive = master.slaves[0]
        read, failed = [], []
        for _ in range(times):
            try:
                read.append(drive.sdo_read(0x1008, 0).decode())
            except (pysoem.WkcError, pysoem.MailboxError, pysoem.PacketError) as error:
                failed.append(f"{type(error).__name__} {getattr(error, 'wkc', '')}")
        written = [refused(drive.sdo_write, 0x6065, 0, struct.pack("<I", n)) for n in range(20)]
        last = int.from_bytes(read_again(drive, 0x6065), "little")
        master.close()
    return {"read": read, "failed": failed, "written": written, "last": last}
