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


@pytest.mark.slow
def test_the_way_from_a_log_to_the_gap_runs_as_it_is_printed():
    pytest.importorskip("stable_baselines3")
    result = on_the_wire("lesson", "from_a_log_to_the_gap", "forked", short=True, timeout=1800)
    for command, status, said in result["told"]:
        graded = command.startswith("servogym twin ")  # the page says it may be refused: status 1
        assert status in ((0, 1) if graded else (0,)), (command, said)
        assert "Traceback" not in said, (command, said)
        assert "stopped:" not in said, (command, said)
    said = "".join(each for *_, each in result["told"])
    assert "policy: bus - memory, 2 episodes" in said
    assert "policy: bus - twin, 2 episodes" in said
    assert "held-out position error" in said
    assert result["status"] == 0
