"""A linear axis behind each port that its drive model has."""

from servogym.drive.canopen.port import NodePort
from servogym.drive.canopen.remote import CanOpenPort
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.port import EtherCatPort
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.master import Units
from servogym.drive.model.model import load, model_names
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort

MICRO = Units(1e-6, 1e-6, "m")


def memory(machine):
    return MachinePort(machine)


def can(machine):
    return CanOpenPort(NodePort(machine), {"x": 1}, machine.drives["x"].model, units=MICRO)


def can_pdo(machine):
    port = can(machine)
    port.use_pdos()
    return port


def ethercat(machine):
    """Process data move the axis, one period of it a frame."""
    drive = machine.drives["x"]
    master = EtherCatMaster(Bus(Segment([Slave(drive)]), [machine]))
    return EtherCatPort(master, {"x": drive.model}, units=MICRO)


BUSES = {"can": (memory, can, can_pdo), "ethercat": (memory, ethercat)}
CASES = [
    (name, bus, port) for name in model_names() for bus in load(name).buses for port in BUSES[bus]
]


def axis(model, bus):
    """Made for each case, so that nothing is left of another one."""
    machine = linear_axis(load(model, bus))
    machine.reset(positions={"x": 0.12})
    return machine
