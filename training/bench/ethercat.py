"""`servogym bench --ethercat`: frames through slave controllers, and pysoem on a veth pair.

The second part runs in a network namespace of its own (`unshare -Urn`), so it needs no permission.
Without namespaces or pysoem it is left out, and the reason is shown.
"""

import importlib.util
import json
import os
import platform
import shutil
import signal
import statistics
import struct
import subprocess
import sys
import time
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console

from ...drive.ethercat.al import AlState
from ...drive.ethercat.bus import Bus, Clock
from ...drive.ethercat.frame import Command as C
from ...drive.ethercat.frame import logical, pack
from ...drive.ethercat.master import EtherCatMaster
from ...envs.plants.catalogue import ethercat_line
from . import Tell, alternate, show_table

MODEL = "kollmorgen_akd"
SLAVES = (1, 2, 8, 32)
ON_THE_WIRE = ((1, "none"), (8, "none"), (1, "linear"), (8, "linear"))
FRAMES = 100  # in a row: few, so that at least one row is not interrupted
CYCLES, ROWS = 20_000, 20
CLOCK_FRAMES = 100_000
PERIOD = 2_000_000  # ns


def controllers(slaves: int, repeat: int) -> dict[str, float]:
    """Time of an LRW frame through slaves in OPERATIONAL, without machines (µs).

    Returns: `best` and `median` of `repeat` rows of frames.

    Raises RuntimeError if a working counter is wrong.
    """
    segment, _ = ethercat_line([MODEL] * slaves, "none")
    master = EtherCatMaster(Bus(segment))
    master.to_op()
    begin, size, _ = master._groups[0]
    frame = np.frombuffer(pack([logical(C.LRW, begin, bytes(size))]), np.uint8)
    length = len(frame)

    def row() -> float:
        spent = 0
        for _ in range(FRAMES):
            segment.frame[:length] = frame
            start = time.perf_counter_ns()
            segment.pass_frame(length, 0)
            spent += time.perf_counter_ns() - start
        return spent / FRAMES / 1000

    times = alternate([row], repeat)
    (counter,) = struct.unpack_from("<H", segment.frame.tobytes(), 26 + size)
    if counter != 3 * slaves:
        raise RuntimeError(f"working counter {counter} of {slaves} slaves")
    return {"best": float(times.min()), "median": float(np.median(times))}


def clocks(frames: int, rows: int) -> dict[str, Any]:
    """Frames of process data for one linear axis on each clock, with 2 ms of drive time each.

    Time is an argument, so the real-time clocks run as fast as possible, like ``frame``.

    Args:
        frames: number of frames for each clock.
        rows: number of turns.

    Returns: by clock the time of a frame (µs) and its ratio to that of ``frame`` in the same turn
        (medians), and the number of wrong working counters.
    """
    names = {"frame": (Clock.FRAME, False), "frame, SYNC0": (Clock.FRAME, True),
             "dc, SYNC0": (Clock.DC, True), "real": (Clock.REAL, False)}
    buses = {name: _Clocked(clock, sync0) for name, (clock, sync0) in names.items()}
    spent = alternate([partial(bus.run, frames // rows) for bus in buses.values()], rows)
    medians, ratios = np.median(spent, axis=0), np.median(spent / spent[:, :1], axis=0)
    return {
        name: {
            "us": float(us), "ratio": float(ratio), "frames": frames // rows * rows,
            "wrong": bus.master.wrong,
            "in_op": bus.master.slaves[0].state == AlState.OPERATIONAL,
        }
        for (name, bus), us, ratio in zip(buses.items(), medians, ratios, strict=True)
    }


class _Clocked:
    """A master and a slave with a linear axis in OPERATIONAL, which are given the time."""

    def __init__(self, clock: Clock, sync0: bool):
        segment, machines = ethercat_line([MODEL], "linear")
        self._bus, self._now = Bus(segment, machines, clock), 0
        self.master = EtherCatMaster(self)
        self.master.scan()
        self.master.to_preop()
        (slave,) = self.master.slaves
        slave.mailbox.download(0x60C2, 1, bytes([PERIOD // 1_000_000]))
        if sync0:
            self.master.synchronise()
            self.master.sync0(PERIOD)
        self.master.map()
        self.master.to(AlState.SAFE_OPERATIONAL)
        self.run(20)
        self.master.to(AlState.OPERATIONAL)

    def exchange(self, frame: bytes, now: int = 0) -> bytes | None:
        """Exchange a frame at the present time."""
        return self._bus.exchange(frame, self._now)

    def run(self, frames: int) -> float:
        """Exchange frames of process data; -> time of one (µs)."""
        begin = time.perf_counter()
        for _ in range(frames):
            self._now += PERIOD
            self.master.cycle()
        return (time.perf_counter() - begin) / frames * 1e6


def on_the_wire(slaves: int, axis: str, cycles: int) -> dict[str, Any]:
    """Run pysoem; -> LRW cycles per second and wrong working counters, or the reason for none."""
    if importlib.util.find_spec("pysoem") is None:
        return {"left_out": "pip install pysoem"}
    if not shutil.which("unshare") or not shutil.which("ip"):
        return {"left_out": "unshare and ip are needed (util-linux, iproute2)"}
    done = subprocess.run(
        ["unshare", "-Urn", sys.executable, "-m", __name__, str(slaves), axis, str(cycles)],
        capture_output=True, text=True, check=False,
    )
    if done.returncode:
        return {"left_out": (done.stderr.strip().splitlines() or ["it failed"])[-1]}
    return json.loads(done.stdout.splitlines()[-1])


def _inside(slaves: int, axis: str, cycles: int) -> dict[str, Any]:
    """Run in the namespace: the server in a copy of this process, pysoem in this one."""
    import pysoem

    from ...drive.wire.ethercat import EtherCatServer
    from ...drive.wire.ethernet import RawPort

    for command in (
        "link add va type veth peer name vb", "link set va up", "link set vb up",
    ):
        subprocess.run(["ip", *command.split()], check=True)
    segment, machines = ethercat_line([MODEL] * slaves, axis)
    server = EtherCatServer(Bus(segment, machines), [RawPort("va")])
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        while True:
            server.serve()
    try:
        master = pysoem.Master()
        master.open("vb")
        master.config_init()
        master.config_map()
        master.state_check(pysoem.SAFEOP_STATE, 5_000_000)
        master.state = pysoem.OP_STATE
        master.write_state()
        for _ in range(100):
            master.send_processdata()
            master.receive_processdata(100_000)
        wrong, rates = 0, []
        for _ in range(ROWS):
            begin = time.perf_counter()
            for _ in range(cycles // ROWS):
                master.send_processdata()
                wrong += master.receive_processdata(100_000) != master.expected_wkc
            rates.append(cycles // ROWS / (time.perf_counter() - begin))
        state = master.state_check(pysoem.OP_STATE, 50_000)
        master.close()
    finally:
        os.kill(child, signal.SIGTERM)
        os.waitpid(child, 0)
    return {"best": max(rates), "median": statistics.median(rates), "wrong": wrong,
            "in_op": state == pysoem.OP_STATE}


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure everything."""
    return {
        "python": platform.python_version(),
        "controller_us": {n: controllers(n, 10 * options.repeat) for n in SLAVES},
        "clocks": clocks(CLOCK_FRAMES, ROWS),
        "pysoem": {
            f"{n} {axis}": on_the_wire(n, axis, CYCLES if axis == "none" else CYCLES // 10)
            for n, axis in ON_THE_WIRE
        },
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    rows = [
        (str(n), f"{row['best']:.2f}", f"{row['median']:.2f}")
        for n, row in results["controller_us"].items()
    ]
    title = f"an LRW frame through {MODEL} in OPERATIONAL (µs)"
    show_table(console, title, ("slaves", "best", "median"), rows, texts=())
    timed = [
        (name, f"{row['us']:.1f}", f"{row['ratio']:.2f}", str(row["frames"]), str(row["wrong"]))
        for name, row in results["clocks"].items()
    ]
    show_table(
        console, "a frame of process data and 2 ms of a linear axis, in memory",
        ("clock", "µs", "to that of frame", "frames", "wrong"), timed, texts=(),
    )
    for name, row in results["pysoem"].items():
        slaves, axis = name.split()
        what = f"pysoem, clock = frame, {slaves} slaves, axis {axis}"
        if "left_out" in row:
            console.print(f"{what}: left out: {row['left_out']}")
        else:
            console.print(
                f"{what}: {row['median']:.0f} cycles/s (best row {row['best']:.0f}), "
                f"{row['wrong']} wrong working counters"
            )


if __name__ == "__main__":
    print(json.dumps(_inside(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]))))
