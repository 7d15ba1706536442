"""A veth pair in a network namespace of its own: `servogym ethercat` at one end, a master at the
other. Run as a program inside the namespace, imported by the tests outside of it.
"""

import contextlib
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

HERE = Path(__file__).parent
UNSHARE = ["unshare", "-Urn"]
FROM_PYPI = ("pysoem", "kickcat")  # masters, each with modules that begin with its name
# masters give a frame up after 2 ms, or a scan; where the machine has other things to do, again
ATTEMPTS, LATE = 4, ("WkcError", "did not go on in time", "Bus.cc:795: Timeout")


def why_not() -> str:
    """Why there is no wire here, empty where there is one."""
    if not sys.platform.startswith("linux"):
        return f"{sys.platform} has no network namespaces"
    if not shutil.which("unshare") or not shutil.which("ip"):
        return "unshare (util-linux) and ip (iproute2) are needed"
    tried = subprocess.run(
        [*UNSHARE, "ip", "link", "add", "va", "type", "veth", "peer", "name", "vb"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if tried.returncode:
        return f"no veth pair in a user namespace: {tried.stderr.strip()}"
    return ""


def on_the_wire(module, scenario, *server, timeout=300, ports=1, **arguments):
    """Let a function of a module of this folder talk to `servogym ethercat`; -> what it returns."""
    if (package := module.split("_")[0]) in FROM_PYPI:
        pytest.importorskip(package)
    if reason := why_not():
        pytest.skip(reason)
    task = {"module": module, "scenario": scenario, "server": server, "ports": ports,
            "arguments": arguments}  # fmt: skip
    for _ in range(ATTEMPTS):
        done = subprocess.run(
            [*UNSHARE, sys.executable, str(HERE / "wire.py"), json.dumps(task)],
            capture_output=True, text=True, timeout=timeout, check=False,
        )  # fmt: skip
        if not any(late in done.stderr for late in LATE):
            break
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@contextlib.contextmanager
def served(*options, ports=1):
    """Run the server on va (and va2) while the block runs; -> its process."""
    names = ["va", "va2"][:ports]
    for name in names:
        peer = name.replace("a", "b")
        ip("link", "add", name, "type", "veth", "peer", "name", peer)
        for end in (name, peer):
            ip("link", "set", end, "up")
    arguments = [x for name in names for x in ("-i", name)]
    with tempfile.TemporaryFile("w+") as said:
        server = subprocess.Popen(
            [sys.executable, "-m", "servogym.training.cli", "ethercat", *arguments, *options],
            stdout=said, stderr=subprocess.STDOUT, env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        try:
            until = time.monotonic() + 240
            while "slaves on" not in text(said):
                if server.poll() is not None or time.monotonic() > until:
                    raise RuntimeError(f"the server did not start: {text(said)}")
                time.sleep(0.1)
            yield server
        finally:
            server.send_signal(signal.SIGTERM)
            status = server.wait(20)
            sys.stderr.write(text(said))
        if status:
            raise RuntimeError(f"the server ended with {status}: {text(said)}")


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
        signal.signal(signal.SIGTERM, lambda *_: server.stop())
        server.run()
        os._exit(0)
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


def main() -> None:
    task = json.loads(sys.argv[1])
    sys.path.insert(0, str(HERE))
    scenario = getattr(importlib.import_module(task["module"]), task["scenario"])
    if task["server"] == ["forked"]:
        print(json.dumps(scenario(**task["arguments"])))
        return
    with served(*task["server"], ports=task["ports"]) as server:
        result = scenario(
            **task["arguments"],
            **(
                {"server": server}
                if "server" in scenario.__code__.co_varnames[: scenario.__code__.co_argcount]
                else {}
            ),
        )
    print(json.dumps(result))


if __name__ == "__main__":
    main()
