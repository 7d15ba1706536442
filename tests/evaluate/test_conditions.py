"""Off nominal: what a condition sets, what it leaves, and what it tells."""

import json

import pytest

from servogym.envs import FAMILY
from servogym.envs.environment.registry import task
from servogym.training import cli
from servogym.training.evaluate import comparison, conditions, tables
from servogym.training.evaluate.comparison import Request
from servogym.training.evaluate.matrix import matrix
from servogym.training.setup import Setup

TRACKING = task("LinearAxisTracking-v0")
SWAY = task("GantrySway-v0")
AXIS = task("LinearAxis-v0")


def names(kind, drive="generic"):
    return [row.name for row in conditions.suiting(Setup.of(kind, drive))]


def test_a_task_has_the_conditions_that_mean_something_there():
    own = names(TRACKING)
    assert own[0] == "nominal"
    assert {"delay=3", "drive=kollmorgen_akd", "mechanics=toothed_belt", "payload_of_range=1.5"} < {
        *own
    }
    assert "drive=generic" not in own, "that is the nominal one"
    assert "mechanics=rigid" not in own, "that too"
    assert "drive=festo_cmmp_as" not in own, "it has no csp"
    assert "stiffness_of_range=1.5" not in own, "nothing is drawn of it"
    assert not any(name.startswith("mechanics") for name in names(SWAY))
    assert "drive=generic" in names(TRACKING, "kollmorgen_akd")


@pytest.mark.parametrize("table", conditions.TABLES.values(), ids=conditions.TABLES)
def test_names_are_told_apart(table):
    assert len({row.name for row in table}) == len(table)


def test_the_transfer_goes_to_every_drive_with_csp_and_every_mechanics():
    rows = [*conditions.suiting(Setup.of(TRACKING), conditions.TRANSFER)]
    machines = {(row.drive, row.arguments["parameters"]) for row in rows}
    assert machines == {(d, m) for d in ("generic", "kollmorgen_akd") for m in FAMILY}
    assert len(rows) == len(conditions.DISTURBANCES) * len(machines)


def test_a_condition_that_a_policy_does_not_fit_is_a_gap_with_its_reason():
    """pd commands torque, and that drive has no cst."""
    setup, other = Setup.of(AXIS), "drive=kollmorgen_akd"
    rows = conditions.chosen(list(conditions.suiting(setup)), "nominal,drive")
    grid = matrix(Request(setup, ["hold", "pd"], 1), rows)
    assert [*grid.gaps] == [(other, "pd")]
    assert "drive 'kollmorgen_akd' has no mode" in grid.gaps[other, "pd"]
    played = grid.results([job() for job in grid.jobs])
    assert played[other, "hold"].policy == "hold"
    assert (other, "pd") not in played
    with pytest.raises(ValueError, match="'squaring' is for"):
        matrix(Request(setup, ["squaring"], 1), rows)


def test_a_condition_is_the_evaluation_with_these_arguments(tmp_path):
    """By hand: the ranges of the task, and 1.5 times the heaviest payload."""
    arguments = "compare LinearAxisTracking-v0 --policies hold,feed_forward --episodes 2"
    chosen = "--conditions payload_of_range=1.5,delay=1"
    assert cli.main([*arguments.split(), *chosen.split(), "--out", str(tmp_path)]) == 0
    data = json.loads((tmp_path / "conditions.json").read_text(encoding="utf-8"))
    assert data["version"] == conditions.VERSION
    assert [*data["conditions"]] == ["payload_of_range=1.5", "delay=1"]
    by_hand = {"payload": 15.0, "friction": (0.5, 2.0)}
    results = comparison.evaluate(
        "LinearAxisTracking-v0", ["hold", "feed_forward"], "generic", 2, 0, {"randomise": by_hand}
    )
    found = data["conditions"]["payload_of_range=1.5"]
    for result, summary in zip(results, tables.summaries(results)["load_error"], strict=True):
        assert found[result.policy]["summary"]["iqm"] == summary.iqm
    assert found["hold"]["difference"]["value"] > 0.0
    page = (tmp_path / "conditions.md").read_text(encoding="utf-8")
    assert "| payload_of_range=1.5 |" in page
    assert "ahead of feed_forward, of 2" in page
    for name in ("conditions.png", "conditions_curves.png"):
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(("name", "says"), [("wind", "'wind' is unknown here"), (
    "stiffness_of_range", "'stiffness_of_range' is unknown here")])
def test_a_condition_that_does_not_exist_or_suit_is_one_line(name, says, tmp_path, refused):
    arguments = f"compare LinearAxisTracking-v0 --policies hold --conditions {name}"
    assert says in refused([*arguments.split(), "--out", str(tmp_path)])
