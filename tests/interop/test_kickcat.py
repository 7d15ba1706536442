"""KickCAT, as it comes from PyPI, against `servogym ethercat` on a veth pair."""

import pytest
from wire import on_the_wire

NAMES = {
    "kollmorgen_akd": ("AKD-P00606-NBCC-E000", [6, 6]),
    "generic": ("servogym generic CiA 402 drive", [7, 7]),
}


@pytest.mark.parametrize("model", NAMES)
def test_31_kickcat_reaches_op_and_every_working_counter_is_right(model):
    """On a ring: with one port alone its time-out has to be so short that a busy machine misses it.

    It waits for the second port, too, some 200 times until the slaves are found.
    """
    check(model, ports=2)


@pytest.mark.slow
@pytest.mark.parametrize("model", NAMES)
def test_31_kickcat_reaches_op_at_the_end_of_a_line(model):
    check(model, second="")


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["dc", "real"])
def test_kickcat_reaches_op_on_the_clocks_of_the_wall(clock):
    """It knows no distributed clocks; a thousand cycles as quick as it can, each checked."""
    check("generic", clock, ports=2)


def check(model, clock="frame", **more):
    options = ("--drive", model, "--axis", "none", "--slaves", "2", "--clock", clock)
    result = on_the_wire("kickcat_master", "reach_op", *options, **more)
    name, sizes = NAMES[model]
    assert result["slaves"] == 2
    assert result["sizes"] == [sizes, sizes]
    assert result["states"] == [8, 8]
    assert result["name"] == name
    assert "SUCCESS" not in result["missing"]
