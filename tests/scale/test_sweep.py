"""Sweeps: a row a cell, as the comparison of that cell says; the same bytes by whom ever."""

import csv
import json

import pytest

from servogym.training import cli
from servogym.training.evaluate.comparison import evaluate
from servogym.training.evaluate.tables import summaries


def rows(folder):
    lines = (folder / "sweep.csv").read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if line[0] != "#"))


def test_a_grid_has_a_row_a_cell_and_each_is_the_comparison_of_that_cell(tmp_path):
    command = "sweep LinearAxis-v0 --policies hold,ruckig --seeds 0,1 --episodes 2"
    vary = ["--vary", "payload=2,8.5", "--conditions", "delay=3"]
    for folder, more in (("alone", []), ("two", ["--workers", "2"])):
        assert cli.main([*command.split(), *vary, "--out", str(tmp_path / folder), *more]) == 0
    for name in ("sweep.csv", "sweep.json", "sweep.md"):
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    found = rows(tmp_path / "alone")
    assert len(found) == 2 * 2 * 2
    assert {row["condition"] for row in found} == {"delay=3"}
    (row,) = (
        row for row in found
        if (row["payload"], row["seed"], row["policy"]) == ("8.5", "1", "ruckig")
    )
    by_hand = {"payload": 8.5, "randomise": {"delay": 3.0}}
    results = evaluate("LinearAxis-v0", ["ruckig"], "generic", 2, 1, by_hand)
    (summary,) = summaries(results)[row["metric"]]
    assert float(row["value"]) == summary.iqm
    assert not (tmp_path / "alone" / "jobs").exists()
    page = (tmp_path / "alone" / "sweep.md").read_text(encoding="utf-8")
    assert "--vary payload=2,8.5" in page
    assert "policy = ruckig" in page


def test_what_does_not_exist_in_a_grid_is_left_out_with_its_reason(tmp_path, capsys):
    command = "sweep LinearAxis-v0 --policies hold --episodes 1 --drives generic,festo_cmmp_as"
    assert cli.main([*command.split(), "--out", str(tmp_path)]) == 0
    data = json.loads((tmp_path / "sweep.json").read_text(encoding="utf-8"))
    assert len(data["rows"]) == 1
    assert "has no mode cyclic_sync" in data["left_out"][0]


def test_a_study_asks_where_the_best_was_found_and_workers_do_not_change_it(tmp_path):
    pytest.importorskip("optuna", reason="pip install 'servogym[sweep]'")
    command = "sweep LinearAxis-v0 --policies ruckig --episodes 1 --trials 3"
    vary = ["--vary", "payload=1.0..20.0:log"]
    for folder, more in (("alone", []), ("two", ["--workers", "2"])):
        assert cli.main([*command.split(), *vary, "--out", str(tmp_path / folder), *more]) == 0
    assert (tmp_path / "alone/sweep.csv").read_bytes() == (tmp_path / "two/sweep.csv").read_bytes()
    found = rows(tmp_path / "alone")
    assert [row["trial"] for row in found] == ["0", "1", "2"]
    assert all(1.0 <= float(row["payload"]) <= 20.0 for row in found)


@pytest.mark.slow
def test_trainings_over_hyper_parameters_leave_their_policies(tmp_path):
    pytest.importorskip("stable_baselines3")
    command = "sweep LinearAxis-v0 --train PPO --steps 8192 --seeds 1 --episodes 2"
    vary = ["--vary", "learning_rate=0.001,0.0001"]
    assert cli.main([*command.split(), *vary, "--workers", "2", "--out", str(tmp_path)]) == 0
    found = rows(tmp_path)
    assert [row["learning_rate"] for row in found] == ["0.001", "0.0001"]
    for row in found:
        assert (tmp_path / "trained" / row["policy"] / "weights.npz").is_file()


@pytest.mark.parametrize(("command", "says"), [
    ("sweep LinearAxis-v0", "give either --policies"),
    ("sweep LinearAxis-v0 --policies hold --vary payload=1..2", "--vary payload is a range"),
    ("sweep Moon-v0 --policies hold", "unknown environment 'Moon-v0'"),
    ("sweep LinearAxis-v0 --policies nobody", "policy 'nobody' is unknown"),
    ("sweep LinearAxis-v0 --policies hold --seeds a", "--seeds: 'a' is not a whole number"),
    ("sweep LinearAxis-v0 --policies hold --vary weight=3", "see the arguments of"),
    ("sweep LinearAxis-v0 --policies hold --trials 2", "--trials has nothing to look for"),
])
def test_a_mistake_of_a_sweep_is_one_line(command, says, tmp_path, refused):
    assert says in refused([*command.split(), "--out", str(tmp_path)])
