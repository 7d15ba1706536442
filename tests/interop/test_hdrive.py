"""An unmodified SDK of a motor maker commands a served machine with its own master code."""

import math

import pytest
from wire import on_the_wire

BACKLASH = math.radians(1 / 60)  # of the table's gear; the encoder is at the motor


def test_the_sdk_of_a_motor_maker_finds_enables_and_moves_a_served_drive():
    pytest.importorskip("hdrive_etc")
    told = on_the_wire("hdrive_master", "moved", "forked")
    assert len(told["found"]) == 1
    assert told["velocity"] == pytest.approx(math.radians(20.0), rel=0.05)
    assert told["turned"]
    for degrees in (5, 50):
        true, by_encoder = told[f"{degrees}"]
        assert true == pytest.approx(math.radians(degrees), rel=0.02)
        assert by_encoder == pytest.approx(true, abs=BACKLASH)
    assert told["sdo"] == 0x20192
    assert told["error"] == 0
    assert told["fault"] == 0x3210
    assert told["end"] != "OPERATION_ENABLED"


def test_a_drive_that_expects_set_points_more_often_than_they_come_says_following_error():
    pytest.importorskip("hdrive_etc")
    told = on_the_wire("hdrive_master", "staircase", "forked")
    assert told["period"] == 1  # ms: CiA 402-2 and the drive's default, the SDK leaves it
    assert told["fault"] == 0x8611
    assert abs(told["way"][0]) < math.radians(45.0)
