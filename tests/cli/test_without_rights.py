"""Commands at a network interface, started by a user who may not open raw sockets."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

NOBODY = 65534
# may read the installation, wherever it is, and nothing else that the user could not
READS = "dac_read_search"
AS_NOBODY = [
    "setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups",
    f"--inh-caps=-all,+{READS}", f"--ambient-caps=+{READS}", f"--bounding-set=-all,+{READS}",
]
MACHINE = """
[bus.line]
kind = "ethercat"
interface = "lo"

[machine.feeder]
bus = "line"
axis = "linear"
"""
COMMANDS = {
    "serve LinearAxis-v0 --ethercat lo": "",
    "serve machine.toml": 'or set udp = "127.0.0.1" instead of interface',
    "ethercat -i lo": "or use --udp instead",
    "deploy LinearAxis-v0 --ethercat lo --yes": "",
    "observe --ethercat lo -o seen.json": "",
    "drives --from-slave lo -o model": "",
}

pytestmark = pytest.mark.skipif(
    not shutil.which("setpriv") or os.getuid() != 0, reason="changes the user: needs root"
)


@pytest.fixture
def folder():
    """A folder of that user; pytest's own can only be entered by its owner."""
    made = Path(tempfile.mkdtemp())
    os.chown(made, NOBODY, NOBODY)
    (made / "machine.toml").write_text(MACHINE, encoding="utf-8")
    yield made
    shutil.rmtree(made)


def as_nobody(folder, *arguments):
    """A process of that user, with a cache of compiled code that is empty at first."""
    places = {"HOME": str(folder), "SERVOGYM_CACHE_DIR": str(folder / "cache")}
    return subprocess.run(
        [*AS_NOBODY, sys.executable, *arguments], cwd=folder, env=os.environ | places,
        capture_output=True, text=True, check=False, timeout=300,
    )


@pytest.mark.parametrize(("words", "otherwise"), COMMANDS.items())
def test_a_user_without_the_right_reads_the_remedy_before_anything_is_compiled(
    folder, words, otherwise
):
    pytest.importorskip("pysoem")
    done = as_nobody(folder, "-m", "servogym.training.cli", *words.split())
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    command, _, said = line.partition(": ")
    assert command == f"servogym {words.split()[0]}"
    needs = "interface lo: raw sockets need the capability CAP_NET_RAW: sudo setcap cap_net_raw+ep "
    assert needs in said
    assert "or run it with sudo" in said
    assert otherwise in said
    assert not [*folder.rglob("*.nbc"), *folder.rglob("*.nbi"), *folder.rglob("*.so")]
    left = {path.name for path in folder.iterdir()} - {"cache", "machine.toml", ".config", ".cache"}
    assert not left
