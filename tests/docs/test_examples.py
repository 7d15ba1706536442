"""Each lesson runs as it stands, draws its picture, and what it teaches is true."""

import re
import runpy
import sys
from pathlib import Path

import pytest
from later import Later

from servogym.drive.kernel.words import State
from servogym.training import cli

matplotlib = Later("matplotlib")
plt = Later("matplotlib.pyplot")
FOLDER = Path(__file__).parents[2] / "examples"
LESSONS = sorted(FOLDER.glob("*.py"))
LONG = ("12_your_machine_in_ten_minutes",)  # a fit in a process of its own

# what a lesson claims, of the names it leaves behind
FACTS = {
    "01_enable_a_drive": lambda g: g["states"][-1] == State.OPERATION_ENABLED,
    "02_why_did_it_refuse": lambda g: g["active"] == ["SOFTWARE_POSITION_MAX"],
    "03_tune_the_cascade": lambda g: 55 < g["commissioned"][0] < 70,  # degree
    "04_home_it": lambda g: g["figures"][17].time < g["figures"][7].time,
    "05_stream_ruckig": lambda g: g["smooth"][0] < g["steps"][0] < g["window"],
    "06_let_a_policy_command_it": lambda g: g["scores"]["Braking"] > 0.6 > g["scores"]["Random"],
    "07_talk_to_it_with_canopen": lambda g: abs(g["reached"] - g["start"] - 30_000) < 50,
    "08_drive_your_own_mjcf": lambda g: g["peaks"]["shoulder"] > g["peaks"]["elbow"],
    "09_talk_to_it_with_ethercat": lambda g: (
        abs(g["places"][-1] - 0.1) < 1e-4 and not g["master"].wrong
    ),
    # a velocity loop with a gain on the distance travels behind by speed over gain
    "10_write_your_own_task": lambda g: (
        [*g["lags"].values()] == pytest.approx([10.0, 0.0], abs=0.3)
    ),
    # CiA 301: value too low; value range
    "11_write_your_own_drive": lambda g: (
        [int(code) >> 8 for code in g["refused"]] == [0x060900] * 2
    ),
    # the twin foretells the torque of the node, and what was learned on it helps the node; the data
    # sheet does neither
    "12_your_machine_in_ten_minutes": lambda g: (
        3 * g["wrong"]["twin"] < g["wrong"]["data sheet"]
        and 3 * g["far"]["twin"] < min(g["far"]["none"], g["far"]["data sheet"])
    ),
}


def test_every_lesson_is_tested_and_listed():
    assert [lesson.stem for lesson in LESSONS] == [*FACTS]
    listed = re.findall(r"\]\((\w+)\.py\)", (FOLDER / "README.md").read_text(encoding="utf-8"))
    assert listed == [*FACTS]


@pytest.mark.parametrize("lesson", LESSONS, ids=lambda lesson: lesson.stem)
def test_a_lesson_begins_with_a_cell_of_text(lesson):
    text = lesson.read_text(encoding="utf-8")
    number = int(lesson.stem[:2])
    assert text.startswith(f"# %% [markdown]\n# # {number} · ")


@pytest.mark.parametrize(
    "lesson",
    [pytest.param(each, marks=[pytest.mark.slow] if each.stem in LONG else []) for each in LESSONS],
    ids=lambda lesson: lesson.stem,
)
def test_a_lesson_draws_its_picture_and_its_claim_holds(lesson, tmp_path, monkeypatch):
    picture = tmp_path / "pictures" / "lesson.png"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(lesson), str(picture)])
    before = matplotlib.get_backend()
    matplotlib.use("Agg")
    try:
        names = runpy.run_path(str(lesson), run_name="__main__")
    finally:
        plt.close("all")
        matplotlib.use(before)
    height, width, _ = plt.imread(picture).shape
    assert width > 600
    assert height > 400
    assert FACTS[lesson.stem](names)


def test_the_log_of_a_lesson_is_what_the_readme_looks_at(tmp_path, monkeypatch, capsys):
    lesson = FOLDER / "07_talk_to_it_with_canopen.py"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(lesson), "run.log", "lesson.png"])
    before = matplotlib.get_backend()
    matplotlib.use("Agg")
    try:
        runpy.run_path(str(lesson), run_name="__main__")
    finally:
        plt.close("all")
        matplotlib.use(before)
    readme = (FOLDER.parent / "README.md").read_text(encoding="utf-8")
    assert f"python examples/{lesson.name} run.log" in readme
    for command in re.findall(r"^servogym (.* run\.log.*|\w+ run\.log)$", readme, re.M):
        assert cli.main(command.split()) == 0, command
    assert "target_reached" in capsys.readouterr().out
    assert Path("out", "scope.csv").is_file()


def test_without_an_argument_the_picture_goes_to_out(tmp_path, monkeypatch):
    lesson = LESSONS[0]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(lesson)])
    runpy.run_path(str(lesson), run_name="__main__")
    assert (tmp_path / "out" / f"{lesson.stem}.png").is_file()
