"""The calls that move a drive in memory move one behind SOEM."""

import pytest
from wire import on_the_wire


def test_one_master_enables_homes_and_moves_over_soem():
    result = on_the_wire("pysoem_port", "enable_home_and_move", "--drive", "kollmorgen_akd")
    assert result["enabled"] == "OPERATION_ENABLED"
    assert result["places"] == pytest.approx([0.05, 0.15], abs=30e-6)
    assert "(06090030h)" in result["refused"]
    assert result["wrong"] == 0
    assert result["disabled"] == "SWITCH_ON_DISABLED"


def test_a_second_server_on_an_interface_is_refused_and_the_first_one_goes_on():
    status, said = on_the_wire("pysoem_port", "second_server", "--axis", "none")
    assert status == 2
    assert said.startswith("servogym ethercat: interface va is served already")
    assert said.count("\n") == 1
