"""What `servogym serve` and `servogym deploy` do in real time, on a network of their own:

    python tests/interop/served_pace.py start            # from a cold process to a moving axis
    python tests/interop/served_pace.py axes             # eight axes on EtherCAT at 1 kHz, 60 s
    python tests/interop/served_pace.py policy           # a learned policy at 1 kHz, 10 minutes

As root both sides get SCHED_FIFO, others are told what is missing.
"""

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from deployed import _network

from servogym.drive.wire import real_time

GROUP = "239.74.163.31"
PERIOD = 1e-3  # s
CAN = f'[bus.can]\nkind = "can"\ninterface = "udp_multicast"\nchannel = "{GROUP}"\n'
LINE = '[bus.line]\nkind = "ethercat"\ninterface = "va"\nclock = "{clock}"\n'
AXIS = '[machine.x{n}]\nbus = "{bus}"\naxis = "linear"\ndrive = "generic"\n{more}'


@contextmanager
def serving(*options):
    """`servogym serve` as a process of its own; -> its output, once it serves, line by line."""
    command = [sys.executable, "-u", "-m", "servogym.training.cli", "serve", *map(str, options)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()
            print(process.stdout.read().strip())


def until_served(process):
    """Print what it says until a machine is on its bus."""
    for line in process.stdout:
        print(line.strip())
        if " on " in line and "clock" in line:
            return


def start(folder, runs, count):
    """Times since the process began (s): all have booted, are enabled, have moved by 1 mm."""
    import can

    from servogym.drive.canopen.remote import CanOpenPort
    from servogym.drive.master import Master
    from servogym.drive.wire.bus import CanPort

    file = folder / "machine.toml"
    nodes = {f"x{n}": n for n in range(1, count + 1)}
    file.write_text(CAN + "".join(
        AXIS.format(n=n, bus="can", more=f"node_id = {n}\n") for n in nodes.values()
    ))
    rows = []
    with can.Bus(interface="udp_multicast", channel=GROUP, fd=False) as bus:
        for _ in range(runs):
            begin = time.perf_counter()
            with serving(file):
                booting = {0x700 + node_id for node_id in nodes.values()}
                while booting:
                    booting.discard(bus.recv(60.0).arbitration_id)
                row = [time.perf_counter() - begin]
                port = CanOpenPort(CanPort(bus), nodes)
                master = Master(port, *nodes)
                master.enable()
                row.append(time.perf_counter() - begin)
                there = {name: port.upload(name, "position_actual_value") for name in nodes}
                master.set_mode("profile_velocity")
                for name in nodes:
                    port.write(name, "target_velocity", 200_000)
                port.exchange()
                for name, at in there.items():
                    while abs(port.upload(name, "position_actual_value") - at) < 1000:
                        continue
                row.append(time.perf_counter() - begin)
                master.disable()
            rows.append(row)
            load = os.getloadavg()[0]
            print(*(f"{value:.2f} s" for value in row),
                  f"boot-up, enabled, moved by 1 mm; {count} axes, load {load:.1f}")
            while bus.recv(0.0) is not None:
                continue
    print("median", *(f"{value:.2f} s" for value in np.median(rows, axis=0)))


def axes(folder, count, seconds):
    """A sine for each axis in csp; what was late here, and there."""
    from servogym.drive.ethercat.port import EtherCatPort
    from servogym.drive.master import Master
    from servogym.drive.wire.soem import SoemMaster

    file = folder / "machine.toml"
    text = LINE.format(clock="real")
    file.write_text(text + "".join(
        AXIS.format(n=n, bus="line", more="positions = { x = 0.2 }\n") for n in range(count)
    ))
    with serving(file, "--real-time") as process:
        until_served(process)
        soem = SoemMaster("vb")
        names = [f"x{n}" for n in range(count)]
        port = EtherCatPort(soem, dict.fromkeys(names, "generic"), now=time.monotonic)
        port.cyclic = True
        for name in names:
            port.write(name, "interpolation_time_period_value", 1)
            port.write(name, "interpolation_time_index", -3)
        master = Master(port, *names)
        print("without", real_time.ask() or "nothing")
        soem.recover()  # their watchdogs have not waited
        master.enable()
        master.follow("csp")
        at = {name: port.read(name, "position_actual_value") for name in names}
        late, wrong = [], 0
        begin = time.monotonic() + 0.01
        for step in range(round(seconds / PERIOD)):
            due = begin + step * PERIOD
            time.sleep(max(due - time.monotonic(), 0.0))
            late.append(time.monotonic() - due)
            way = 20_000 * (1 - math.cos(math.tau * 0.5 * step * PERIOD))
            for name in names:
                port.write(name, "target_position", round(at[name] + way))
            wrong += not port.exchange()
        states = master.state
        master.disable()
        soem.close()
        told(np.array(late), wrong, seconds)
        print(sum(state.name == "OPERATION_ENABLED" for state in states.values()), "of", count,
              "axes enabled at the end")


def policy(seconds, period, phase, missed):
    """A learned policy of LinearAxis-v0, its observations and set-points each ms."""
    from functools import partial

    from servogym.drive.model.model import load
    from servogym.drive.wire.soem import SoemMaster
    from servogym.envs.environment.deployed import episodes_of
    from servogym.envs.environment.registry import task
    from servogym.envs.exchange.envelope import Envelope, Stopped
    from servogym.envs.exchange.over_port import EtherCatDrives
    from servogym.training.cli.deploy import made_policy

    kind, model = task("LinearAxis-v0"), load("generic", "ethercat")
    given = {"randomise": {}, "step_time": period}
    example = kind(model, **given)
    make = partial(made_policy, "learned", example, 0)
    with serving("LinearAxis-v0", "--ethercat", "va", "--clock", "real", "--real-time") as process:
        until_served(process)
        soem = SoemMaster("vb")
        wide = {"x": Envelope(-1.0, 1.0, 10.0)}  # it was trained for steps of 5 ms, and jerks here
        env = kind(model, port=EtherCatDrives(soem, ["x"], model, envelopes=wide), **given)
        env.STEPS, env.line.home = round(seconds / period), 17
        env.line.phase = env.line.phase if phase is None else phase
        env.line.missed = missed or env.line.missed
        try:
            for played in episodes_of(env, make=make, seed=0, fast=True):
                print(f"{played.steps} steps, {played.late} actions late")
        except Stopped as stopped:
            print(f"stopped: {stopped}, {env.line.master.read('error_code'):04X}h")
        timing = env.line.timing
        env.close()
        soem.close()
        print("without", env.line.refused or "nothing")
        for row in timing.rows():
            print(f"{row.what}: median {row.median:.0f}, 99 % {row.p99:.0f}, 99.9 % {row.p999:.0f},"
                  f" most {row.most:.0f} µs")
        print(f"{len(timing.waking)} steps, {timing.missed} a step late, {timing.lost} without all "
              f"answers, {timing.stale} actions not in time, at most {timing.in_a_row} in a row; "
              f"the policy took {timing.share:.0%}")


def stolen():
    """Time (s) that another machine had on the cores of this one, a virtual machine."""
    return int(Path("/proc/stat").read_text().split()[8]) / os.sysconf("SC_CLK_TCK")


def told(late, wrong, seconds):
    median, p99, p999, most = np.percentile(1e6 * late, (50, 99, 99.9, 100))
    missed = int((late > PERIOD).sum())
    print(f"{len(late)} cycles in {seconds:g} s: {missed} more than a cycle late "
          f"({missed / len(late):.4%}), {wrong} without all answers; late by {median:.0f} µs, "
          f"99 % {p99:.0f}, 99.9 % {p999:.0f}, most {most:.0f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("start", "axes", "policy"))
    parser.add_argument("--seconds", type=float, help="of axes (60) and policy (600)")
    parser.add_argument("--count", type=int, help="starts (5)")
    parser.add_argument("--axes", type=int, help="of start (1), of axes (8)")
    parser.add_argument("--period", type=float, default=1.0, help="of policy (ms, 1)")
    parser.add_argument("--phase", type=float, help="of policy: set-points (deploy's own)")
    parser.add_argument("--missed", type=int, help="of policy: steps in a row (deploy's own)")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        alone = ["unshare", "-n"] if os.geteuid() == 0 else ["unshare", "-Urn"]
        os.execvp(alone[0], [*alone, sys.executable, *sys.argv, "--inside"])
    _network()
    with tempfile.TemporaryDirectory() as folder:
        if options.what == "start":
            start(Path(folder), options.count or 5, options.axes or 1)
        elif options.what == "axes":
            axes(Path(folder), options.axes or 8, options.seconds or 60.0)
        else:
            before = stolen()
            policy(
                options.seconds or 600.0, 1e-3 * options.period, options.phase, options.missed
            )
            print(f"{stolen() - before:.2f} s of the cores were the host's")


if __name__ == "__main__":
    main()
