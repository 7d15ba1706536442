"""Assignment of PDOs to the sync managers of an EtherCAT drive (CoE 1C12h, 1C13h).

Source: Kollmorgen AKD 5.5, 5.6. One fixed PDO, or up to four flexible ones; the number is written
last, and only a number of 0 opens list and mapping to changes. The process image has the PDOs in
the order of their indices, so a list in another order is refused (inferred).
"""

from typing import TYPE_CHECKING

import numpy as np

from ..abort import Abort
from .hook import Hook

if TYPE_CHECKING:
    from ..objects import ObjectDictionary
    from ..rows import Object

ASSIGNMENTS = (0x1C12, 0x1C13)  # sync manager 2: outputs, 3: inputs
FLEXIBLE = 4  # PDOs of each direction that a master may map; they come first


def _pdos(od: "ObjectDictionary", index: int) -> np.ndarray:
    return od.drive.rpdos if index == ASSIGNMENTS[0] else od.drive.tpdos


def assign(od: "ObjectDictionary", index: int, count: int) -> Abort:
    """Make the first `count` PDOs of a list the process image of its sync manager."""
    pdos = _pdos(od, index)
    known = pdos["cob_id"].tolist()
    wanted = [int(od.slots[index, n + 1].get()) for n in range(count)]
    if any(pdo not in known for pdo in wanted):
        return Abort.INVALID_VALUE
    numbers = [known.index(pdo) for pdo in wanted]
    fixed = any(number >= FLEXIBLE for number in numbers)
    if numbers != sorted(set(numbers)) or (fixed and count > 1):
        return Abort.PARAMETER_INCOMPATIBLE
    pdos["valid"] = 0
    pdos["valid"][numbers] = 1
    od.drive.image_changed()
    return Abort.NONE


def _assignment(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    if row.subindex == 0:
        return assign(od, row.index, value)
    if od.slots[row.index, 0].get():
        return Abort.DEVICE_STATE
    known = _pdos(od, row.index)["cob_id"]
    return Abort.NONE if value == 0 or value in known else Abort.INVALID_VALUE


HOOKS = {"assignment": Hook(_assignment)}
