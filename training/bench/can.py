"""`servogym bench --can`: drives in lock-step on one bus, and a comparison of SDO servers."""

import platform
import struct
import time
from importlib.metadata import version
from typing import Any

import can
import numpy as np
from rich.console import Console

from ...drive.canopen.bit_time import length
from ...drive.canopen.frame import Base, Frame
from ...drive.canopen.lockstep import LockStep
from ...drive.canopen.node import NmtCommand
from ...drive.kernel.words import TO_ENABLED, Mode, State
from ...envs.engine.machine import Machine
from ...envs.plants.linear_axis import linear_axis
from . import Tell, show_table
from . import sdo as sdo_bench

DRIVES = 8
SYNC_PERIOD = 1000  # µs
RPDOS = [
    ["controlword", "modes_of_operation", "target_position"],
    ["velocity_offset", "torque_offset"],
]
TPDOS = [
    ["statusword", "position_actual_value", "torque_actual_value"],
    ["velocity_actual_value", "following_error_actual_value"],
]
SERVERS = (  # titles of the rows of `sdo.measure`
    "handling alone", "raw loop, a thread each", "SdoClient, a thread each", "raw loop, one thread"
)
STATES = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)


def axis_in_csp(node_id: int, period: int = SYNC_PERIOD) -> Machine:
    """A linear axis that takes two RPDOs and sends two TPDOs at every SYNC of `period` (µs)."""
    machine = linear_axis()
    (drive,) = machine.drives.values()
    drive.node_id = node_id
    drive.reset_communication()
    drive.map_pdos(RPDOS, TPDOS)
    for n in range(2):
        drive.write(0x1400 + n, 2, 1)
        drive.write(0x1800 + n, 2, 1)
    drive.write("interpolation_time_period_value", period // 100)
    drive.write("interpolation_time_index", -4)
    machine.reset(positions={"x": 0.1})
    return machine


def lockstep(drives: int, syncs: int) -> dict[str, Any]:
    """Simulated time over real time of drives in csp on one loop-back, and the load of the bus.

    Raises RuntimeError if a drive is not enabled at the end or a TPDO is missing.
    """
    run = LockStep([axis_in_csp(n) for n in range(1, drives + 1)], SYNC_PERIOD)
    master = run.bus.join()
    master.send(Frame(Base.NMT, bytes([NmtCommand.START, 0])), 0)
    frames: list[Frame] = []

    def cycle(number: int) -> None:
        nonlocal frames
        word = TO_ENABLED[STATES[min(number // 10, len(STATES) - 1)]]
        target = round(20_000 * np.sin(number * 2e-3))
        sent = [
            frame
            for n in range(1, drives + 1)
            for frame in (
                Frame(0x200 + n, struct.pack("<Hbi", word, Mode.CYCLIC_SYNC_POSITION, target)),
                Frame(0x300 + n, bytes(6)),
            )
        ]
        for frame in sent:
            master.send(frame, run.time)
        run.sync()
        frames = [*sent, *master.receive(run.time)]

    for number in range(100):
        cycle(number)
    times = []
    for number in range(100, 100 + syncs):
        begin = time.perf_counter()
        cycle(number)
        times.append(time.perf_counter() - begin)
    factors = SYNC_PERIOD * 1e-6 / np.array(times)
    asleep = [n.node_id for n in run.nodes if n.drive.state != State.OPERATION_ENABLED]
    if asleep or len(frames) != drives * (len(RPDOS) + len(TPDOS)) + 1:
        raise RuntimeError(f"drives {asleep} are not enabled, {len(frames)} frames a cycle")
    return {
        "drives": drives,
        "sync_period_us": SYNC_PERIOD,
        "frames_per_sync": len(frames),
        "times_real_time": syncs * SYNC_PERIOD * 1e-6 / sum(times),
        "single_periods_quartiles": [float(q) for q in np.percentile(factors, (25, 75))],
        "load_at_1_mbit_s": sum(map(length, frames)) / SYNC_PERIOD,  # above 1 it would not fit
    }


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure everything."""
    return {
        "sdo": sdo_bench.measure(options.repeat),
        "lockstep": lockstep(DRIVES, 10 * options.repeat),
        "python": platform.python_version(),
        "python_can": can.__version__,
        "canopen": version("canopen"),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    rows = [
        (
            name, f"{r['servogym_per_s']:.0f}", f"{r['canopen_per_s']:.0f}", f"{r['ratio']:.2f}",
            f"{r['servogym_others_share']:.0%}, {r['canopen_others_share']:.0%}",
        )
        for name, r in zip(SERVERS, results["sdo"].values(), strict=True)
    ]
    show_table(
        console, "SDO requests per second, expedited, half uploads and half downloads",
        ("", "servogym", "canopen", "ratio", "client, bus, threads"), rows,
    )
    r = results["lockstep"]
    low, high = r["single_periods_quartiles"]
    console.print(
        f"{r['drives']} drives, SYNC every {r['sync_period_us']} µs, {r['frames_per_sync']} frames "
        f"each: {r['times_real_time']:.2f} times real time on one core, "
        f"single periods {low:.2f} .. {high:.2f} "
        f"(at 1 Mbit/s their load would be {r['load_at_1_mbit_s']:.1f})"
    )
