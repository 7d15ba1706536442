"""`servogym deploy`."""

import argparse
import json
import signal
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import Console

from . import arguments, deploy_report
from . import bus as buses

if TYPE_CHECKING:
    from ...envs.environment.deployed import Played
    from ...envs.environment.policy_process import PolicyProcess
    from ...envs.environment.servo_env import ServoEnv

NO_SAFETY = (
    "The guard runs on this computer and is not a safety function: keep the emergency stop (STO) "
    "of the machine within reach."
)
CAPTURES = (".pcapng",)
WITHOUT_ANSWERS = 0.1  # s, the longest for --missed: then the watchdogs of the drives act


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
        ".blf on CAN); repeatable",
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


class _Prepared(NamedTuple):
    """What is made and checked before the bus is opened."""

    kind: "type[ServoEnv]"
    given: dict[str, Any]  # arguments of the environment
    example: "ServoEnv"  # the environment in memory
    limits: dict[str, dict[str, float]]  # of the guard, by drive
    policies: "dict[str, PolicyProcess]"


def _deploy(options: argparse.Namespace, console: Console) -> int:
    """Play episodes on the drives of a bus; exit status 1 if the guard has stopped them."""
    if arguments.asked(options):
        return arguments.listing(options.env, console)
    if options.ethercat:
        from ...drive.wire.soem import check_access

        check_access(options.ethercat)
    with ExitStack() as stack:
        prepared = _prepared(options, stack)
        with ExitStack() as bus:
            env = _on_the_bus(options, prepared, bus)
            line: Any = env.line
            for axis, guard in line.guards.items():
                console.print(f"{axis}: {guard.envelope}", highlight=False, markup=False)
            for difference in line.differs:
                console.print(difference, style="yellow", highlight=False, markup=False)
            line.check(prepared.kind.REFERENCED)
            console.print(NO_SAFETY, highlight=False)
            if not (options.dry_run or options.yes) and not _agreed(console):
                return 1
            played, reason = _played(options, prepared, env, console)
        if line.refused:
            console.print(f"without {' and '.join(line.refused)}", highlight=False)
        for axis in line.unwatched:
            console.print(f"{axis} has no watchdog for a lost master", style="yellow")
        deploy_report.tell_times(line.timing, console)
        rows = _compared(options, prepared, played, console)
    deploy_report.tell_compared(rows, console)
    if options.report:
        report: dict[str, Any] = {
            "episodes": {name: [_row(each) for each in own] for name, own in played.items()},
            "stopped": reason, "times": line.timing.as_dict(), "compared": rows,
        }
        options.report.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return 1 if reason else 0


def _prepared(options: argparse.Namespace, stack: ExitStack) -> _Prepared:
    """Make the environment in memory and the policies, and check the options; no bus is open yet.

    Raises ValueError for what cannot be made or does not belong to the task.
    """
    from ...drive.model.model import load
    from ...envs.engine.checks import whole
    from ...envs.environment.policy_process import PolicyProcess
    from ...envs.environment.registry import task
    from ...envs.exchange.envelope import Stopped
    from ...envs.exchange.over_port import steps_bridged
    from ..policies import needed

    kind = task(options.env)
    if options.ethercat:
        buses.refuse(options, "is for CAN, not for --ethercat", "node_id")
        for path in options.log:
            if path.suffix not in (*CAPTURES, ".csv"):
                raise ValueError(f"--log {path}: frames of EtherCAT are kept as .pcapng")
    if options.home is not None and not kind.REFERENCED:
        raise ValueError(
            f"--home: {kind.ID} begins without a reference; the method it imitates finds the start"
        )
    options.policy = [*dict.fromkeys(options.policy or ["hold"])]
    given = dict(options.argument or ())
    for policy in options.policy:
        given = needed(policy) | given
    given.setdefault("randomise", {})  # nothing draws the parameters of the machine on the bus
    model = load(options.drive, "ethercat" if options.ethercat else None)
    if options.home is not None and options.home not in model.homing_methods:
        known = ", ".join(map(str, sorted(model.homing_methods)))
        raise ValueError(f"--home {options.home}: drive {model.name!r} has the methods {known}")
    example = kind(model, **given)
    axes, period = example.drive_names, example.step_time
    limits = _limits(options, axes)
    if options.node_id and len(options.node_id) != len(axes):
        raise ValueError(
            f"--node-id: {len(options.node_id)} are given for the drives {', '.join(axes)}"
        )
    if options.missed is not None:
        most = max(steps_bridged(period), round(WITHOUT_ANSWERS / period))
        whole("--missed", options.missed, 1, most)
    policies: dict[str, PolicyProcess] = {}
    for policy in options.policy:
        make = partial(made_policy, policy, example, options.seed)
        try:
            policies[policy] = PolicyProcess(make, fast=not options.lock_step)
        except Stopped as stopped:
            raise ValueError(f"--policy {policy}: {stopped}") from None
        stack.callback(policies[policy].close)
    return _Prepared(kind, given, example, limits, policies)


def made_policy(name: str, example: "ServoEnv", seed: int) -> Any:
    """Make a policy after some steps of it in memory, which load and compile what it needs.

    Raises ValueError for one that returns no actions, or that is given what no bus transmits.
    """
    from ..policies import POLICIES, BuiltIn, make
    from ..policies import Bound as Limit

    row = POLICIES.get(name.partition(":")[0])
    if row is not None and row.informed:
        raise ValueError(f"policy {name!r} is told what was drawn at random: no bus tells it")
    policy = make(name, example, seed)
    if isinstance(policy, BuiltIn | Limit):
        raise ValueError(f"policy {name!r} gives no actions at the steps of a task")
    observation, info = example.reset(seed=seed)
    policy.reset(observation, info)
    for _ in range(3):
        observation, _, ended, _, _ = example.step(policy.act(observation))
        if ended:
            break
    return make(name, example, seed)


def _on_the_bus(options: argparse.Namespace, prepared: _Prepared, stack: ExitStack) -> "ServoEnv":
    """Open the bus and make the environment on it; the stack closes both."""
    import gymnasium

    side = _side(options, prepared, stack)
    made: Any = gymnasium.make(
        prepared.kind.ID, drive=prepared.example.drive.model, port=side, disable_env_checker=True,
        **prepared.given,
    )
    env: ServoEnv = made.unwrapped
    stack.callback(env.close)
    line: Any = env.line
    line.dry, line.home = options.dry_run, options.home
    for name in ("phase", "missed", "time_limit"):
        if getattr(options, name) is not None:
            setattr(line, name, getattr(options, name))
    for path in options.log:
        if path.suffix == ".csv":
            stack.callback(deploy_report.StepLog(path, line).close)
    return env


def _side(options: argparse.Namespace, prepared: _Prepared, stack: ExitStack) -> Any:
    """Return the drives on the bus given by the options, with its logs."""
    from ...envs.exchange.over_port import (
        LOCK_STEP_PATIENCE,
        CanDrives,
        EtherCatDrives,
        LockStep,
        Pace,
    )

    axes, limits = prepared.example.drive_names, prepared.limits
    pace = LockStep() if options.lock_step else Pace()
    frames = [path for path in options.log if path.suffix != ".csv"]
    for path in options.log:
        path.parent.mkdir(parents=True, exist_ok=True)
    if options.ethercat:
        from ...drive.wire.capture import Capture
        from ...drive.wire.soem import TIMEOUT, SoemMaster

        for path in frames:
            stack.callback(Capture(options.ethercat, path).close)
        patience = LOCK_STEP_PATIENCE if options.lock_step else TIMEOUT
        master = SoemMaster(options.ethercat, timeout=patience)
        stack.callback(master.close)
        return EtherCatDrives(master, axes, options.drive, envelopes=limits, pace=pace)
    from ...drive.canopen.frame import Base
    from ...drive.wire.bus import CanPort
    from ...drive.wire.log import LogFile

    logs = [LogFile(path) for path in frames]
    for log in logs:
        stack.callback(log.stop)

    cycles = 0

    def keep(message: Any) -> None:
        nonlocal cycles
        if options.lock_step:  # the time of the machine: a cycle passes with each SYNC
            cycles += message.arbitration_id == Base.SYNC and not message.is_rx
            message.timestamp = cycles * prepared.example.step_time
        for log in logs:
            log(message)
            log.flush()

    bus = buses.opened(options)
    stack.callback(bus.shutdown)
    nodes = dict(zip(axes, options.node_id or range(1, len(axes) + 1), strict=False))
    port = CanPort(bus, log=keep if logs else None)
    return CanDrives(port, nodes, options.drive, envelopes=limits, pace=pace)


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


def _played(
    options: argparse.Namespace, prepared: _Prepared, env: "ServoEnv", console: Console
) -> "tuple[dict[str, list[Played]], str]":
    """Play the episodes with each policy; return them, and why the drives were stopped if so."""
    from ...envs.environment.deployed import episodes_of
    from ...envs.exchange.envelope import Stopped

    if hasattr(signal, "SIGHUP"):  # a terminal that is closed, like Ctrl-C and SIGTERM
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    line: Any = env.line
    played: dict[str, list[Played]] = {}
    reason = ""
    try:
        for name, policy in prepared.policies.items():
            played[name] = []
            if len(prepared.policies) > 1:
                console.print(name, style="bold", highlight=False, markup=False)
            for episode in episodes_of(
                env, episodes=options.episodes, make=policy, slow=options.slow,
                seed=options.seed, fast=not options.lock_step,
            ):
                played[name].append(episode)
                _tell_episode(len(played[name]), episode, console)
    except (Stopped, KeyboardInterrupt) as stopped:  # a second Ctrl-C comes while it stops
        reason = f"{line.stop(stopped)}"
        console.print(f"stopped: {reason}", style="red", highlight=False, markup=False)
    env.close()
    return played, reason


def _compared(
    options: argparse.Namespace, prepared: _Prepared, played: "dict[str, list[Played]]",
    console: Console,
) -> list[dict[str, Any]]:
    """Compare the policies with the first one and, for the gap, each with memory or the twin."""
    from ...envs.environment.deployed import in_memory
    from ...envs.serve import in_process

    values = {name: [each.values for each in episodes] for name, episodes in played.items()}
    first, *others = values
    rows: list[dict[str, Any]] = []
    for name in others:
        rows += deploy_report.rows(f"{name} - {first}", values[name], values[first])
    twin = prepared.given.get("twin")
    if not (options.gap or twin):
        return rows
    other = "twin" if twin else "memory"
    env = in_process.environment(
        options.env, "ethercat" if options.ethercat else "can", options.drive, prepared.given,
        options.home, prepared.limits,
    )
    for name, own in values.items():  # one after the other, as on the bus
        policy = prepared.policies[name]
        policy.renew()
        there, stopped = in_memory(env, policy, len(own), options.seed, options.slow)
        if stopped:
            console.print(
                f"{name}: episode {len(there) + 1} of {len(own)} was stopped in the {other}: "
                f"{stopped}; the gap is that of the episodes before it",
                style="yellow", markup=False,
            )
        rows += deploy_report.rows(f"{name}: bus - {other}", own, there)
    env.close()
    return rows


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
