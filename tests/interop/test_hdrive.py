"""An unmodified SDK of a motor maker commands a served machine with its own master code."""

import math

import pytest
from wire import on_the_wire


def test_the_sdk_of_a_motor_maker_finds_enables_and_moves_a_served_drive():
    pytest.importorskip("hdrive_etc")
    told = on_the_wire("hdrive_master", "moved", "forked")
    assert len(told["found"]) == 1
    assert told["velocity"] == pytest.approx(math.radians(20.0), rel=0.05)
    assert told["turned"]
    true, by_encoder = told["way"]
    assert true == pytest.approx(math.radians(5.0), rel=0.02)
    assert by_encoder == pytest.approx(true, rel=1e-3)
    assert told["sdo"] == 0x20192
    assert told["error"] == 0
    assert told["fault"] == 0x3210
    assert told["end"] != "OPERATION_ENABLED"
