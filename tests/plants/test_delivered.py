"""What is served is commissioned for good: NMT reset node, with which many masters begin."""

import pytest

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.node import Node
from servogym.drive.model.model import load, model_names
from servogym.drive.objects.abort import SdoAbort
from servogym.envs.plants.catalogue import axis_for

CAN = [name for name in model_names() if "can" in load(name).buses]


def parameters(drive):
    """All readable storable objects of a drive, by address."""
    values = {}
    for address, row in drive.model.objects.items():
        if row.storable:
            try:
                values[address] = drive.read(*address)
            except SdoAbort:
                continue
    return values


@pytest.mark.parametrize("file", [False, True])
@pytest.mark.parametrize("model", CAN)
def test_a_reset_node_leaves_the_axis_commissioned_and_takes_back_what_is_not_stored(
    model, file, tmp_path
):
    machine = axis_for(model, 3, parameter_file=tmp_path / "drive.json" if file else None)
    drive = machine.drives["x"]
    node = Node(drive)
    delivered = parameters(drive)
    changed = "acceleration_time" if model == "bonfiglioli_act" else "following_error_window"
    if changed in drive.objects.names:
        drive.write(changed, drive.read(changed) + 1)
    node.receive(Frame(0, bytes([0x81, 3])), 0)
    machine.step(5)
    assert parameters(drive) == delivered
