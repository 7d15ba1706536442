"""What a master is told of a drive that stands although it obeys."""

import pytest

from servogym.drive.master import Master, Timeout
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort


def test_a_drive_that_obeys_and_stands_at_a_limit_switch_is_told_to_look_there():
    """A home offset with the wrong sign: the way to every target leads over the limit switch."""
    machine = linear_axis()
    machine.reset(positions={"x": 0.48})
    master = Master(MachinePort(machine))
    master.enable()
    master.write("home_offset", 480_000)
    master.home(18)
    with pytest.raises(Timeout) as told:
        master.move_to(0.1 + 0.2, timeout=1.0)
    said = str(told.value)
    assert said.startswith("target 0.3: not within")
    assert "limit switches (60FDh)" in said
    for wrong in ("shutdown (0006h)", "enable input", "spring"):  # it has none: that is friction
        assert wrong not in said
