"""`servogym bench`: time of the drive compared with that of the physics, interleaved in one run.

The drive runs a motion once and its torques are recorded. Then blocks alternate: physics alone with
those torques replayed, and drive and physics together, both from the same state, both inside a
compiled loop, by the processor time of their thread. Both perform the same motion. MuJoCo's clock
is stopped for both, see `servogym.envs.engine.clock`; its cost is reported too.

There are two kinds of rows. With friction, physics alone is `mj_step` with MuJoCo's own friction
constraint, which ours takes out of the constraint solver, so the drive recovers part of its time
there. Without friction on either side, the solver does the same work for both.
"""

import copy
import os
import platform
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from rich.console import Console

from ...drive.kernel.jit import entry
from ...drive.kernel.words import Mode
from ...drive.master import Master
from ...envs.engine import loop
from ...envs.engine.clock import clock
from ...envs.engine.machine import NO_IMAGES, Machine
from ...envs.engine.physics import STATE, addresses, mj_step
from ...envs.masters.port import MachinePort
from ...envs.plants.linear_axis import linear_axis
from . import Tell, alternate, show_table

CYCLES = 600  # position cycles in a block
ROWS: tuple[tuple[str, str, bool, bool], ...] = (  # key, name, each step, with friction
    ("rates_of_the_model", "friction, rates of the model", False, True),
    ("position_cycle_every_step", "friction, position cycle every step", True, True),
    ("rates_of_the_model_frictionless", "no friction, rates of the model", False, False),
    (
        "position_cycle_every_step_frictionless", "no friction, position cycle every step", True,
        False,
    ),
)
SAME_MOTION = 1e-4  # m; MuJoCo's friction is a soft constraint, ours is not


@entry
def physics_alone(model, data, ctrl, torques):
    """`mj_step` once for each of the recorded torques (Nm)."""
    for i in range(len(torques)):
        ctrl[0] = torques[i]
        mj_step(model, data)


def _moving_machine(drive: str, everything_each_step: bool, friction: bool = True):
    machine = linear_axis(drive) if friction else linear_axis(drive, coulomb_friction=0.0)
    if everything_each_step:
        for axis in machine.axes:
            axis.velocity_cycles = 1
            axis.position_period = axis.velocity_period
            axis.parameters_changed = 1
    machine.reset(positions={"x": 0.1})
    if everything_each_step:
        for axis in machine.axes:
            axis.velocity_cycles = 1
            axis.position_period = axis.velocity_period
    master = Master(MachinePort(machine))
    master.enable()
    master.set_mode(Mode.PROFILE_VELOCITY)
    machine.drives["x"].write("target_velocity", 200_000)
    machine.step(100)
    return machine


def _with_own_friction(machine: Machine) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model with the friction of its driven joints as MuJoCo's constraint."""
    model = copy.copy(machine.model)
    for coupling in machine.couplings:
        model.dof_frictionloss[coupling.dof] = coupling.friction
    return model, mujoco.MjData(model)


def measure(
    drive: str, repeat: int, everything_each_step: bool, friction: bool = True
) -> dict[str, Any]:
    """Time per physics step with and without the drive (ns), and their ratio (medians)."""
    machine = _moving_machine(drive, everything_each_step, friction)
    snapshot = machine.snapshot()
    steps = CYCLES * (1 if everything_each_step else machine.physics_steps)
    torques = np.zeros(steps)
    plain, plain_data = _with_own_friction(machine)
    model, data = addresses(plain, plain_data)

    def loop_of_the_machine(steps: int) -> None:
        loop.run(machine.addresses, steps, NO_IMAGES, NO_IMAGES)

    def with_drive() -> float:
        machine.restore(snapshot)
        begin = time.thread_time()
        loop_of_the_machine(steps)
        return (time.thread_time() - begin) / steps * 1e9

    def alone() -> float:
        mujoco.mj_setState(plain, plain_data, begin_state, STATE)
        begin = time.thread_time()
        physics_alone(model, data, plain_data.ctrl, torques)
        return (time.thread_time() - begin) / steps * 1e9

    def without_clock() -> float:
        with clock:
            return alone()

    machine.restore(snapshot)
    begin_state = np.empty(mujoco.mj_stateSize(plain, STATE))
    mujoco.mj_getState(machine.model, machine.data, begin_state, STATE)
    for i in range(steps):
        loop_of_the_machine(1)
        torques[i] = machine.data.ctrl[0]
    alone()
    if np.abs(plain_data.qpos - machine.data.qpos).max() > SAME_MOTION:
        raise RuntimeError("the replay of the torques does not reproduce the motion")
    taken = alternate([with_drive, without_clock, alone], repeat)
    ratios = taken[:, 0] / taken[:, 1]
    drive_and_step, step, with_clock = np.median(taken, axis=0).tolist()
    return {
        "mj_step_ns": step,
        "drive_and_mj_step_ns": drive_and_step,
        "mj_step_with_clock_ns": with_clock,
        "ratio": float(np.median(ratios)),
        "ratio_quartiles": [float(q) for q in np.percentile(ratios, (25, 75))],
        "steps_per_block": steps,
        "blocks": repeat,
    }


def two_threads(drive: str, repeat: int) -> dict[str, float]:
    """Ratio of the throughput on two threads to that on one, also for mujoco.batch."""
    steps = 40_000
    machines = [_moving_machine(drive, False) for _ in range(2)]
    snapshots = [machine.snapshot() for machine in machines]

    def run(chosen) -> float:
        for machine, snapshot in zip(machines, snapshots, strict=True):
            machine.restore(snapshot)
        begin = time.perf_counter()
        with ThreadPoolExecutor(len(chosen)) as pool:
            list(pool.map(lambda machine: machine.step(steps // machine.physics_steps), chosen))
        return time.perf_counter() - begin

    batches = {n: Batch(machines[0].model, nsim=2, nthread=n) for n in (1, 2)}

    def batch(threads: int) -> float:
        begin = time.perf_counter()
        with clock:
            batches[threads].step(nstep=steps)
        return time.perf_counter() - begin

    ours, theirs = np.median(alternate(
        [lambda: 2 * run(machines[:1]) / run(machines), lambda: batch(1) / batch(2)], repeat
    ), axis=0)
    return {"machines": float(ours), "mujoco_batch": float(theirs)}


_START = """
import time; begin = time.perf_counter()
from servogym.envs import linear_axis
machine = linear_axis(); machine.step()
print(time.perf_counter() - begin)
"""


def start_times() -> dict[str, float]:
    """Time from the start of Python to the first cycle, compiling (cold) or not (warm), in s."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"SERVOGYM_CACHE_DIR": cache}
        times = []
        for _ in range(2):
            result = subprocess.run(
                [sys.executable, "-c", _START],
                env=environment, capture_output=True, text=True, check=True,
            )
            times.append(float(result.stdout))
    return {"cold_start_s": times[0], "warm_start_s": times[1]}


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure everything."""
    drive, repeat = options.drive, options.repeat
    return {
        "drive": drive,
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        **{key: measure(drive, repeat, *arguments) for key, _, *arguments in ROWS},
        "two_threads_over_one": two_threads(drive, max(repeat // 5, 3)),
        **start_times(),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    title = f"drive {results['drive']}, one axis, moving; MuJoCo {results['mujoco']}"
    rows = [
        (
            name, f"{r['mj_step_ns']:.0f}", f"{r['drive_and_mj_step_ns']:.0f}",
            f"{r['ratio']:.3f}", " .. ".join(f"{each:.3f}" for each in r["ratio_quartiles"]),
        )
        for name, r in ((name, results[key]) for key, name, *_ in ROWS)
    ]
    heading = ("", "mj_step\n(ns)", "drive + mj_step\n(ns)", "ratio\n(median)", "quartiles")
    show_table(console, title, heading, rows)
    console.print(
        "friction: in mj_step by its constraint solver, ours outside of it, which is part of the "
        "difference; no friction: on neither side"
    )
    rates = results["rates_of_the_model"]
    console.print(
        "MuJoCo's clock is stopped in both; when it is read for MjData.timer, mj_step takes "
        f"{rates['mj_step_with_clock_ns']:.0f} ns"
    )
    threads = results["two_threads_over_one"]
    console.print(
        f"two machines on two threads over one: {threads['machines']:.2f} times the steps "
        f"(mujoco.batch in the same run: {threads['mujoco_batch']:.2f})"
    )
    console.print(
        f"start to first cycle: cold {results['cold_start_s']:.1f} s (compiling), "
        f"warm {results['warm_start_s']:.1f} s"
    )
