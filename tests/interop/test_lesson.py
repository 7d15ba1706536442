"""A program of the user's own, as the page on deployment prints it, commands a served machine."""

import pytest
from wire import on_the_wire


def test_a_step_chain_that_plans_with_ruckig_runs_by_the_same_command():
    pytest.importorskip("ruckig")
    result = on_the_wire("lesson", "of_an_own_program", "forked")
    ((_, status, said),) = result["told"]
    assert status == 0, said
    assert said.count(", success, 200 steps") == 3, said
    assert result["status"] == 0
