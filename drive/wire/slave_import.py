"""Makes a drive model from a connected EtherCAT slave."""

from pathlib import Path

from ..imports.ethercat import Imported, Source, import_source, unpacked
from ..model.made import check_place
from .soem import SoemMaster

ASKED = {0x0000: 9, 0x0140: 2, 0x0502: 1}  # registers: address and bytes


def import_slave(interface: str, folder: Path, *, position: int = 0) -> Imported:
    """Make a drive model from a connected slave, which is taken to PRE_OP and not written to.

    Args:
        interface: such as ``eth0``; needs pysoem and permission for raw sockets.
        folder: of the model; must not exist, or be empty.
        position: of the slave on the segment, from 0 on.

    Raises:
        ValueError: no such slave. ImportError, ConnectionError: as `SoemMaster`.
    """
    check_place(folder)
    master = SoemMaster(interface)
    try:
        slaves = master.scan()
        if not 0 <= position < len(slaves):
            raise ValueError(f"-i {interface}: {len(slaves)} slaves answer, none at {position}")
        slave = slaves[position]
        image = slave.read_sii()
        device = unpacked(image, Path(f"{interface}, slave {position}"))
        found = [*slave.objects()]
        registers = {address: slave.read(address, size) for address, size in ASKED.items()}
    finally:
        master.close()
    notes = [
        "Slave controller: registers 0000h-0008h, 0140h and 0502h as read from the slave.",
        "Defaults are the values the slave had when it was asked." if found else
        "The slave has no SDO information, so its dictionary is unknown.",
    ]
    return import_source(
        Source(device, f"slave {position} on {interface}", "servogym drives --from-slave",
               registers, notes, f"vendor {device.vendor_id:08X}h", found, image=image),
        folder, Path(interface),
    )
