"""The machines of a machine file, made and compiled."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ...drive.drive import Drive
from ...drive.machine import Standing
from ...drive.model.model import DriveModel, load
from ..engine.machine import Machine
from ..environment.registry import task
from ..plants.catalogue import deliver, of_axis
from ..plants.commissioning import commission_joint
from .description import MachineRow, model_of

COMMUNICATION = range(0x1000, 0x2000)  # indices of the communication profile (CiA 301)


def made(
    row: MachineRow, bus: str, folder: Path, named: Callable[[str], str] = str
) -> tuple[Machine, dict[str, float]]:
    """Make a machine, compile what it needs, and return it with its positions at power-on.

    Args:
        row: of the machine.
        bus: ``can`` or ``ethercat``.
        folder: that relative paths start from.
        named: see `Description.named`.

    Raises:
        ValueError, TypeError, OSError: a field of the row cannot be used.
    """

    def model(name: str) -> DriveModel:
        return load(model_of(folder, name), bus)

    if row.task:
        machine, places = _of_task(row, model(str(row.drive)))
    elif row.mjcf:
        assert isinstance(row.drive, dict)
        machine = Machine.from_mjcf(
            folder / row.mjcf, {joint: model(str(name)) for joint, name in row.drive.items()}
        )
        for name in machine.drives:
            commission_joint(machine, name)
        places = {}
    else:
        machine, places = of_axis(row.axis, model(str(row.drive)), row.parameters, named)
    places = places | row.positions
    for name, values in row.write.items():
        if not isinstance(values, dict):
            raise ValueError(f"write: name the drive, as {{ x = {{ {name} = {values!r} }} }}")
        for object_name, value in values.items():
            drive = machine.drives[name]
            drive.write(object_name, value)
            if drive.model.number(object_name).index in COMMUNICATION:
                raise ValueError(
                    f"write: {object_name} belongs to the communication profile, which a drive "
                    "resets when it boots: let the master write it"
                )
    file = folder / row.parameter_file if row.parameter_file else None
    deliver(machine, bus, places, row.node_id, file, named)
    return machine, places


def _of_task(row: MachineRow, model: DriveModel) -> tuple[Machine, dict[str, float]]:
    """Make the machine of an environment without random draws, at its first episode's start."""
    env = task(row.task)(model, **{"randomise": {}} | row.parameters)
    machine, delivered = env.machine, env.machine.snapshot()
    env.reset(seed=0)
    places = {name: joint(machine, drive, "qpos") for name, drive in machine.drives.items()}
    machine.restore(delivered)
    return machine, places


def check_node_ids(machines: Mapping[str, Machine]) -> None:
    """Raise ValueError for two drives with one node-id."""
    of: dict[int, str] = {}
    for name, machine in machines.items():
        for own, drive in machine.drives.items():
            if other := of.get(drive.node_id):
                raise ValueError(
                    f"node-id {drive.node_id} is that of {other} and {name}.{own}: give each "
                    "machine a node_id of its own"
                )
            of[drive.node_id] = f"{name}.{own}"


def coupling(machine: Machine, drive: Drive) -> Any:
    """Return the joint of a drive in its machine. Raises ValueError for one whose motor is held."""
    if isinstance(machine, Standing):
        raise ValueError("axis = 'none': its motor is held, no joint moves")
    return machine.couplings[[*machine.drives.values()].index(drive)]


def joint(machine: Machine, drive: Drive, what: str) -> float:
    """Return ``qpos`` or ``qvel`` of a drive's joint (m or rad, per s). Raises as `coupling`."""
    place = coupling(machine, drive).dof
    if what == "qpos":
        place = machine.model.jnt_qposadr[machine.model.dof_jntid[place]]
    return float(getattr(machine.data, what)[place])
