"""The page of what is possible: the bound, the rows as shares of it, and limits kept."""

import numpy as np

from servogym.envs.tasks.commissioning import CommissioningEnv
from servogym.training import cli
from servogym.training.evaluate import headroom
from servogym.training.evaluate.metrics import METRICS


def test_the_share_of_what_is_possible_is_1_at_the_bound_and_less_behind_it():
    low, high = METRICS["settling_time"], METRICS["episode_return"]
    assert headroom.share_of(np.array([[2.0, 4.0]]), np.array([2.0, 1.0]), low).tolist() == [
        [1.0, 0.25]
    ]
    assert headroom.share_of(np.array([[3.0]]), np.array([6.0]), high).tolist() == [[0.5]]
    assert headroom.share_of(np.array([[0.0]]), np.array([0.0]), low).tolist() == [[1.0]]


def test_the_command_writes_page_and_values_and_no_row_is_above_100_percent(tmp_path, capsys):
    words = ["benchmark", "headroom", "--tasks", "Commissioning-v0", "--episodes", "2"]
    assert cli.main([*words, "--out", str(tmp_path)]) == 0
    page = (tmp_path / "headroom.md").read_text()
    assert "Mean bound (proven)" in page
    shares = [
        float(cell.removesuffix(" %"))
        for line in page.splitlines() if line.count("|") == 10 and " % |" in line
        for cell in line.split(" | ")[3:4]
    ]
    rows = (tmp_path / "headroom.csv").read_text().splitlines()
    played = {line.split(",")[1] for line in rows if line.startswith("Commissioning-v0,")}
    assert played == {"hold", "random", "learned", *CommissioningEnv.POLICIES}
    assert len(shares) == len(played - {"bound"})
    assert max(shares) <= 100.0
    assert any(line.startswith("Commissioning-v0,plc,0,1,settling_time,") for line in rows)


def test_a_task_without_a_bound_is_refused(capsys, tmp_path):
    words = ["benchmark", "headroom", "--tasks", "RotaryAxis-v0", "--out", str(tmp_path)]
    assert cli.main(words) == 2
    assert "no bound is known" in capsys.readouterr().err
