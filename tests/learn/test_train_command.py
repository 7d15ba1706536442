"""`servogym train` as a process: killed, and interrupted at its terminal."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest
from later import Later, only_with

from servogym.training.policies.trained import saved

checkpoint = Later("servogym.training.learn.checkpoint")
train = Later("servogym.training.learn.train", "train")
Training = Later("servogym.training.learn.training", "Training")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")

ID = "LinearAxis-v0"
TRAIN = [
    "train", ID, "--envs", "4", "--steps", "10000000", "--checkpoint-every", "256",
    "--evaluate-every", "256", "--argument", "max_episode_steps=10", "--setting", "n_epochs=1",
]
TEMPLATE = """
import json, os, signal, sys
from servogym.training import cli
from servogym.training.learn import train
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background
for line in sys.stdin:
    arguments, where = json.loads(line)
    child = os.fork()
    if not child:
        end = os.open(where, os.O_RDWR | os.O_CREAT)
        if os.isatty(end):
            os.login_tty(end)
        else:
            os.dup2(end, 1), os.dup2(end, 2)
        sys.stdout, sys.stderr = (open(n, "w", buffering=1, closefd=False) for n in (1, 2))
        status = cli.main(arguments)
        assert "torch._dynamo" not in sys.modules, "seconds for nothing"
        sys.exit(status)
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture(scope="module")
def command():
    """Starts a command in a copy of a process that has loaded torch -> its id, and its ending."""
    if not hasattr(os, "fork"):
        pytest.skip("no copies of processes on this system")
    plain = {"TERM": "xterm", "COLUMNS": "120", "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, "-c", TEMPLATE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | plain,
    ) as template:

        def start(arguments, where):
            print(json.dumps([arguments, str(where)]), file=template.stdin, flush=True)
            return int(template.stdout.readline()), lambda: int(template.stdout.readline())

        yield start
        template.stdin.close()


def test_a_killed_run_continues_from_its_last_checkpoint(tmp_path, command):
    said = tmp_path / "said"
    process, ended = command([*TRAIN, "--out", str(tmp_path)], said)
    try:
        end = time.monotonic() + 120
        while len(checkpoint.numbered(tmp_path)) < 3:
            assert time.monotonic() < end, said.read_text(encoding="utf-8")
            time.sleep(0.05)
    finally:
        os.kill(process, signal.SIGKILL)
        assert ended() == -signal.SIGKILL, said.read_text(encoding="utf-8")
    steps = saved.read(checkpoint.numbered(tmp_path)[-1])["steps"]
    with (tmp_path / "progress.csv").open("a") as file:
        file.write("1,2")  # a row cut off
    (tmp_path / ".evaluations.npz").write_bytes(b"PK\x03\x04 half of them")
    (tmp_path / "checkpoints" / ".0000009999.1").mkdir()
    train(Training(ID, out=tmp_path, steps=steps + 256, evaluate_every=256, resume=True))
    assert saved.read(checkpoint.numbered(tmp_path)[-1])["steps"] == steps + 256
    with (tmp_path / "progress.csv").open() as file:
        seen = [int(row["time/total_timesteps"]) for row in csv.DictReader(file)]
    assert seen == sorted(seen)
    assert seen[-1] == steps + 256
    assert not list(tmp_path.glob("**/.e*"))
    assert not list(tmp_path.glob("checkpoints/.*"))


def test_in_a_terminal_it_shows_a_bar_and_ctrl_c_says_how_to_continue(tmp_path, command):
    pytest.importorskip("tqdm")
    pty = pytest.importorskip("pty", reason="no terminals on this system")
    own, its = pty.openpty()
    _, ended = command([*TRAIN, "--out", str(tmp_path)], os.ttyname(its))
    said, interrupted = b"", False
    try:
        while part := os.read(own, 4096):
            if not said:
                os.close(its)  # the command has it
            said += part
            if said.count(b"reward of an episode") > 2 and not interrupted:
                os.write(own, b"\x03")
                interrupted = True
    except OSError:  # Linux, when the other end is closed
        pass
    finally:
        os.close(own)
    assert ended() == 130, said
    text = re.sub(r"\x1b\[2K", "\n", said.decode())  # a line is cleared
    lines = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", text).replace("\r", "\n").splitlines()
    assert any("/10,000,000" in line and "━" in line for line in lines)
    told = [line for line in lines if "steps: reward of an episode" in line]
    assert len(told) >= 3
    assert not any("━" in line for line in told)
    assert "the same command with --resume goes on from there" in " ".join(" ".join(lines).split())
    assert [line.strip() for line in lines].count("interrupted") == 1
    assert "Traceback" not in text
    assert checkpoint.numbered(tmp_path)


def test_numbers_that_cannot_be_are_refused_before_torch_is_loaded():
    code = """
import sys
from servogym.training import cli
try:
    cli.main(sys.argv[1:])
except SystemExit as refused:
    print(refused.code, "torch" in sys.modules)
"""
    for option in ("--steps", "--envs", "--evaluate-every", "--checkpoint-every", "--seed"):
        call = [sys.executable, "-c", code, "train", ID, option, "-5"]
        done = subprocess.run(call, capture_output=True, text=True, timeout=120)
        assert done.stdout.strip() == "2 False", done
        assert f"{option}: -5 is out of range" in done.stderr
