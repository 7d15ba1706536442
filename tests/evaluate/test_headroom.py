"""The page of what is possible: the bound, the rows as shares of it, and limits kept."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from servogym.training import cli
from servogym.training.evaluate import headroom
from servogym.training.evaluate.metrics import METRICS
from servogym.training.policies import SHIPPED

ROOT = Path(__file__).parents[2]
PLC = SHIPPED / "Commissioning-v0" / "compare.json"


def test_the_share_of_what_is_possible_is_1_at_the_bound_and_less_behind_it():
    low, high = METRICS["settling_time"], METRICS["episode_return"]
    assert headroom.share_of(np.array([[2.0, 4.0]]), np.array([2.0, 1.0]), low).tolist() == [
        [1.0, 0.25]
    ]
    assert headroom.share_of(np.array([[3.0]]), np.array([6.0]), high).tolist() == [[0.5]]
    assert headroom.share_of(np.array([[0.0]]), np.array([0.0]), low).tolist() == [[1.0]]


def test_the_committed_page_is_what_its_command_writes(tmp_path, monkeypatch):
    """From the committed comparisons: nothing is played."""
    committed = (ROOT / "docs" / "results" / "headroom.md").read_text(encoding="utf-8")
    [command] = re.findall(r"^servogym (benchmark headroom .*)$", committed, re.M)
    monkeypatch.chdir(ROOT)
    assert cli.main([*command.split(), "--out", str(tmp_path)]) == 0
    again = (tmp_path / "headroom.md").read_text(encoding="utf-8")
    assert again.splitlines()[:-1] == committed.splitlines()[:-1], f"run servogym {command}"


def test_shares_profile_and_probability_are_those_of_the_episodes(tmp_path):
    """By plain loops over the values of a comparison with several trainings."""
    assert cli.main(["benchmark", "headroom", str(PLC), "--out", str(tmp_path)]) == 0
    page = (tmp_path / "headroom.md").read_text()
    policies = json.loads(PLC.read_text())["policies"]
    time = {name: one["episodes"]["settling_time"] for name, one in policies.items()}
    mean = {name: sum(values) / len(values) for name, values in time.items()}
    rows, cells = (
        {line.split(" | ")[0][2:]: line.split(" | ") for line in part.splitlines()}
        for part in page.split("## Over the tasks")
    )
    for name in time.keys() - {"bound"}:
        assert rows[name][3] == f"{100 * mean['bound'] / mean[name]:.0f} %", name
    shares = {
        name: [time["bound"][i % len(time["bound"])] / value for i, value in enumerate(values)]
        for name, values in time.items()
    }
    for key, name in (("best row", "plc"), ("learned", "learned"), ("best told", "informed_plc")):
        for cell, step in zip(cells[key][1:], (0.2, 0.4, 0.6, 0.8, 0.9), strict=False):
            share = sum(one >= step for one in shares[name]) / len(shares[name])
            assert cell == f"{100 * share:.0f} %", (key, step)
    wins = [(one > two) + 0.5 * (one == two) for one in shares["learned"] for two in shares["plc"]]
    assert f"is {sum(wins) / len(wins):.2f}." in page


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda data: data["policies"].pop("plc"), "lacks 'plc'"),
        (lambda data: data.pop("policies"), "is no comparison"),
        (lambda data: data.update(env="own_module:Task-v0"), "own_module:Task-v0"),
    ],
)
def test_what_is_no_comparison_is_refused(change, says, capsys, tmp_path):
    data = json.loads(PLC.read_text())
    change(data)
    (tmp_path / "compare.json").write_text(json.dumps(data))
    words = ["benchmark", "headroom", str(tmp_path / "compare.json"), "--out", str(tmp_path)]
    assert cli.main(words) == 2
    assert says in capsys.readouterr().err


def test_no_comparison_and_two_of_one_task_are_refused(capsys, tmp_path):
    assert cli.main(["benchmark", "headroom", "--out", str(tmp_path)]) == 2
    assert "name one compare.json" in capsys.readouterr().err
    assert cli.main(["benchmark", "headroom", str(PLC), str(PLC), "--out", str(tmp_path)]) == 2
    assert "already" in capsys.readouterr().err
