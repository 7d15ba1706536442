"""The commands of docs/how-to/twin.md, as printed, one after the other in an empty folder."""

import csv
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import test_coarse

from servogym.drive.wire.recording import Source

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/twin.md").read_text(encoding="utf-8")
SHORT = {  # what is added to a printed command that goes on for hours
    "train": ["--steps", "3000"], "compare": ["--episodes", "3"],
}
STATE, ENABLED = 0x6F, 0x27  # of the statusword
ELSEWHERE = ("panel",)  # tests/panel/test_panel_twin.py has it in a browser, beside a node


def blocks(kind):
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.M | re.S)


def commands():
    """The printed commands, a list of words each."""
    text = "".join(blocks("sh")).replace("\\\n", " ")
    return [shlex.split(line, comments=True) for line in text.splitlines()]


def scope(log, file):
    """A log as the table of an oscilloscope that is started when the axis is enabled."""
    signals = Source(log, "generic").signals("1")
    names = ("target_position", "position_actual_value", "torque_actual_value")
    on = signals["statusword"]
    at = signals[names[1]].time
    at = at[at > on.time[on.value.astype(int) & STATE == ENABLED][0]]
    sent = signals[names[0]]  # a set-point holds until the next one
    asked = sent.value[np.maximum(np.searchsorted(sent.time, at, side="right") - 1, 0)]
    place, torque = (np.interp(at, signals[name].time, signals[name].value) for name in names[1:])
    with file.open("w", newline="") as out:
        rows = zip(1e3 * at, 1e-3 * asked, 1e-3 * place, 1.27e-3 * torque, strict=True)
        csv.writer(out).writerows([("t", "demand", "actual", "torque"), *rows])


def run(words, done=(0,)):
    """A command of the page; -> what it says."""
    program, *rest = words
    if program == "python":
        start = [sys.executable, str(ROOT / rest[0])]
    else:
        assert program == "servogym"
        start = [sys.executable, "-m", "servogym.training.cli", rest[0]]
    told = subprocess.run(
        [*start, *rest[1:], *SHORT.get(rest[0], [])], capture_output=True, text=True, check=False,
        env=os.environ | {"COLUMNS": "200"})
    assert told.returncode in done, (words, told.stdout[-2000:], told.stderr[-2000:])
    return told.stdout


def test_each_command_of_the_page_is_one_that_is_played():
    kinds = {words[1] for words in commands() if words[0] == "servogym"}
    assert kinds == {"twin", "replay", "compare", "train", "tune", *ELSEWHERE}


@pytest.mark.slow
def test_the_page_is_walked_as_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    later = []
    for words in commands():
        if words[1] in ELSEWHERE:
            continue
        if "scope.csv" in words or "steps.csv" in words:  # tables; the lines below have them
            later.append(words)
            continue
        if "new.log" in words:  # of the same node, some time later
            run(["python", "examples/machines/hidden_axis.py", "plan.csv", "new.log"])
        said = run(words)
        if "--against" in words:
            assert "no change is certain" in said
        if words[1] == "replay":
            fit = float(re.search(r"\(([\d.]+) % of the motion", said)[1])
            assert fit > (99.9 if "--twin" in words else 90.0)
    for block in blocks("py"):
        exec(compile(block, "twin.md", "exec"), {})
    found = json.loads(Path("twin", "twin.json").read_text())
    assert found["verdict"] == "good"
    (of_a_scope, of_a_spindle) = later
    scope(Path("moves.log"), Path("scope.csv"))
    run(of_a_scope)
    again = json.loads(Path("twin", "twin.json").read_text())
    assert again["verdict"] == "good"
    for name in ("payload", "coulomb_friction"):
        low, high = (found["parameters"][name][end] for end in ("low", "high"))
        assert low - (high - low) < again["parameters"][name]["value"] < high + (high - low)
    spindle(of_a_spindle)


def spindle(words):
    """The command of the spindle, of a table that its own machine has made."""
    (text,) = blocks("json")
    drive = json.loads(text)
    Path("drive.json").write_text(text)
    pairs = [words[n + 1].split("=") for n, word in enumerate(words) if word == "--set"]
    motor = {name: False if value == "false" else float(value) for name, value in pairs}
    test_coarse.record(Path("steps.csv"), motor, drive, test_coarse.HIDDEN)
    words[words.index("...")] = test_coarse.COLUMNS
    said = run(words)
    assert "increments of the encoder" in said
