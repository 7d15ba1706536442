"""`servogym deploy`."""

import argparse
import csv
import json
import signal
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from . import bus as buses

NO_SAFETY = (
    "The guard runs on this computer and is not a safety function: keep the emergency stop (STO) "
    "of the machine within reach."
)
CAPTURES = (".pcapng",)
WITHOUT = 0.1  # s that a guard may be told to bear without answers: then watchdogs act


def add(deploy: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    deploy.add_argument("env", metavar="TASK", help="the task, such as LinearAxis-v0")
    deploy.add_argument(
        "--policy", action="append", help=f"{arguments.POLICY} (hold); several are compared on the "
        "same episodes",
    )
    deploy.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    deploy.add_argument(
        "--ethercat", metavar="IFACE", help="network interface; without it the bus is CAN"
    )
    deploy.add_argument(
        "--node-id", type=arguments.NODE_ID, action="append",
        help="node-id of each drive on CAN, in the task's order (1)",
    )
    deploy.add_argument(
        "--episodes", type=arguments.Number(int, 1, 10**6), default=1,
        help="number of episodes, 1 or more (1)",
    )
    arguments.add_seed(deploy, "the first reset")
    deploy.add_argument(
        "--limits", action="append", default=[], metavar="[AXIS=]LOW:HIGH",
        help="position limits of the guard (m or rad) instead of 607Dh; repeatable",
    )
    for name, unit in (("velocity", "m/s or rad/s"), ("acceleration", "m/s²"), ("jerk", "m/s³")):
        deploy.add_argument(
            f"--max-{name}", type=arguments.POSITIVE, help=f"of set-points ({unit})"
        )
    deploy.add_argument(
        "--home", type=arguments.SIGNED_BYTE, metavar="METHOD",
        help="home the drives with this method first",
    )
    deploy.add_argument(
        "--slow", type=arguments.Number(float, 1e-3, 1.0), default=1.0,
        help="apply this share of each action, 0.001..1 (1)",
    )
    deploy.add_argument(
        "--dry-run", action="store_true", help="do everything except switch on the power stage"
    )
    deploy.add_argument("--yes", action="store_true", help="move without asking")
    deploy.add_argument(
        "--log", type=Path, action="append", default=[],
        help="log every step (.csv) or every frame (.pcapng on EtherCAT; .log as candump, .asc, "
        ".blf "
        "on CAN); repeatable",
    )
    deploy.add_argument(
        "--gap", action="store_true",
        help="play the same episodes in memory and report the difference; --twin does so in the "
        "twin",
    )
    deploy.add_argument("--report", type=Path, help="write episodes and times to this .json file")
    deploy.add_argument(
        "--phase", type=arguments.Number(float, 0.0, 0.9),
        help="phase of a step at which set-points are sent, 0..0.9 (0.4)",
    )
    deploy.add_argument(
        "--time-limit", type=arguments.Number(float, 1e-3), help="time limit for all episodes (s)"
    )
    deploy.add_argument(
        "--missed", type=arguments.COUNT, metavar="STEPS",
        help="steps in a row without an answer or action in time, after which the guard stops the "
        "drives (3, or as many as 10 ms have)",
    )
    deploy.add_argument(
        "--lock-step", action="store_true",
        help="let time pass with the steps, for served machines whose clock is sync_end or frame",
    )
    buses.add(deploy)
    arguments.add(deploy)
    deploy.set_defaults(run=_deploy, files=("log", "report"))


def _deploy(options: argparse.Namespace, console: Console) -> int:
    """Play episodes on the drives of a bus; exit status 1 if the guard has stopped them."""
    from ...envs.environment.deployed import episodes_of
    from ...envs.exchange.envelope import Stopped

    if arguments.asked(options):
        return arguments.listing(options.env, console)
    with ExitStack() as stack:
        env, example = _made(options, stack)
        line = env.line
        for axis, guard in line.guards.items():
            console.print(f"{axis}: {guard.envelope}", highlight=False, markup=False)
        for difference in line.differs:
            console.print(difference, style="yellow", highlight=False, markup=False)
        console.print(NO_SAFETY, highlight=False)
        if not (options.dry_run or options.yes) and not _agreed(console):
            return 1
        if hasattr(signal, "SIGHUP"):  # a terminal that is closed, as Ctrl-C and SIGTERM
            signal.signal(signal.SIGHUP, signal.default_int_handler)
        played: dict[str, list[Any]] = {}
        reason = ""
        try:
            for policy in options.policy:
                played[policy] = []
                if len(options.policy) > 1:
                    console.print(policy, style="bold", highlight=False, markup=False)
                for episode in episodes_of(
                    env, episodes=options.episodes, make=options.minds[policy], slow=options.slow,
                    seed=options.seed, fast=not options.lock_step,
                ):
                    played[policy].append(episode)
                    _tell_episode(len(played[policy]), episode, console)
        except (Stopped, KeyboardInterrupt) as stopped:  # a second Ctrl-C comes while it stops
            reason = f"{line.stop(stopped)}"
            console.print(f"stopped: {reason}", style="red", highlight=False, markup=False)
        env.close()
        if line.refused:
            console.print(f"without {' and '.join(line.refused)}", highlight=False)
        for axis in line.unwatched:
            console.print(f"{axis} has no watchdog for a lost master", style="yellow")
        _tell_times(line.timing, console)
        tables = _compared(options, played, example, console)
        _tell_compared(tables, console)
        if options.report:
            report: dict[str, Any] = {
                "episodes": {name: [_row(e) for e in rows] for name, rows in played.items()},
                "stopped": reason, "times": line.timing.as_dict(), "compared": tables,
            }
            options.report.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        return 1 if reason else 0


def _compared(
    options: argparse.Namespace, played: dict[str, list[Any]], example: Any, console: Console
) -> list[dict[str, Any]]:
    """Metrics of policies against the first one, and of each against memory: means, differences."""
    import numpy as np

    from ...envs.environment.deployed import in_memory
    from ...envs.serve import in_process
    from ..evaluate.metrics import difference

    def against(what: str, one: list[Any], other: list[Any]) -> None:
        n = min(len(one), len(other))
        for metric in one[0] if n else ():
            pair = [np.array([[row[metric] for row in rows[:n]]]) for rows in (one, other)]
            apart = difference(*pair, share=True)
            rows.append({
                "what": what, "metric": metric, "episodes": n, "here": float(pair[0].mean()),
                "there": float(pair[1].mean()), "difference": apart.value, "low": apart.low,
                "high": apart.high,
            })

    rows: list[dict[str, Any]] = []
    values = {name: [each.values for each in episodes] for name, episodes in played.items()}
    first, *others = values
    for name in others:
        against(f"{name} - {first}", values[name], values[first])
    if options.gap or options.twin:
        env = in_process.environment(
            options.env, "ethercat" if options.ethercat else "can", options.drive,
            options.given, options.home, _limits(options, example.drive_names),
        )
        for name, own in values.items():  # one after the other, as on the bus
            acting = _policy(name, example, options.seed)
            there, stopped = in_memory(env, acting, len(own), options.seed, options.slow)
            other = "twin" if options.twin else "memory"
            if stopped:
                console.print(
                    f"{name}: the guard stopped episode {len(there) + 1} of {len(own)} in the "
                    f"{other}: {stopped}; the gap is that of the episodes before it",
                    style="yellow", markup=False,
                )
            against(f"{name}: bus - {other}", own, there)
        env.close()
    return rows


def _tell_compared(rows: list[dict[str, Any]], console: Console) -> None:
    from rich.table import Table

    for what in dict.fromkeys(row["what"] for row in rows):
        own = [row for row in rows if row["what"] == what]
        table = Table(title=f"{what}, {own[0]['episodes']} episodes")
        for name in ("metric", "mean", "of the other", "difference", "95 % interval"):
            table.add_column(name, justify="left" if name == "metric" else "right")
        for row in own:
            table.add_row(
                row["metric"], *(f"{row[key]:.4g}" for key in ("here", "there", "difference")),
                f"{row['low']:.3g} .. {row['high']:.3g}",
            )
        console.print(table)


def _made(options: argparse.Namespace, stack: ExitStack) -> tuple[Any, Any]:
    """Make the environment on its bus and the same one in memory; the stack closes the first."""
    import gymnasium

    from ...drive.model.model import load
    from ...envs.engine.checks import whole
    from ...envs.environment.deployed import Mind
    from ...envs.environment.registry import task
    from ...envs.exchange.envelope import Stopped
    from ..policies import needed

    kind = task(options.env)
    options.policy = [*dict.fromkeys(options.policy or ["hold"])]
    given = dict(options.argument or ())
    for policy in options.policy:
        given = needed(policy) | given
    given.setdefault("randomise", {})  # nothing draws the parameters of the machine on the bus
    options.given, options.twin = given, given.get("twin")
    if options.home is not None and not kind.REFERENCED:
        raise ValueError(
            f"--home: {kind.ID} begins without a reference; the method it imitates finds the start"
        )
    example = kind(load(options.drive, "ethercat" if options.ethercat else None), **given)
    axes = example.drive_names
    options.period, options.minds = example.step_time, {}
    limits = _limits(options, axes)
    for policy in options.policy:  # before the bus is there: it is refused, and never has it
        make = partial(_policy, policy, example, options.seed)
        try:
            options.minds[policy] = Mind(make, fast=not options.lock_step)
        except Stopped as stopped:
            raise ValueError(f"--policy {policy}: {stopped}") from None
        stack.callback(options.minds[policy].close)
    side = _side(options, axes, limits, stack)
    made: Any = gymnasium.make(
        kind.ID, drive=example.drive.model, port=side, disable_env_checker=True, **given
    )
    env = made.unwrapped
    stack.callback(env.close)
    line = env.line
    line.dry, line.home = options.dry_run, options.home
    if options.phase is not None:
        line.phase = options.phase
    if options.missed is not None:
        most = max(line.missed, round(WITHOUT / options.period))
        line.missed = whole("--missed", options.missed, 1, most)
    if options.time_limit is not None:
        line.time_limit = options.time_limit
    for path in options.log:
        if path.suffix == ".csv":
            stack.callback(_Log(path, line).close)
    return env, example


def _policy(name: str, example: Any, seed: int) -> Any:
    """Return the policy after a few steps in memory, which load and compile it before power-on.

    Raises ValueError for one that gives no actions, or that knows what no bus tells.
    """
    from ..policies import POLICIES, BuiltIn, make
    from ..policies import Bound as Limit

    row = POLICIES.get(name.partition(":")[0])
    if row is not None and row.informed:
        raise ValueError(f"policy {name!r} is told what was drawn at random: no bus tells it")
    policy = make(name, example, seed)
    if isinstance(policy, BuiltIn | Limit):
        raise ValueError(f"policy {name!r} gives no actions at the steps of a task")
    seen, info = example.reset(seed=seed)
    policy.reset(seen, info)
    for _ in range(3):
        seen, _, ended, _, _ = example.step(policy.act(seen))
        if ended:
            break
    return make(name, example, seed)


def _row(episode: Any) -> dict[str, Any]:
    """Describe an episode for a report."""
    info = {k: v for k, v in episode.info.items() if isinstance(v, int | float | str | bool)}
    return {"return": episode.returned, "steps": episode.steps, "late": episode.late} | info


def _tell_episode(number: int, episode: Any, console: Console) -> None:
    success = "success" if episode.info.get("is_success") else "no success"
    console.print(
        f"episode {number}: return {episode.returned:.3f} by the encoder, {success}, "
        f"{episode.steps} steps, {episode.late} actions late", highlight=False,
    )


def _side(
    options: argparse.Namespace, axes: list[str], limits: dict[str, dict[str, float]],
    stack: ExitStack,
) -> Any:
    """Return the drives on the bus given by the options, with its logs."""
    from ...envs.exchange.over_port import CanDrives, EtherCatDrives, LockStep, Pace

    pace = LockStep() if options.lock_step else Pace()
    frames = [path for path in options.log if path.suffix != ".csv"]
    for path in options.log:
        path.parent.mkdir(parents=True, exist_ok=True)
    if options.ethercat:
        buses.refuse(options, "is for CAN, not for --ethercat", "node_id")
        from ...drive.wire.capture import Capture
        from ...drive.wire.soem import TIMEOUT, SoemMaster
        from ...envs.exchange.over_port import LOCK_STEP_PATIENCE

        for path in frames:
            if path.suffix not in CAPTURES:
                raise ValueError(f"--log {path}: frames of EtherCAT are kept as .pcapng")
            stack.callback(Capture(options.ethercat, path).close)
        patience = LOCK_STEP_PATIENCE if options.lock_step else TIMEOUT
        master = SoemMaster(options.ethercat, timeout=patience)
        stack.callback(master.close)
        return EtherCatDrives(master, axes, options.drive, envelopes=limits, pace=pace)
    from ...drive.canopen.frame import Base
    from ...drive.wire.bus import CanPort
    from ...drive.wire.log import LogFile

    nodes = options.node_id or [*range(1, len(axes) + 1)]
    if len(nodes) != len(axes):
        raise ValueError(f"--node-id: {len(nodes)} are given for the drives {', '.join(axes)}")
    logs = [LogFile(path) for path in frames]
    for log in logs:
        stack.callback(log.stop)

    cycles = 0

    def keep(message: Any) -> None:
        nonlocal cycles
        if options.lock_step:  # the time of the machine: a cycle passes with each SYNC
            cycles += message.arbitration_id == Base.SYNC and not message.is_rx
            message.timestamp = cycles * options.period
        for log in logs:
            log(message)
            log.flush()

    bus = buses.opened(options)
    stack.callback(bus.shutdown)
    named = dict(zip(axes, nodes, strict=True))
    port = CanPort(bus, log=keep if logs else None)
    return CanDrives(port, named, options.drive, envelopes=limits, pace=pace)


def _limits(options: argparse.Namespace, axes: list[str]) -> dict[str, dict[str, float]]:
    """Return the limits that the options give, by drive."""
    most = {name: getattr(options, f"max_{name}") for name in ("velocity", "acceleration", "jerk")}
    limits = {axis: {k: v for k, v in most.items() if v is not None} for axis in axes}
    for text in options.limits:
        name, _, ends = text.rpartition("=")
        low, _, high = ends.partition(":")
        if name and name not in axes:
            raise ValueError(f"--limits {text}: there is no drive {name!r} of {', '.join(axes)}")
        try:
            given = {"low": float(low), "high": float(high)}
        except ValueError:
            raise ValueError(f"--limits {text}: give LOW:HIGH, as x=0.05:0.4") from None
        for axis in [name] if name else axes:
            limits[axis] |= given
    return limits


def _agreed(console: Console) -> bool:
    try:
        answer = console.input("The drives get power and move. Type yes: ")
    except EOFError:
        answer = ""
    if answer.strip() != "yes":
        console.print("nothing has moved (--yes answers by itself)")
    return answer.strip() == "yes"


def _tell_times(timing: Any, console: Console) -> None:
    """Report how late steps were, as percentiles and as a histogram."""
    from rich.table import Table

    rows = timing.rows()
    if not rows:
        return
    edges = timing.EDGES
    table = Table(title=f"{len(timing.waking)} steps of {1e3 * timing.period:g} ms, times in µs")
    for name in ("", *(row.what for row in rows)):
        table.add_column(name, justify="right")
    for name, key in (("median", "median"), ("99 %", "p99"), ("99.9 %", "p999"), ("most", "most")):
        table.add_row(name, *(f"{getattr(row, key):.0f}" for row in rows))
    table.add_section()
    for n, name in enumerate([*(f"<{edge:g}" for edge in edges[1:-1]), "more"]):
        table.add_row(name, *(f"{row.counts[n] or ''}" for row in rows))
    console.print(table)
    console.print(
        f"{timing.missed} set-points a step late, {timing.lost} steps without all answers, "
        f"{timing.stale} actions not in time, at most {timing.in_a_row} in a row; the policy took "
        f"{timing.share:.0%} of the time", highlight=False,
    )


class _Log:
    """Writes every answer of the drives as a line, with the last command.

    Written lines stay, whatever happens next.
    """

    def __init__(self, path: Path, line: Any):
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._file)
        self._line, self._headed = line, False
        line.on_step = self._write

    def _write(self, images: Any) -> None:
        if self._line.sent is None:  # before the first command
            return
        both = self._line.sent, images
        if not self._headed:
            heads = [f"{axis}:{name}" for each in both for axis in self._line.guards
                     for name in each.dtype.names]
            self._rows.writerow(["time (s)", *heads])
            self._headed = True
        values = [row[name].item() for each in both for row in each for name in each.dtype.names]
        self._rows.writerow([f"{self._line.time:.6f}", *values])

    def close(self) -> None:
        self._file.close()
