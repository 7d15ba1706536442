"""`servogym results`: the page of what was learned says what the data say."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from servogym.envs import ON_MODELS, TASKS
from servogym.envs.environment.registry import task
from servogym.training import cli
from servogym.training.evaluate import compare, results, tuner
from servogym.training.evaluate.metrics import metrics
from servogym.training.evaluate.tables import best, differences, summaries
from servogym.training.policies import POLICIES, SHIPPED


def summary(iqm, low, high):
    return {"mean": iqm, "iqm": iqm, "low": low, "high": high}


def policy(settling, torque=(1, 1, 1), trainings=1, **differences):
    values = {
        "settling_time": summary(*settling), "rms_torque": summary(*torque),
        "success": summary(0.5, 0, 1),
    }
    rows = {
        metric: dict(zip(("value", "low", "high"), row, strict=True))
        for metric, row in differences.items()
    }
    return {"summary": values, "trainings": trainings, "differences": rows}


def folder(
    path,
    policies,
    against="fast",
    text="**Where the baseline is better**: see [it](compare.md).\n\nMore.\n",
):
    path = path / "LinearAxis-v0"
    path.mkdir(parents=True)
    data = {
        "command": "servogym compare ...", "env": "LinearAxis-v0", "policies": policies,
        "against": against,
    }
    (path / "compare.json").write_text(json.dumps(data), encoding="utf-8")
    (path / "README.md").write_text("# Learned\n\n" + text, encoding="utf-8")
    return path


def test_the_committed_page_is_what_the_command_writes():
    committed = (SHIPPED / "README.md").read_text(encoding="utf-8")
    assert results.page(SHIPPED) == committed, "run `servogym results assets/policies`"
    for target in re.findall(r"\]\(([^)#]+)\)", committed):
        assert (SHIPPED / target).is_file(), target


PAGES = Path(__file__).parents[2] / "docs" / "results"
COMPARED = [
    path for path in (*sorted(SHIPPED.glob("*/compare.json")), *sorted(PAGES.glob("*.json")))
    if "policies" in json.loads(path.read_bytes())
]
NAMES = [path.parent.name if path.stem == "compare" else path.stem for path in COMPARED]


def test_every_task_has_a_committed_comparison_and_a_section_on_the_page_of_headroom():
    ids = sorted(kind.ID for kind in (*TASKS, *ON_MODELS))
    assert sorted(task(json.loads(path.read_bytes())["env"]).ID for path in COMPARED) == ids
    page = (PAGES / "headroom.md").read_text(encoding="utf-8")
    assert sorted(f"servogym/{name}" for name in re.findall(r"^## (\w+-v\d): ", page, re.M)) == ids


def evaluations(path):
    """The data of a comparison, and its results as they were before they were written."""
    return json.loads(path.read_text(encoding="utf-8")), [*compare.read(path)[1].values()]


@pytest.mark.parametrize("path", COMPARED, ids=NAMES)
def test_the_pairs_on_a_committed_page_are_those_of_its_data(path):
    data, found = evaluations(path)
    metric = task(data["env"]).METRIC
    text = compare._pairs_page(found, data["against"], metric, metrics(task(data["env"]))[metric])
    assert text in path.with_suffix(".md").read_text(encoding="utf-8")


@pytest.mark.parametrize("path", COMPARED, ids=NAMES)
def test_a_committed_comparison_has_every_kind_of_row(path):
    """Doing nothing, chance, three of motion control, one tuned, one told, the limit, learning."""
    _, found = evaluations(path)
    names = {one.policy for one in found}
    rivals = {n for n in names & POLICIES.keys() if not POLICIES[n].informed} - {"hold", "random"}
    assert {"hold", "random", "bound"} <= names
    assert len(rivals) >= 3
    assert rivals & (tuner.FITTED.keys() | set(tuner.offered()))
    assert any(POLICIES[name].informed for name in names & POLICIES.keys() - {"bound"})
    why = "**Why there is no row `learned`.**"
    assert "learned" in names or why in path.with_suffix(".md").read_text(encoding="utf-8")


@pytest.mark.parametrize("path", COMPARED, ids=NAMES)
def test_no_row_of_a_committed_comparison_is_above_its_bound_in_any_episode(path):
    data, found = evaluations(path)
    [bound] = (one for one in found if one.policy == "bound")
    compared = 0
    for metric, limit in bound.values.items():
        if metric == "score" or not np.isfinite(limit).any():
            continue
        sign = -1.0 if bound.metrics[metric].better == "low" else 1.0
        for one in (one for one in found if one is not bound and metric in one.values):
            apart = sign * (one.by_training(metric) - limit)
            faulted = np.array([fault != "" for fault in one.faults]).reshape(apart.shape)
            assert not (apart[~faulted] > 1e-9).any(), (one.policy, metric)
            compared += apart.size
    assert compared >= 6 * len(data["seeds"])


@pytest.mark.slow
@pytest.mark.parametrize("path", COMPARED, ids=NAMES)
def test_the_tables_of_a_committed_page_are_those_of_its_data(path):
    data, found = evaluations(path)
    metric = task(data["env"]).METRIC
    table, names = summaries(found), [one.policy for one in found]
    against = best(table, names, metric, metrics(task(data["env"]))[metric].better)
    assert against == data["against"]
    page = path.with_suffix(".md").read_text(encoding="utf-8")
    for name, columns in table.items():
        cells = " | ".join(compare._cell(name, one) for one in columns)
        assert f" | {cells} |" in page, name
    apart = differences(found, against)
    assert compare._sections(["metric", *names], found, table, apart, against, metric) in page


def test_a_row_is_bold_only_where_the_paired_difference_leaves_0_out(tmp_path):
    learned = {"settling_time": (-1.0, -1.2, -0.8), "rms_torque": (0.5, 0.4, 0.6)}
    policies = {
        "slow": policy((3.0, 2.9, 3.1)),
        "fast": policy((2.0, 1.8, 2.2), torque=(0.5, 0.4, 0.6)),
        "learned": policy((1.0, 0.9, 1.1), trainings=5, **learned),
    }
    page = results.page(folder(tmp_path / "a", policies).parent)
    assert (
        "| [LinearAxis-v0](#linearaxis-v0), 5 trainings | settling (s) | 1.00 [0.900, 1.10] | "
        "fast: 2.00 [1.80, 2.20] | **-1.00 [-1.20, -0.800]** | – | – | – | – | 50 %, 50 % | –, – | "
        "–, – |\n"
    ) in page
    assert "see [it](LinearAxis-v0/compare.md).\n" in page
    assert "fast is better in: rms torque / rated.\n" in page
    assert "More." not in page
    learned["settling_time"] = (-1.0, -2.0, 0.1)
    policies["learned"] = policy((1.0, 0.9, 1.1), trainings=5, **learned)
    assert "**-1.00" not in results.page(folder(tmp_path / "b", policies).parent)


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
    both = {
        "ruckig": policy((1, 1, 1)),
        "learned": policy((1, 1, 1), settling_time=(0, 0, 0)),
    }
    alone = folder(tmp_path / "c", {"learned": policy((1, 1, 1))}, against="learned")
    assert "has no baseline with settling_time beside 'learned'" in says(alone.parent)
    bare = folder(tmp_path / "b", both, "ruckig", "Good.")
    assert "has no paragraph that begins" in says(bare.parent)
