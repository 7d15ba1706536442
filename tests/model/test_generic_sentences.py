"""What newer drives of CiA 402-2 have, by object."""

import pytest

from conftest import Shaft
from servogym.drive.drive import Drive


@pytest.mark.parametrize(("probe", "edge"), [(1, 0), (1, 1), (2, 0), (2, 1)])
def test_60d5h_to_60d8h_count_the_edges_that_are_stored(probe, edge):
    shaft = Shaft()
    counter = 0x60D5 + 2 * (probe - 1) + edge
    bits = (1 | 2 | (0x20 if edge else 0x10)) << 8 * (probe - 1)  # continuous
    shaft.write(touch_probe_function=bits)
    shaft.step(2)
    for expected in range(1, 4):
        for level in (1, 0):
            shaft.axis.touch_probe[probe - 1] = level
            shaft.step(2)
        assert shaft.drive.read(counter) == expected
    others = {0x60D5, 0x60D6, 0x60D7, 0x60D8} - {counter}
    assert [shaft.drive.read(other) for other in others] == [0, 0, 0]


def test_60fch_is_the_demand_in_increments():
    shaft = Shaft()
    shaft.write(feed=1000)
    shaft.angle = 3.0
    shaft.step(3)
    assert shaft.drive.read(0x60FC) == pytest.approx(shaft.drive.read(0x6063), abs=1)
    assert abs(shaft.drive.read(0x60FC)) > 100 * abs(shaft.drive.read(0x6062))


def test_67feh_60c5h_60c6h_and_10f1h_are_there():
    drive = Drive()
    assert drive.read(0x67FE) == 0x0003_0000
    drive.map_pdos([["controlword", "max_acceleration"]], [["touch_probe_1_positive_edge_counter"]])
    assert "max_deceleration" in drive.objects.names
    assert Drive(bus="ethercat").read(0x10F1, 0) == 2
