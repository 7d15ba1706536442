"""Mapping of PDOs by the names of objects, as a master does it by SDO (CiA 301, 7.5.2.36)."""

from collections.abc import Iterable
from typing import Any

from ..kernel.process_data import INVALID
from .hooks.ethercat import ASSIGNMENTS, mappable

Lists = Iterable[Iterable[str]] | None


def map_by_name(drive: Any, directions: tuple[Lists, Lists]) -> None:
    """Map objects of a drive, one list a PDO, those it receives and those it sends.

    PDOs without a list go off; a direction without lists stays. On EtherCAT the flexible PDOs are
    mapped and assigned to their sync managers.

    Raises SdoAbort where the drive refuses an entry, ValueError for too many PDOs.
    """
    ethercat = drive.model.bus == "ethercat"
    flexible = mappable(drive.model)
    for pdos, lists, communication, mapping, manager, free in (
        (drive.rpdos, directions[0], 0x1400, 0x1600, ASSIGNMENTS[0], flexible[0]),
        (drive.tpdos, directions[1], 0x1800, 0x1A00, ASSIGNMENTS[1], flexible[1]),
    ):
        if lists is None:
            continue
        wanted = [list(names) for names in lists]
        free = min(free, len(pdos)) if ethercat else len(pdos)
        if len(wanted) > free:
            raise ValueError(f"{len(wanted)} PDOs are wanted, the model has {free} to map")
        if ethercat:
            drive.write(manager, 0, 0)
        for i in range(free):
            cob_id = int(pdos[i].cob_id)  # on EtherCAT the index of the mapping
            place = cob_id if ethercat else mapping + i
            if not ethercat:
                drive.write(communication + i, 1, cob_id | INVALID)
            drive.write(place, 0, 0)
            if i >= len(wanted):
                continue
            for n, name in enumerate(wanted[i]):
                row = drive.objects.slot(name, 0).row
                entry = row.index << 16 | row.subindex << 8 | row.size * 8
                drive.write(place, n + 1, entry)
            drive.write(place, 0, len(wanted[i]))
            if ethercat:
                drive.write(manager, i + 1, place)
            else:
                drive.write(communication + i, 1, cob_id & ~INVALID)
        if ethercat:
            drive.write(manager, 0, len(wanted))
