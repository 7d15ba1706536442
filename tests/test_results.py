"""`servogym results`: the page of what was learned says what the data say."""

import json
import re

import pytest

from servogym.training import cli, results
from servogym.training.policies import SHIPPED


def summary(iqm, low, high):
    return {"mean": iqm, "iqm": iqm, "low": low, "high": high}


def policy(settling, torque=(1, 1, 1), trainings=1):
    values = {
        "settling_time": summary(*settling), "rms_torque": summary(*torque),
        "success": summary(0.5, 0, 1),
    }  # fmt: skip
    return {"summary": values, "trainings": trainings}


def folder(
    path, policies, text="**Where the baseline is better**: see [it](compare.md).\n\nMore.\n"
):
    path = path / "LinearAxis-v0"
    path.mkdir(parents=True)
    data = {"command": "servogym compare ...", "env": "LinearAxis-v0", "policies": policies}
    (path / "compare.json").write_text(json.dumps(data), encoding="utf-8")
    (path / "README.md").write_text("# Learned\n\n" + text, encoding="utf-8")
    return path


def test_the_committed_page_is_what_the_command_writes():
    committed = (SHIPPED / "README.md").read_text(encoding="utf-8")
    assert results.page(SHIPPED) == committed, "run `servogym results`"
    for target in re.findall(r"\]\(([^)#]+)\)", committed):
        assert (SHIPPED / target).is_file(), target


def test_a_row_has_the_best_baseline_and_is_bold_only_where_the_intervals_do_not_meet(tmp_path):
    policies = {
        "hold": policy((0.1, 0.1, 0.1)),
        "slow": policy((3.0, 2.9, 3.1)),
        "fast": policy((2.0, 1.8, 2.2), torque=(0.5, 0.4, 0.6)),
        "learned": policy((1.0, 0.9, 1.1), trainings=5),
    }
    page = results.page(folder(tmp_path / "a", policies).parent)
    assert (
        "| [LinearAxis-v0](#linearaxis-v0), 5 trainings | settling (s) | **1.00 [0.900, 1.10]** | "
        "fast: 2.00 [1.80, 2.20] | 50 %, 50 % | –, – | –, – |\n" in page
    )
    assert "see [it](LinearAxis-v0/compare.md).\n" in page
    assert "fast is better in: rms torque / rated.\n" in page
    assert "More." not in page
    policies["fast"] = policy((2.0, 1.0, 2.2))
    assert "**1.00" not in results.page(folder(tmp_path / "b", policies).parent)


def test_holding_still_counts_where_there_is_no_other_baseline():
    policies = {"hold": policy((2, 2, 2)), "learned": policy((1, 1, 1))}
    assert results.best(policies, "settling_time") == "hold"
    assert results.best(policies | {"x": policy((3, 3, 3))}, "settling_time") == "x"
    with pytest.raises(ValueError, match="no baseline with energy beside 'learned'"):
        results.best(policies, "energy")


def test_what_is_missing_is_one_line_that_names_the_fix(tmp_path, capsys):
    def says(path):
        assert cli.main(["results", str(path)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        return error

    (tmp_path / "none").mkdir()
    assert "has no folder of a task" in says(tmp_path / "none")
    own = folder(tmp_path / "a", {"hold": policy((1, 1, 1))})
    assert "has no policy 'learned', only hold: run `servogym compare" in says(own.parent)
    (own / "compare.json").unlink()
    assert "has no compare.json: write it there with servogym compare" in says(own.parent)
    both = {"ruckig": policy((1, 1, 1)), "learned": policy((1, 1, 1))}
    assert "has no paragraph that begins" in says(folder(tmp_path / "b", both, "Good.").parent)
