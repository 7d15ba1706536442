"""Further effects of reading or writing an object: the hooks that objects.csv names.

A write hook runs after the checks of type, range and state. It returns NONE to have the value
stored, STORED if that is already done, or the abort code of a refusal. `WHEN` contains the states
of the drive that a write may need.
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
    """A hook by name: from this package, the model's folder, or another package (`model.plugins`).

    Raises LookupError if there is none, ValueError if that of a folder must not run.
    """
    return HOOKS.get(name) or plugin(model, Hook, name)[0]
