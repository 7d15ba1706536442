"""What the page on deployment prints, run in a network of its own."""

import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from deployed import _network

PAGES = Path(__file__).parents[2] / "docs/how-to"
READY = 120  # s
SHORTER = {"--episodes 20": "--episodes 2", "--steps 200000": "--steps 20000"}


def blocks(page, kind):
    text = (PAGES / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.M | re.S)


def of_an_own_program():
    """The program of the page of `deploy`, in lock-step."""
    folder = Path(tempfile.mkdtemp())
    (program,) = blocks("deploy.md", r"\{code-block\} python\n:caption: program.py")
    (folder / "program.py").write_text(program, encoding="utf-8")
    lines = [x for block in blocks("deploy.md", "sh") for x in block.splitlines()]
    (command,) = [line for line in lines if "program.py:Program" in line]
    return _walked(
        folder, "servogym serve LinearAxis-v0 --clock sync_end",
        f"{command} --lock-step --yes --episodes 3",
    )


def from_a_log_to_the_gap(short):
    """The lesson sim_to_real.md as printed, or with fewer steps and episodes."""
    folder = Path(tempfile.mkdtemp())
    (machine,) = blocks("sim_to_real.md", "toml")
    (folder / "machine.toml").write_text(machine, encoding="utf-8")
    serve, *lines = [
        x for block in blocks("sim_to_real.md", "sh") for x in block.splitlines()
    ]
    for pattern, fewer in SHORTER.items() if short else ():
        lines = [re.sub(pattern, fewer, line) for line in lines]
    return _walked(folder, serve, *lines)


def _walked(folder, serve, *commands):
    """Status and words of the commands beside what is served."""
    _network()
    told = []
    with subprocess.Popen(_words(serve), cwd=folder, stdout=subprocess.PIPE, text=True) as server:
        until = time.monotonic() + READY
        while "clock sync_end" not in server.stdout.readline():
            assert server.poll() is None
            assert time.monotonic() < until
        try:
            for command in commands:
                done = subprocess.run(
                    _words(command), cwd=folder, capture_output=True, text=True, check=False
                )
                told.append([command, done.returncode, done.stdout[-3000:] + done.stderr[-2000:]])
        finally:
            server.send_signal(signal.SIGINT)
            said, _ = server.communicate(timeout=30)
    return {"told": told, "served": said, "status": server.returncode}


def _words(command):
    program, *words = shlex.split(command)
    assert program == "servogym"
    return [sys.executable, "-m", "servogym.training.cli", *words]
