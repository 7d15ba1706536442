"""The commands of docs/how-to/twin.md run as they are printed, in their order, in one folder."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "twin.md").read_text(encoding="utf-8")
ELSEWHERE = ("servogym panel", "servogym twin steps.csv")  # a server; a log of `test_coarse`


def commands():
    text = "".join(re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)).replace("\\\n", " ")
    return [line.partition("   #")[0] for line in text.splitlines()]


@pytest.mark.slow
def test_the_commands_of_the_page_run_as_they_are_printed(tmp_path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    rows = [(f"{1e3 * t:.3f}", f"{1e3 * asked:.5f}", f"{1e3 * place:.5f}", f"{torque:.5f}")
            for t, asked, place, torque in foreign.axis(3.6)]
    table = [("t", "demand", "actual", "torque"), *rows]
    (tmp_path / "scope.csv").write_text("".join(",".join(row) + "\n" for row in table))
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
                        "MPLBACKEND": "agg"}
    ran = []
    for command in commands():
        if command.startswith(ELSEWHERE):
            continue
        more = " --steps 4000" if "servogym train" in command else ""  # the page learns longer
        done = subprocess.run(shlex.split(command + more), cwd=tmp_path, env=env, check=False,
                              capture_output=True, text=True)
        # the scope's table has no gains, so its twin need not be one to believe
        assert done.returncode == 0 or "scope.csv" in command, (command, done.stdout, done.stderr)
        assert "Traceback" not in done.stderr, (command, done.stderr)
        ran.append(command)
        if " moves.log -o twin" in command or "twin moves.log" in command:
            shutil.copy(tmp_path / "moves.log", tmp_path / "new.log")
    assert len(ran) > 8
    found = json.loads((tmp_path / "twin" / "twin.json").read_text(encoding="utf-8"))
    assert found["mechanics"] == "rigid"
    assert found["verdict"] == "good"
