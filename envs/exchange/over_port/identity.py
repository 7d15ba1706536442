"""Whether the drives on a bus are those that the task describes."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

from ....drive.master.port import Port
from ....drive.objects.abort import SdoAbort
from ...engine.machine import Machine

IDENTITY = ("vendor_id", "product_code")
COMPARED = (  # objects that decide what a task's numbers mean, or when a drive trips
    "following_error_window", "following_error_time_out", "max_profile_velocity", "max_torque",
    "min_position_limit", "max_position_limit", "quick_stop_deceleration",
)


def identify(port: Port, axes: Sequence[str], machine: Machine) -> None:
    """Raise ValueError for a drive whose identity (1018h) is not that of its model."""
    for axis in axes:
        model, own = port.models[axis], machine.drives[axis]
        for name in IDENTITY:
            if name in own.objects.names:
                there, here = port.upload(axis, name), own.read(name)
                if there != here:
                    raise ValueError(
                        f"{axis}: {name} is {there:#x}, of model {model.name!r} it is {here:#x}: "
                        "give the model of the drive that is there"
                    )


def differences(port: Port, axes: Sequence[str], machine: Machine) -> Iterator[str]:
    """Describe the settings in which the drives differ from those that the task has in memory."""
    for axis in axes:
        own = machine.drives[axis]
        for name in COMPARED:
            with suppress(SdoAbort, ValueError):
                there, here = port.upload(axis, name), own.read(name)
                if there != here:
                    yield f"{axis}: {name} is {there:g}, in the task {here:g}"
