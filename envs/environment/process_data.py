"""The process data of a task: the objects that its drives exchange with the agent."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...drive.kernel.words import Mode
from ...drive.objects.abort import SdoAbort
from ..engine.rates import interpolation_period
from ..exchange.batch import COMMANDED, REPORTED, image_type, mapping
from ..exchange.faces import PDO

if TYPE_CHECKING:
    from ..exchange.over_port import DriveSide, PortLine

INTERPOLATING = {  # modes in which the drive has to know the period of the set-points, 60C2h
    Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNC_POSITION, Mode.CYCLIC_SYNC_VELOCITY,
    Mode.CYCLIC_SYNC_TORQUE,
}


def mapped(env: Any) -> tuple[np.dtype, np.dtype]:
    """Map the objects of a task in the drives of its agent; -> the RPDO and TPDO image of a drive.

    A task with an interpolating mode also writes its step time to 60C2h. The other drives of the
    machine exchange nothing, since their PDOs would be part of the images.

    Raises:
        ValueError: a drive lacks an object, or refuses the mapping.
    """
    for drive in env.machine.drives.values():
        if drive not in env.drives:
            drive.map_pdos([], [])
    for drive in env.drives:
        rpdo = image_type(drive, [*COMMANDED, *env.RPDO])
        tpdo = image_type(drive, [*REPORTED, *env.TPDO])
        try:
            drive.map_pdos(mapping(rpdo), mapping(tpdo))
        except (SdoAbort, ValueError) as error:
            raise ValueError(f"drive {drive.model.name!r}: {error}") from None
        cyclic = not INTERPOLATING.isdisjoint(env.MODES)
        if cyclic and "interpolation_time_period_value" in drive.objects.names:
            units, index = interpolation_period(env.step_time)
            drive.write("interpolation_time_period_value", units)
            drive.write("interpolation_time_index", index)
    return rpdo, tpdo


def port_line(env: Any, port: "DriveSide", faults: bool) -> "PortLine":
    """Connect an environment that is being built to drives on a bus.

    The same environment with its drives in this process runs one step first. This loads the
    compiled code, so that drives with power do not wait for it.

    Raises:
        ValueError: the task runs in memory only, or `faults` or another action face are wanted.
    """
    from ..exchange.over_port import PortLine

    if env.MEMORY_ONLY:
        raise ValueError(f"port: {env.ID} runs in memory alone: {env.MEMORY_ONLY}")
    if faults or env.face == PDO:
        raise ValueError(
            "port: faults and action='pdo' are for drives in this process; those on a bus are "
            "commanded by set-points, behind a guard"
        )
    images = env._images
    line = PortLine(
        env.machine, env.drive_names, images, [mapping(image) for image in images], env.step_time,
        env.units, port, env.REFERENCED,
    )
    args, arguments = env._arguments
    in_memory = type(env)(*args, **arguments | {"port": None})
    in_memory.reset(seed=0)
    in_memory.step(np.zeros(in_memory.action_space.shape))
    return line
