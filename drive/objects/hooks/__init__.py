"""What reading or writing an object does beside moving its bytes: `hook` in objects.csv by name.

A write hook sees the value after the checks of type, range and state. It returns NONE to have the
value stored, STORED where that is already done, or the abort code of a refusal. `WHEN` are the
states of the drive a write may need.
"""

from collections.abc import Callable

from ...kernel.statusword import POWERED
from ...model.model import DriveModel
from ...model.plugins import plugin
from ..device import Device
from . import act, ars, ethercat, standard
from .ars import RUNNING
from .hook import Hook

__all__ = ["HOOKS", "WHEN", "Hook", "hook_of"]

WHEN: dict[str, Callable[[Device], bool]] = {
    "disabled": lambda drive: not drive.energised,
    "power_off": lambda drive: not POWERED[drive.axis.state],
    "not_homing": lambda drive: drive.axis.homing not in RUNNING,
}

HOOKS: dict[str, Hook] = standard.HOOKS | ars.HOOKS | act.HOOKS | ethercat.HOOKS


def hook_of(model: DriveModel, name: str) -> Hook:
    """A hook by name: one of these, of the model's folder, or of a package (`model.plugins`).

    Raises LookupError where there is none, ValueError where a folder's is not to be run.
    """
    return HOOKS.get(name) or plugin(model, Hook, name)[0]
