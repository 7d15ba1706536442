"""The lesson from a log to a policy on the machine: its commands run, and the twin foretells."""

import pytest
from wire import on_the_wire


def check(result):
    for command, status, said in result["told"]:
        assert status == 0, (command, said)
        assert "Traceback" not in said, (command, said)
    sheet, twin = (result["gaps"][name] for name in ("sheet", "gap"))
    for metric in ("peak_error", "rms_torque"):
        assert abs(twin[metric]["difference"]) < 0.5 * abs(sheet[metric]["difference"]), metric
        assert twin[metric]["low"] < twin[metric]["high"]
    assert result["status"] == 0


@pytest.mark.slow
def test_the_commands_of_the_lesson_run_as_printed_and_the_twin_foretells_the_machine():
    check(on_the_wire("lesson", "of_the_page", "forked", timeout=600))


def test_a_step_chain_that_plans_with_ruckig_runs_by_the_same_command():
    pytest.importorskip("ruckig")
    result = on_the_wire("lesson", "of_an_own_program", "forked")
    ((_, status, said),) = result["told"]
    assert status == 0, said
    assert said.count(", success, 200 steps") == 3, said
    assert result["status"] == 0
