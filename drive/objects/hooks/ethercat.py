"""Objects of an EtherCAT drive: assignment of PDOs (1C12h, 1C13h), synchronisation (1C32h, 1C33h).

Assignment: Kollmorgen AKD 5.5, 5.6, unless ethercat.toml says otherwise: one fixed PDO, or up to
four flexible ones; the number is written last, and only a number of 0 opens list and mapping to
changes. The process image has the PDOs in their order in pdo.csv, so a list in another order is
refused (inferred), as is every change while process data are exchanged (ETG.1000.6: in PRE_OP
only), and PDOs that exclude one another (ETG.2000, Exclude).

Synchronisation: ETG.1020, tables of 1C32h and 1C33h; both show the same, as outputs and inputs are
exchanged at the same moment.
"""

from collections.abc import Mapping

import numpy as np

from ...model.model import DriveModel
from ...model.rows import Object
from ..abort import Abort
from ..device import Dictionary
from .hook import Hook

ASSIGNMENTS = (0x1C12, 0x1C13)  # sync manager 2: outputs, 3: inputs


def mappable(model: DriveModel) -> tuple[int, int]:
    """Number of RPDOs and TPDOs that a master may map; they come first."""
    return (0, 0) if model.ethercat is None else model.ethercat.mappable


def excluded(model: DriveModel, manager: int) -> Mapping[int, frozenset[int]]:
    """For each PDO of an assignment object (1C12h, 1C13h), those it cannot be assigned with."""
    ethercat, direction = model.ethercat, ASSIGNMENTS.index(manager)
    if ethercat is None:
        return {}
    indices = [int(pdo.cob_id, 0) for pdo in (model.rpdos, model.tpdos)[direction]]
    apart = {index: set(ethercat.excludes.get(index, ())) for index in indices}
    if ethercat.fixed_alone:
        for index in indices[ethercat.mappable[direction] :]:
            apart[index].update(indices)
    return {
        index: frozenset(n for n in indices if n != index and (n in own or index in apart[n]))
        for index, own in apart.items()
    }


def _pdos(od: Dictionary, index: int) -> np.ndarray:
    return od.drive.rpdos if index == ASSIGNMENTS[0] else od.drive.tpdos


def assign(od: Dictionary, index: int, count: int) -> Abort:
    """Make the first `count` PDOs of a list the process image of its sync manager."""
    pdos = _pdos(od, index)
    known = pdos["cob_id"].tolist()
    wanted = [int(od.slots[index, n + 1].get()) for n in range(count)]
    if any(pdo not in known for pdo in wanted):
        return Abort.INVALID_VALUE
    numbers = [known.index(pdo) for pdo in wanted]
    apart = excluded(od.drive.model, index) if count > 1 else {}
    if numbers != sorted(set(numbers)) or any(apart.get(pdo, set()) & {*wanted} for pdo in wanted):
        return Abort.PARAMETER_INCOMPATIBLE
    pdos["valid"] = 0
    pdos["valid"][numbers] = 1
    od.drive.image_changed()
    return Abort.NONE


def _assignment(od: Dictionary, row: Object, value: int) -> Abort:
    if od.drive.model.ethercat is None:
        return Abort.NONE  # without effect on another bus
    if od.drive.operational:
        return Abort.DEVICE_STATE
    if row.subindex == 0:
        return assign(od, row.index, value)
    if od.slots[row.index, 0].get():
        return Abort.DEVICE_STATE
    known = _pdos(od, row.index)["cob_id"]
    return Abort.NONE if value == 0 or value in known else Abort.INVALID_VALUE


MINIMUM_CYCLE = 0x05  # of 1C32h and 1C33h


def _synchronisation(od: Dictionary, row: Object) -> int:
    """Read an entry of 1C32h or 1C33h; 0 if the drive is not on EtherCAT."""
    if row.subindex == MINIMUM_CYCLE:
        ethercat = od.drive.model.ethercat
        return 0 if ethercat is None else ethercat.cycle_ns
    return int(od.drive.synchronisation().get(row.subindex, 0))


HOOKS = {
    "assignment": Hook(_assignment),
    "synchronisation": Hook(read=_synchronisation),
}
