"""`servogym results --costs`: every committed result with its command and what that took."""

import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from servogym.training import cli
from servogym.training.evaluate import costs, repeat

ROOT = Path(__file__).parents[2]
TWO_HOURS = 2 * 3600  # s, of two cores


def test_the_committed_page_is_what_the_command_writes():
    kept = json.loads((ROOT / costs.PAGE).with_suffix(".json").read_text(encoding="utf-8"))
    page = costs.page(ROOT, costs.results(ROOT), kept)
    assert page == (ROOT / costs.PAGE).read_text(encoding="utf-8"), "run `servogym results --costs`"


def test_all_committed_results_are_listed_with_a_command_that_exists():
    found = costs.results(ROOT)
    files = {one.file for one in found}
    files |= {Path(file).with_suffix(".md").as_posix() for file in files}  # data beside a page
    for pattern in ("docs/results/*.md", "assets/policies/*/compare.json"):
        listed = {path.relative_to(ROOT).as_posix() for path in ROOT.glob(pattern)}
        assert listed - {costs.PAGE.as_posix()} <= files, pattern
    for command in {one.command for one in found if one.command.startswith("servogym ")}:
        cli.parser(command.split()[1])


def test_what_was_measured_and_the_trainings_take_less_than_two_hours_of_two_cores():
    kept = json.loads((ROOT / costs.PAGE).with_suffix(".json").read_text(encoding="utf-8"))
    trained = repeat.plan(ROOT / "assets" / "policies", Path("out"))
    total = sum(one["cpu_seconds"] for one in kept.values())
    assert total + sum(one.cpu_seconds for one in trained) <= TWO_HOURS * repeat.CORES


def test_a_page_that_a_command_or_a_test_writes_names_it():
    """Written by hand are those that nothing in the checkout writes."""
    commands = {Path(one.file).stem: one.command for one in costs.results(ROOT)}
    by_hand = {"attempts", "costs", "foreign_eds", "learned", "panel"}
    assert {name for name, command in commands.items() if not command} == by_hand
    for name, command in commands.items():
        scripts = re.findall(r"tests/\S+\.py", command)
        assert bool(scripts) == ("python" in command)
        assert all((ROOT / script).is_file() for script in scripts), name
    sources = "".join(p.read_text("utf-8") for p in (ROOT / "tests").rglob("*.py"))
    for name in by_hand:
        assert not re.search(rf'PAGE = .*"{name}\.md"', sources), name


def test_the_rows_of_a_campaign_state_what_they_took(tmp_path):
    lines = ("| CPU (s) | reached |", "| ---: | ---: |", "| 1.5 | yes |", "| 2.0 | no |")
    page = "# Tuning\n\n| other |\n| --- |\n| 5 |\n\n" + "\n".join(lines) + "\n\nEnd.\n"
    (tmp_path / "page.md").write_text(page, encoding="utf-8")
    (tmp_path / "rows.jsonl").write_text('{"cpu": 4.0}\n{"cpu": 0.5}\n{}\n', encoding="utf-8")
    commands = "python play.py page.md", "python play.py rows.jsonl page.md", "", "servogym"
    took = [costs.in_rows(tmp_path, costs.Result("page.md", command)) for command in commands]
    assert took == [3.5, 8.0, 0.0, 0.0]


COMMAND = "servogym compare LinearAxis-v0 --policies hold --drive generic --episodes 1 --seed 0"


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A small one, with a page made by a command; commands run in this process."""
    def here(words, cwd):
        with monkeypatch.context() as patch:
            patch.chdir(cwd)
            return SimpleNamespace(returncode=cli.main(words[3:]))

    monkeypatch.setattr(costs.subprocess, "run", here)
    policies = tmp_path / "assets" / "policies"
    shutil.copytree(ROOT / "assets" / "policies" / "Homing-v0", policies / "Homing-v0")
    (policies / "Homing-v0" / "compare.json").unlink()
    shutil.copy(ROOT / "assets" / "policies" / "tuned.json", policies)
    pages = tmp_path / costs.PAGE.parent
    assert cli.main([*COMMAND.split()[1:], "--out", str(pages)]) == 0
    (pages / "compare.json").unlink()
    (pages / "by_hand.md").write_text("# By hand\n", encoding="utf-8")
    return tmp_path


def test_a_result_is_repeated_measured_and_compared(checkout, capsys):
    page = checkout / costs.PAGE
    line = rf"\| `docs/results/compare.md` \| `{re.escape(COMMAND)}` \| "
    assert cli.main(["results", str(checkout), "--costs"]) == 0
    assert re.search(line + "not measured", page.read_text(encoding="utf-8"))
    assert "| `docs/results/by_hand.md` | – | written by hand |" in page.read_text("utf-8")
    assert cli.main(["results", str(checkout), "--costs", "policies hold"]) == 0
    assert re.search(line + r"[\d.]+ \| [\d.]+ \| yes \|", page.read_text(encoding="utf-8"))
    made = checkout / "docs" / "results" / "compare.md"
    made.write_text(made.read_text("utf-8").replace("LinearAxis", "Linear", 1), encoding="utf-8")
    assert cli.main(["results", str(checkout), "--costs", "policies hold"]) == 0
    assert re.search(line + r"[\d.]+ \| [\d.]+ \| no \|", page.read_text(encoding="utf-8"))


def test_words_of_no_command_and_no_checkout_are_refused(checkout, tmp_path, capsys):
    assert cli.main(["results", str(checkout), "--costs", "nothing like it"]) == 2
    assert "no command of a committed result" in capsys.readouterr().err
    assert cli.main(["results", str(checkout / "assets"), "--costs"]) == 2
    assert "name the folder of a checkout" in capsys.readouterr().err
