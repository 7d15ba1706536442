"""What reading or writing an object does beside moving its bytes: `hook` in objects.csv by name.

A write hook sees the value after the checks of type, range and state. It returns NONE to have the
value stored, STORED where that is already done, or the abort code of a refusal. `WHEN` are the
states of the drive a write may need.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

from ..homing import Progress
from . import act, ars, ethercat, standard
from .hook import Hook

if TYPE_CHECKING:
    from ..drive import Drive

__all__ = ["HOOKS", "WHEN", "Hook"]

RUNNING = (Progress.SEARCHING, Progress.STOPPING, Progress.TO_ZERO)

WHEN: dict[str, Callable[["Drive"], bool]] = {
    "disabled": lambda drive: not drive.energised,
    "not_homing": lambda drive: int(drive.axis.homing) not in RUNNING,
}

HOOKS: dict[str, Hook] = standard.HOOKS | ars.HOOKS | act.HOOKS | ethercat.HOOKS
