"""Machines by name, ready to be served on a field bus: all compiled that they need."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

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
from .gantry import gantry
from .linear_axis import linear_axis
from .rotary import rotary_axis

# what a twin names as that which builds it
BUILDERS: Mapping[str, Callable[..., Machine]] = {
    "linear_axis": linear_axis, "rotary_axis": rotary_axis, "gantry": gantry,
}
# machine by name, and where its axes stand at power-on (m)
AXES: dict[str, tuple[Callable[..., Machine], dict[str, float]]] = {
    "linear": (linear_axis, {"x": 0.12}),
    "vertical": (partial(linear_axis, inclination=90, brake_torque=4.0), {"x": 0.12}),
    "rotary-table": (rotary_axis, {"x": 0.5}),  # rad
    "conveyor": (partial(rotary_axis, mechanics="conveyor"), {"x": 0.5}),
    "gantry": (gantry, {"x": 0.1, "y": 0.1, "z": -0.1}),
    "gantry-x1x2": (partial(gantry, x_drives=2), {"x1": 0.1, "x2": 0.101, "y": 0.1, "z": -0.1}),
}


def axis_for(
    drive: str, node_id: int, axis: str = "linear", parameter_file: Path | None = None
) -> Machine:
    """A machine whose drives have node-ids from `node_id` on, with all compiled that it needs.

    Args:
        drive: drive model by name or folder.
        node_id: of the first drive; 1..127 has to hold for the last one too.
        axis: key of `AXES`.
        parameter_file: where a drive stores its parameters; of several drives each has its own,
            with the node-id in its name.

    Raises ValueError: unknown model or axis, one without CAN, node-id out of range, no folder for
        the parameter file.
    """
    if axis not in AXES:
        raise ValueError(f"--axis = {axis!r}: {hint(axis, AXES)}")
    if parameter_file is not None and not parameter_file.parent.is_dir():
        raise ValueError(
            f"--parameter-file = {parameter_file}: there is no folder {parameter_file.parent}; "
            "make it first"
        )
    make, places = AXES[axis]
    machine = make(load(drive, "can"))
    number_nodes(machine, node_id, "--node-id")
    if parameter_file is not None:
        alone = len(machine.drives) == 1
        for x in machine.drives.values():
            x.use_parameter_file(parameter_file if alone else named(parameter_file, x.node_id))
    power_on(machine, places)
    warm_up(drive)
    return machine


def fresh(axis: str, drive: str = "generic") -> Machine:
    """A commissioned machine where it stands at power-on, the same bits each time.

    Args:
        axis: key of `AXES`.
        drive: model or folder.

    Raises ValueError: unknown model or axis.
    """
    if axis not in AXES:
        raise ValueError(f"axis = {axis!r}: {hint(axis, AXES)}")
    make, places = AXES[axis]
    machine = make(drive)
    power_on(machine, places)
    return machine


def of_twin(folder: str | Path, drive: str | Path | DriveModel | None = None) -> Machine:
    """The machine in a folder of `servogym twin`, commissioned and at rest.

    Args:
        folder: with a ``twin.json``.
        drive: a model in place of the twin's own.

    Raises:
        ValueError: there is no twin in it, it is damaged, or the drive does not fit.
    """
    found = twins.read(folder)
    return found.machine(BUILDERS[found.builder], drive)


def power_on(machine: Machine, places: Mapping[str, float]) -> None:
    """Hand over a commissioned machine: its parameters are stored, its loop is compiled.

    Args:
        machine: at rest.
        places: of its joints (m or rad), by drive.
    """
    for drive in machine.drives.values():
        drive.parameters.deliver()
    machine.reset(positions=places)
    machine.step()
    machine.reset(positions=places)


def number_nodes(machine: Machine, node_id: int, what: str) -> None:
    """Give the drives of a machine consecutive node-ids.

    Args:
        machine: whose drives are on CAN.
        node_id: of the first drive.
        what: where the number comes from, for the error message.

    Raises ValueError where the first or the last is out of range 1..127.
    """
    last = node_id + len(machine.drives) - 1
    if not 1 <= node_id <= last <= 127:
        raise ValueError(f"{what} = {node_id}: {node_id}..{last} is out of range 1..127")
    for number, drive in enumerate(machine.drives.values(), node_id):
        drive.node_id = number
        drive.reset_communication()


def named(parameter_file: Path, node_id: int) -> Path:
    """The parameter file of one of several drives."""
    return parameter_file.with_stem(f"{parameter_file.stem}_{node_id}")


def machines_for(
    drive: str, node_ids: Sequence[int], axis: str, parameter_file: Path | None = None
) -> list[Machine]:
    """A machine for each node-id; a drive of two axes has the next node-id for its second one."""
    machines = []
    axes = load(drive, "can").axes
    several = len(node_ids) * axes > 1
    for node_id in node_ids:
        for _ in range(axes):
            file = parameter_file
            if file is not None and several and axis in ("linear", "vertical"):
                file = named(file, node_id)
            machines.append(axis_for(drive, node_id, axis, file))
            node_id += len(machines[-1].drives)
    served = [x.node_id for machine in machines for x in machine.drives.values()]
    if len(set(served)) != len(served):
        raise ValueError(f"--node-id {[*node_ids]}: the nodes would be {served}, some twice")
    return machines


def ethercat_line(
    models: Sequence[str], axis: str = "linear", *, ring: bool = False
) -> tuple[Segment, list[Moved]]:
    """Slaves in a line with a machine for each model, with all compiled that they need.

    Args:
        models: drive models by name or folder; a machine of several axes has a slave for each.
        axis: key of `AXES`; ``none``: drives whose motor is held.
        ring: the last slave leads back to a second port of the master.

    Raises ValueError: unknown model or axis, a model without EtherCAT.
    """
    if axis not in (*AXES, "none"):
        raise ValueError(f"--axis = {axis!r}: {hint(axis, [*AXES, 'none'])}")
    machines: list[Moved] = []
    drives: list[Drive] = []
    for name in models:
        model = load(name, "ethercat")
        if axis == "none":
            Drive(model).cycle(0.0)  # the first one compiles
            drives.append(Drive(model))
            machines.append(Standing({"x": drives[-1]}, model.cycle_time["position"]))
            continue
        make, places = AXES[axis]
        machine = make(model)
        power_on(machine, places)
        machines.append(machine)
        drives += machine.drives.values()
    segment = Segment([Slave(drive) for drive in drives], ring=ring)
    segment.warm_up()
    return segment, machines


def warm_up(drive: str | DriveModel) -> None:
    """Let a node move its PDOs once: the first one would wait seconds for the compiler."""
    node = Node(Drive(drive))
    node.receive(Frame(Base.NMT, bytes([NmtCommand.START, 0])), 0)
    node.receive(Frame(0x201, bytes(8)), 0)
    node.poll(0)
