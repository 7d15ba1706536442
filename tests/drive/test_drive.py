"""The Python face of a record."""

import numpy as np
import pytest

from servogym.drive import Drive, SdoAbort
from servogym.drive.kernel import record


def test_a_drive_without_a_plant():
    drive = Drive("generic")
    torque = drive.cycle(angle=0.0, speed=0.0)
    assert torque == 0.0
    assert drive.state.name == "SWITCH_ON_DISABLED"
    with pytest.raises(SdoAbort):
        drive.write("statusword", 1)


def test_drives_can_share_an_array_and_nothing_else():
    axes = record.make(3)
    drives = [Drive(axes=axes, index=i, node_id=i + 1) for i in range(3)]
    drives[1].write("target_position", 7)
    drives[1].cycle(0.0)
    assert [d.read("target_position") for d in drives] == [0, 7, 0]
    assert drives[0].state.name == "NOT_READY_TO_SWITCH_ON"
    assert np.count_nonzero(axes["cycle_count"]) == 1


def test_the_speed_moves_the_shaft_within_the_cycle():
    drive = Drive()
    drive.cycle(0.0, 100.0)
    assert drive.axis.shaft_angle == pytest.approx(100.0 * 250e-6)


def test_snapshot_and_restore():
    drive = Drive()
    drive.map_pdos([["controlword", "target_torque"]])
    drive.cycle(1.0, 2.0)
    snapshot = drive.snapshot()
    drive.map_pdos([["controlword"]])
    drive.reset()
    drive.restore(snapshot)
    assert drive.rpdo_size == 4
    assert drive.snapshot() == snapshot
    for wrong in (b"", snapshot[:-1], snapshot.replace(b"generic", b"acme"), b"x" * len(snapshot)):
        with pytest.raises(ValueError, match="take a new one"):
            drive.restore(wrong)


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_a_node_id_out_of_range(node_id):
    with pytest.raises(ValueError, match=r"node_id = .* is out of range 1..127"):
        Drive(node_id=node_id)


def test_reset_keeps_parameters_only_when_asked():
    drive = Drive()
    drive.write("profile_velocity", 5)
    drive.write("target_position", 9)
    drive.reset(keep_parameters=True)
    assert drive.read("profile_velocity") == 5
    assert drive.read("target_position") == 0
    drive.reset()
    assert drive.read("profile_velocity") != 5
