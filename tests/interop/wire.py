"""A veth pair in a network namespace of its own: `servogym ethercat` at one end, a master at the
other.

The tests start this file as a program once (`_Helper`): it loads the drive, and for each scenario
forks a process with a network of its own, which forks the server. So nobody waits for a start.
"""

import atexit
import contextlib
import ctypes
import faulthandler
import functools
import importlib
import json
import multiprocessing
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path

import pytest

HERE = Path(__file__).parent
UNSHARE = ["unshare", "-Ur"]
WHERE = signal.SIGUSR1  # asks for the stacks of all threads
NEW_NETWORK = 0x40000000  # CLONE_NEWNET of unshare(2)
FROM_PYPI = ("pysoem", "kickcat")  # masters, each with modules that begin with its name
# masters give a frame up after 2 ms, or a scan; where the machine has other things to do, again
ATTEMPTS = 10
LATE = (
    "WkcError", "ConfigMapError", "did not go on in time",
    "Bus.cc:795: Timeout", "error while checking mailboxes", "OP is not reached",
    "SdoInfoError",
)


@functools.cache
def why_not() -> str:
    """Why there is no wire here, empty where there is one."""
    if not sys.platform.startswith("linux"):
        return f"{sys.platform} has no network namespaces"
    if not shutil.which("unshare") or not shutil.which("ip"):
        return "unshare (util-linux) and ip (iproute2) are needed"
    tried = subprocess.run(
        [*UNSHARE, "-n", "ip", "link", "add", "va", "type", "veth", "peer", "name", "vb"],
        capture_output=True, text=True, check=False,
    )
    if tried.returncode:
        return f"no veth pair in a user namespace: {tried.stderr.strip()}"
    return ""


class _Helper:
    """This file as a program; a task a line, and its exit status."""

    def __init__(self):
        self.process = subprocess.Popen(
            [*UNSHARE, sys.executable, str(HERE / "wire.py")],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # who has threads cannot fork
        )
        atexit.register(self.close)

    def close(self):
        self.process.stdin.close()  # of whom it reads tasks
        self.process.wait(20)

    def do(self, task, timeout) -> tuple[int, str]:
        """Exit status of a scenario, and all that was said."""
        with tempfile.NamedTemporaryFile("r+") as said:
            print(json.dumps(task | {"said": said.name}), file=self.process.stdin, flush=True)
            ready, *_ = select.select([self.process.stdout], [], [], timeout)
            if not ready:
                self.process.kill()
                _helper.cache_clear()
                raise TimeoutError(f"{task} took more than {timeout} s: {said.read()}")
            return int(self.process.stdout.readline()), said.read()


_helper = functools.cache(_Helper)


def on_the_wire(
    module, scenario, *server, timeout=300, ports=1, in_time=lambda result: True, **arguments
):
    """Let a function of a module of this folder talk to `servogym ethercat`; -> what it returns.

    It does so again where something came later than the master waits: it then ends with an error of
    `LATE`, or with what is not `in_time`.
    """
    if (package := module.split("_")[0]) in FROM_PYPI:
        pytest.importorskip(package)
    if reason := why_not():
        pytest.skip(reason)
    task = {"module": module, "scenario": scenario, "server": server, "ports": ports,
            "arguments": arguments, "timeout": timeout}
    for _ in range(ATTEMPTS):
        status, said = _helper().do(task, timeout)
        if status == 0 and in_time(result := json.loads(said.splitlines()[-1])):
            return result
        if status and not any(late in said for late in LATE):
            break
    assert status == 0, said
    return result


def _serve(options, said):
    """`servogym ethercat`, in a copy of this process."""
    from servogym.training import cli

    _say_to(said.fileno())
    sys.exit(cli.main(["ethercat", *options]))


@contextlib.contextmanager
def served(*options, ports=1):
    """Run the server on va (and va2) while the block runs; -> its process."""
    names = ["va", "va2"][:ports]
    for name in names:
        peer = name.replace("a", "b")
        ip("link", "add", name, "type", "veth", "peer", "name", peer)
        for end in (name, peer):
            ip("link", "set", end, "up")
    interfaces = [x for name in names for x in ("-i", name)]
    with tempfile.TemporaryFile("w+") as said:
        server = multiprocessing.get_context("fork").Process(
            target=_serve, args=([*interfaces, *options], said)
        )
        server.start()
        try:
            until = time.monotonic() + 240
            while "slaves on" not in text(said):
                if not server.is_alive() or time.monotonic() > until:
                    raise RuntimeError(f"the server did not start: {text(said)}")
                time.sleep(0.01)
            yield server
        finally:
            server.terminate()
            server.join(20)
            sys.stderr.write(text(said))
        if server.exitcode:
            raise RuntimeError(f"the server ended with {server.exitcode}: {text(said)}")


@contextlib.contextmanager
def forked(models, faults=(), name="va"):
    """A server in a copy of this process, quicker than a new one; drives stand still."""
    from servogym.drive.ethercat.faulty import FaultyBus
    from servogym.drive.wire.ethercat import EtherCatServer
    from servogym.drive.wire.ethernet import RawPort
    from servogym.envs.plants.catalogue import ethercat_line

    ip("link", "add", name, "type", "veth", "peer", "name", name.replace("a", "b"))
    for end in (name, name.replace("a", "b")):
        ip("link", "set", end, "up")
    segment, machines = ethercat_line(models, "none")
    server = EtherCatServer(FaultyBus(segment, machines, faults=faults), [RawPort(name)])
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        while True:
            server.serve()
    try:
        yield
    finally:
        os.kill(child, signal.SIGTERM)
        os.waitpid(child, 0)
        server.close()
        ip("link", "delete", name)


def text(file) -> str:
    file.seek(0)
    return file.read()


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True)


def _say_to(file) -> None:
    """All that this process and its children say goes to a file, at once."""
    for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
        stream.flush()
        os.dup2(file, number)
        stream.reconfigure(line_buffering=True)


def _play(task) -> None:
    """A scenario in a network of its own; the last line is its result."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a shell's background
    # a timer of faulthandler would lock up the copies of this process; they all have this signal
    faulthandler.register(WHERE, file=sys.__stderr__)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(NEW_NETWORK):
        raise OSError(ctypes.get_errno(), "no network of its own")
    scenario = getattr(importlib.import_module(task["module"]), task["scenario"])
    if task["server"] == ["forked"]:
        print(json.dumps(scenario(**task["arguments"])))
        return
    with served(*task["server"], ports=task["ports"]) as server:
        named = scenario.__code__.co_varnames[: scenario.__code__.co_argcount]
        more = {"server": server} if "server" in named else {}
        result = scenario(**task["arguments"], **more)
    print(json.dumps(result))


def _fork(task) -> int:
    """Exit status of a scenario in a copy of this process; nothing of it is left behind."""
    child = os.fork()
    if not child:
        status = 1
        try:
            _say_to(os.open(task["said"], os.O_WRONLY | os.O_APPEND))
            _play(task)
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(status)
    alive = os.pidfd_open(child)
    if not select.select([alive], [], [], 0.9 * task["timeout"])[0]:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, WHERE)  # it hangs: it and its copies say where
    os.close(alive)
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(status)


def main() -> None:
    from servogym.envs.plants.catalogue import ethercat_line

    sys.path.insert(0, str(HERE))
    _, machines = ethercat_line(["kollmorgen_akd"], "linear")
    machines[0].step()  # its code is loaded
    for line in sys.stdin:
        print(_fork(json.loads(line)), flush=True)


if __name__ == "__main__":
    main()
