"""`servogym deploy`."""

import argparse
import csv
import ctypes
import os
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from . import bus as buses

NO_SAFETY = (
    "The guard runs on this computer and is no safety function: keep the emergency stop (STO) of "
    "the machine within reach."
)
LOCK_ALL = 3  # MCL_CURRENT | MCL_FUTURE


def add(deploy: argparse.ArgumentParser) -> None:
    """Its options."""
    deploy.add_argument("env", metavar="TASK", help="such as LinearAxis-v0")
    deploy.add_argument("--policy", default="hold", help=f"{arguments.POLICY} (hold)")
    deploy.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    deploy.add_argument(
        "--ethercat", metavar="IFACE", help="network interface; without it the bus is CAN"
    )
    deploy.add_argument(
        "--node-id", type=int, action="append", help="of each drive on CAN, in the task's order (1)"
    )
    deploy.add_argument("--episodes", type=int, default=1, help="1 or more (1)")
    deploy.add_argument("--seed", type=int, default=0, help="of the first reset (0)")
    deploy.add_argument(
        "--limits", action="append", default=[], metavar="[AXIS=]LOW:HIGH",
        help="positions (m or rad) of the guard, instead of 607Dh; repeatable",
    )  # fmt: skip
    for name, unit in (("velocity", "m/s or rad/s"), ("acceleration", "m/s²"), ("jerk", "m/s³")):
        deploy.add_argument(f"--max-{name}", type=float, help=f"of set-points ({unit})")
    deploy.add_argument("--home", type=int, metavar="METHOD", help="reference the drives first")
    deploy.add_argument("--slow", type=float, default=1.0, help="share of each action, 0..1 (1)")
    deploy.add_argument("--dry-run", action="store_true", help="all but the power stage")
    deploy.add_argument("--yes", action="store_true", help="move without asking")
    deploy.add_argument("--log", type=Path, help="file for every step, .csv")
    buses.add(deploy)
    arguments.add(deploy)
    deploy.set_defaults(run=_deploy, files=("log",))


def _deploy(options: argparse.Namespace, console: Console) -> int:
    """Play episodes on the drives of a bus; 1 where the guard has stopped them."""
    import gymnasium

    from ...envs.engine.checks import in_range, whole
    from ...envs.environment.deployed import play
    from ...envs.environment.registry import task
    from ...envs.exchange.envelope import Stopped
    from ..policies import Bound, BuiltIn, make, needed

    if arguments.asked(options):
        return arguments.listing(options.env, console)
    whole("--episodes", options.episodes, 1, 10**6)
    in_range("--slow", options.slow, 1e-3, 1.0)
    if options.log and options.log.suffix != ".csv":
        raise ValueError(f"--log = {options.log}: use a name that ends in .csv")
    kind = task(options.env)
    given = needed(options.policy) | dict(options.argument or ())
    example = kind(options.drive, **given)
    axes = [*(example.DRIVES or example.machine.drives)]
    side, close = _side(options, axes)
    env: Any = None
    try:
        made: Any = gymnasium.make(
            kind.ID, drive=options.drive, port=side, disable_env_checker=True, **given
        )
        env = made.unwrapped
        line = env.line
        _limit(line, options, axes)
        line.dry, line.home = options.dry_run, options.home
        policy = make(options.policy, env, options.seed)
        if isinstance(policy, BuiltIn | Bound):
            raise ValueError(f"policy {options.policy!r} gives no actions at the steps of a task")
        _rehearse(example, make(options.policy, example, options.seed), options.seed)
        for axis, guard in line.guards.items():
            console.print(f"{axis}: {guard.envelope}", highlight=False, markup=False)
        console.print(NO_SAFETY, highlight=False)
        if not (options.dry_run or options.yes) and not _agreed(console):
            return 1
        _real_time(console)
        log = _Log(options.log, line) if options.log else None
        try:
            played = play(
                env, policy.act, options.episodes, begin=policy.reset, slow=options.slow,
                seed=options.seed,
            )  # fmt: skip
        except Stopped as stopped:
            console.print(f"stopped: {stopped}", style="red", highlight=False, markup=False)
            return 1
        finally:
            if log is not None:
                log.close()
            _tell(line, console)
        for n, episode in enumerate(played, 1):
            success = "success" if episode.info.get("is_success") else "no success"
            console.print(
                f"episode {n}: return {episode.returned:.3f} by the encoder, {success}, "
                f"{episode.steps} steps, {episode.late} actions late", highlight=False,
            )  # fmt: skip
        return 0
    finally:
        if env is not None:
            env.close()
        close()


def _rehearse(example: Any, policy: Any, seed: int) -> None:
    """A few steps in memory: what is loaded or compiled at its first call is so before power."""
    seen, info = example.reset(seed=seed)
    policy.reset(seen, info)
    for _ in range(3):
        seen, _, ended, _, _ = example.step(policy.act(seen))
        if ended:
            break


def _side(options: argparse.Namespace, axes: list[str]) -> tuple[Any, Any]:
    """The drives on the bus of the options, and what closes it."""
    from ...envs.exchange.over_port import CanDrives, EtherCatDrives

    if options.ethercat:
        from ...drive.wire.soem import SoemMaster

        master = SoemMaster(options.ethercat)
        return EtherCatDrives(master, axes, options.drive), master.close
    from ...drive.wire.bus import CanPort

    nodes = options.node_id or [*range(1, len(axes) + 1)]
    if len(nodes) != len(axes):
        raise ValueError(f"--node-id: {len(nodes)} are given for the drives {', '.join(axes)}")
    bus = buses.opened(options)
    named = dict(zip(axes, nodes, strict=True))
    return CanDrives(CanPort(bus), named, options.drive), bus.shutdown


def _limit(line: Any, options: argparse.Namespace, axes: list[str]) -> None:
    """The envelope as the options narrow it."""
    from dataclasses import replace

    for axis, guard in line.guards.items():
        values: dict[str, float] = {
            name: value
            for name in ("velocity", "acceleration", "jerk")
            if (value := getattr(options, f"max_{name}")) is not None
        }
        for text in options.limits:
            name, _, ends = text.rpartition("=")
            low, _, high = ends.partition(":")
            if name and name not in axes:
                raise ValueError(
                    f"--limits {text}: there is no drive {name!r} of {', '.join(axes)}"
                )
            if name in ("", axis):
                try:
                    values |= {"low": float(low), "high": float(high)}
                except ValueError:
                    raise ValueError(f"--limits {text}: give LOW:HIGH, as x=0.05:0.4") from None
        guard.envelope = replace(guard.envelope, **values)


def _agreed(console: Console) -> bool:
    try:
        answer = console.input("The drives get power and move. Type yes: ")
    except EOFError:
        answer = ""
    if answer.strip() != "yes":
        console.print("nothing has moved (--yes answers by itself)")
    return answer.strip() == "yes"


def _real_time(console: Console) -> None:
    """Ask the system for real time, and say how to get it where it does not give it."""
    missing = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    except (AttributeError, OSError):
        missing.append("SCHED_FIFO (ulimit -r 50, or CAP_SYS_NICE)")
    try:
        locked = ctypes.CDLL(None).mlockall(LOCK_ALL) == 0
    except (AttributeError, OSError):
        locked = False
    if not locked:
        missing.append("locked memory (ulimit -l unlimited, or CAP_IPC_LOCK)")
    if missing:
        console.print(f"without {' and '.join(missing)}", highlight=False)


def _tell(line: Any, console: Console) -> None:
    import numpy as np

    if line.lateness:
        late = np.array(line.lateness) * 1e6
        median, most, worst = np.percentile(late, (50, 99.9, 100))
        console.print(
            f"{len(late)} steps, later than planned by {median:.0f} µs (median), {most:.0f} µs "
            f"(99.9 %), {worst:.0f} µs at most; {line.late} missed, {line.lost} answers lost",
            highlight=False,
        )  # fmt: skip


class _Log:
    """Every answer of the drives, a line each; what is written stays, whatever happens next."""

    def __init__(self, path: Path, line: Any):
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._file)
        self._line, self._headed = line, False
        line.on_step = self._write

    def _write(self, images: Any) -> None:
        names = images.dtype.names
        if not self._headed:
            heads = [f"{axis}.{name}" for axis in self._line.guards for name in names]
            self._rows.writerow(["time", *heads])
            self._headed = True
        values = [image[name].item() for image in images for name in names]
        self._rows.writerow([f"{self._line.time:.6f}", *values])

    def close(self) -> None:
        self._file.close()
