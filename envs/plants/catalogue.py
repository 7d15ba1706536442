"""Machines by name, from an MJCF or from a twin, ready to be served: their code is compiled."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ...drive.canopen.frame import Base, Frame
from ...drive.canopen.node import NmtCommand, Node
from ...drive.drive import Drive
from ...drive.ethercat.segment import Segment
from ...drive.ethercat.slave import Slave
from ...drive.machine import Machine as Moved
from ...drive.machine import Standing
from ...drive.model.model import DriveModel, load
from ...drive.model.names import hint
from ..engine.machine import Machine
from . import twins
from .axis_parameters import FAMILY
from .commissioning import commission_joint
from .gantry import Gantry, gantry
from .linear_axis import linear_axis
from .rotary import rotary_axis
from .rotary_parameters import ROTARY_FAMILY

# builders of machines, by the names that a twin stores
BUILDERS: Mapping[str, Callable[..., Machine]] = {
    "linear_axis": linear_axis, "rotary_axis": rotary_axis, "gantry": gantry,
}
# factories by the name of the mechanics, for commands that size, measure and tune
FACTORIES: dict[str, "partial[Machine] | partial[Gantry]"] = {
    **{name: partial(linear_axis, mechanics=name) for name in FAMILY},
    **{name: partial(rotary_axis, mechanics=name) for name in ROTARY_FAMILY},
    "gantry": partial(gantry), "gantry-x1x2": partial(gantry, x_drives=2),
}
# machines to operate, and the positions of their axes at power-on (m)
AXES: dict[str, tuple[Callable[..., Machine], dict[str, float]]] = {
    "linear": (linear_axis, {"x": 0.12}),
    "vertical": (partial(linear_axis, inclination=90, brake_torque=4.0), {"x": 0.12}),
    "rotary-table": (rotary_axis, {"x": 0.5}),  # rad
    "conveyor": (FACTORIES["conveyor"], {"x": 0.5}),
    "gantry": (FACTORIES["gantry"], {"x": 0.1, "y": 0.1, "z": -0.1}),
    "gantry-x1x2": (FACTORIES["gantry-x1x2"], {"x1": 0.1, "x2": 0.101, "y": 0.1, "z": -0.1}),
}


def _held(model: DriveModel) -> Standing:
    """A drive whose motor shaft is held."""
    Drive(model).cycle(0.0)  # compiles the cycle
    return Standing({"x": Drive(model)}, model.cycle_time["position"])


SERVED: dict[str, tuple[Callable[..., Any], dict[str, float]]] = AXES | {"none": (_held, {})}


def of_axis(
    axis: str, drive: str | Path | DriveModel, parameters: Mapping[str, Any] | None = None,
    named: Callable[[str], str] = str,
) -> tuple[Any, dict[str, float]]:
    """Return a commissioned machine, and the positions of its joints at power-on (m or rad).

    Args:
        axis: key of `AXES`; ``none``: a drive whose motor is held.
        drive: drive model by name or folder.
        parameters: keywords of the machine's factory.
        named: returns the name under which the user gave an argument, for error messages.

    Raises ValueError for an unknown model or axis, or arguments that the factory refuses.
    """
    if axis not in SERVED:
        raise ValueError(f"{named('axis')} = {axis!r}: {hint(axis, SERVED)}")
    make, places = SERVED[axis]
    return make(drive, **(parameters or {})), places


def deliver(
    machine: Any, bus: str, places: Mapping[str, float], node_id: int = 0,
    parameter_file: Path | None = None, named: Callable[[str], str] = str,
) -> None:
    """Switch a machine on for a bus: set node-ids, load parameter files, compile its code.

    Args:
        machine: a machine at rest.
        bus: ``can`` or ``ethercat``.
        places: positions of its joints (m or rad), by drive.
        node_id: node-id of its first drive on CAN; that of the last one has to be in 1..127 too.
        parameter_file: file in which a drive stores its parameters; each of several drives has its
            own, with the node-id or its name in the file name.
        named: returns the name under which the user gave an argument, for error messages.

    Raises ValueError for a node-id out of range, or a parameter file in a folder that does not
    exist.
    """
    if parameter_file is not None and not parameter_file.parent.is_dir():
        raise ValueError(
            f"{named('parameter_file')} = {parameter_file}: there is no folder "
            f"{parameter_file.parent}; make it first"
        )
    if bus == "can":
        number_nodes(machine, node_id, named("node_id"))
        warm_up(next(iter(machine.drives.values())).model)
    if parameter_file is not None:
        alone = len(machine.drives) == 1
        for name, drive in machine.drives.items():
            own = f"{drive.node_id if bus == 'can' else name}"
            drive.use_parameter_file(parameter_file if alone else named_for(parameter_file, own))
    if not isinstance(machine, Standing):
        power_on(machine, places)


def axis_for(
    drive: str, node_id: int, axis: str = "linear", parameter_file: Path | None = None
) -> Machine:
    """Return a machine whose drives have node-ids from `node_id` on, see `of_axis`, `deliver`."""
    machine, places = of_axis(axis, load(drive, "can"))
    deliver(machine, "can", places, node_id, parameter_file)
    return machine


def fresh(axis: str, drive: str = "generic", what: str = "axis") -> Machine:
    """Return a commissioned machine in its state at power-on, identical to the bit each time.

    Args:
        axis: key of `AXES`.
        drive: drive model by name or folder.
        what: the name under which the user gave the axis, for error messages.

    Raises ValueError for an unknown model or axis.
    """
    if axis not in AXES:
        raise ValueError(f"{what} = {axis!r}: {hint(axis, AXES)}")
    make, places = AXES[axis]
    machine = make(drive)
    power_on(machine, places)
    return machine


def of_mjcf(
    file: str | Path, joints: Sequence[str], drive: str | Path | DriveModel,
    gears: Mapping[str, float] | None = None,
) -> Machine:
    """A machine from an MJCF with a commissioned drive at each of these joints.

    Raises ValueError as `Machine.from_mjcf` and `commission_joint` do.
    """
    machine = Machine.from_mjcf(file, dict.fromkeys(joints, drive), gears=gears or {})
    for joint in joints:
        commission_joint(machine, joint)
    return machine


def of_twin(folder: str | Path, drive: str | Path | DriveModel | None = None) -> Machine:
    """Return the machine in a folder of `servogym twin`, commissioned and at rest.

    Args:
        folder: folder with a ``twin.json``.
        drive: drive model instead of that of the twin.

    Raises:
        ValueError: the folder has no twin, the twin is damaged, or the drive does not fit.
    """
    found = twins.read(folder)
    return found.machine(BUILDERS[found.builder], drive)


def power_on(machine: Machine, places: Mapping[str, float]) -> None:
    """Deliver a commissioned machine: store its parameters and compile its loop.

    Args:
        machine: a machine at rest.
        places: positions of its joints (m or rad), by drive.
    """
    for drive in machine.drives.values():
        drive.parameters.deliver()
    machine.reset(positions=places)
    machine.step()
    machine.reset(positions=places)


def number_nodes(machine: Machine, node_id: int, what: str) -> None:
    """Give the drives of a machine consecutive node-ids.

    Args:
        machine: a machine on CAN.
        node_id: node-id of the first drive.
        what: source of the number, for the error message.

    Raises ValueError if the first or the last is out of range 1..127.
    """
    last = node_id + len(machine.drives) - 1
    if not 1 <= node_id <= last <= 127:
        raise ValueError(f"{what} = {node_id}: {node_id}..{last} is out of range 1..127")
    for number, drive in enumerate(machine.drives.values(), node_id):
        drive.node_id = number
        drive.reset_communication()


def named_for(parameter_file: Path, own: str) -> Path:
    """Return the parameter file of one of several drives."""
    return parameter_file.with_stem(f"{parameter_file.stem}_{own}")


def ethercat_line(
    models: Sequence[str], axis: str = "linear", *, ring: bool = False
) -> tuple[Segment, list[Moved]]:
    """Return slaves in a line and a machine for each model, with their code compiled.

    Args:
        models: drive models by name or folder; a machine of several axes has a slave for each.
        axis: name of the machine, see `of_axis`.
        ring: the last slave leads back to a second port of the master.

    Raises ValueError for an unknown model or axis, or a model without EtherCAT.
    """
    machines: list[Moved] = []
    for name in models:
        machine, places = of_axis(axis, load(name, "ethercat"))
        deliver(machine, "ethercat", places)
        machines.append(machine)
    slaves = [Slave(drive) for machine in machines for drive in machine.drives.values()]
    segment = Segment(slaves, ring=ring)
    segment.warm_up()
    return segment, machines


def warm_up(drive: str | DriveModel) -> None:
    """Let a node exchange PDOs once, since the first exchange waits seconds for the compiler."""
    node = Node(Drive(drive))
    node.receive(Frame(Base.NMT, bytes([NmtCommand.START, 0])), 0)
    node.receive(Frame(0x201, bytes(8)), 0)
    node.poll(0)
