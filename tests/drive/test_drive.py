"""The Python face of a record."""

import numpy as np
import pytest

from servogym.drive import Drive, SdoAbort
from servogym.drive.advice import advice
from servogym.drive.kernel import record
from servogym.drive.kernel.words import command_of
from servogym.drive.model.model import load, model_names


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


@pytest.mark.parametrize("name", model_names())
def test_the_advice_blames_no_bit_that_says_nothing_in_the_model(name):
    """Ready and allowed, whatever the bits of the maker: only the command is missing."""
    drive = Drive(name)
    if name == "bonfiglioli_act":
        drive.write(0x219C, 0, 1)  # 412: the controlword starts it
    for word in (0, 6):
        drive.write("controlword", word)
        drive.cycle(0.0)
        drive.cycle(0.0)
        told = advice(drive.model, drive.read("statusword"), word)
        assert command_of(word).name in told, told


def test_the_advice_names_what_a_bit_means_in_the_model():
    generic, festo, act = (load(n) for n in ("generic", "festo_cmmp_as", "bonfiglioli_act"))
    assert "bit 4" in advice(generic, 0x0221, 15)
    assert "bit 4" not in advice(act, 0x0221, 15)
    assert "bit 4" not in advice(festo, 0x0221, 15)
    assert "I²t" in advice(festo, 0x0A37, 15)
    assert "limit switch" in advice(generic, 0x0A37, 15)


@pytest.mark.parametrize(
    ("call", "arguments"),
    [
        ("write", (0x6040, 0, 1, 2)), ("write", (0x6040,)), ("write", ("controlword",)),
        ("write", ("controlword", 0, 6)), ("read", ("controlword", 3)),
    ],
)
def test_a_call_with_too_many_or_too_few_values_is_refused(call, arguments):
    drive = Drive()
    with pytest.raises(TypeError, match="sub-index"):
        getattr(drive, call)(*arguments)
    assert drive.read("controlword") == 0
