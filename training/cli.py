"""The command line ``servogym``."""

import argparse
import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich import get_console
from rich.console import Console
from rich.table import Table

from ..drive.abort import SdoAbort

POLICY = "name, FILE.py:function, or folder of a training"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="servogym",
        description="A laboratory for motion control: axes in MuJoCo, moved by an emulated drive.",
    )
    parser.add_argument("--version", action="version", version=f"servogym {version('servogym')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")

    demo = commands.add_parser("demo", help="enable, home, move, follow ruckig, quick stop")
    demo.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    demo.add_argument("--out", type=Path, default=Path("out"), help="folder for scope.png")
    demo.add_argument("--payload", type=float, default=5.0, help="kg on the carriage (5)")
    demo.set_defaults(run=_demo)

    bench = commands.add_parser("bench", help="cost of the drive beside mj_step, start times")
    bench.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    bench.add_argument("--repeat", type=int, default=200, help="pairs of blocks (200)")
    bench.add_argument("--can", action="store_true", help="SDO servers, and drives in lock-step")
    bench.add_argument(
        "--envs", action="store_true", help="the environments, beside the loop and their peers"
    )
    bench.add_argument("--train", action="store_true", help="PPO on our vector and on DummyVecEnv")
    bench.add_argument("--json", action="store_true", help="machine-readable")
    bench.set_defaults(run=_bench)

    drives = commands.add_parser("drives", help="list the drive models, or tell about one")
    drives.add_argument("model", nargs="?", help="name or folder of a model")
    drives.set_defaults(run=_drives)

    node = commands.add_parser("node", help="serve drives as CANopen nodes on a bus, in real time")
    node.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    node.add_argument("--node-id", type=int, action="append", help="1..127 (1); repeatable")
    node.add_argument(
        "--axis", default="linear", help="linear, vertical, gantry or gantry-x1x2 (linear)"
    )
    node.add_argument("-i", "--interface", default="udp_multicast", help="of python-can")
    node.add_argument("-c", "--channel", default="239.74.163.2", help="of python-can")
    node.add_argument("-b", "--bitrate", type=int, default=1_000_000, help="bit/s (1000000)")
    node.add_argument("--log", help="file for all frames; .log candump, .asc, .blf ...")
    node.set_defaults(run=_node)

    eds = commands.add_parser("eds", help="write the EDS or DCF of a drive model (CiA 306)")
    eds.add_argument("model", help="name or folder of a model")
    eds.add_argument("-o", "--out", type=Path, required=True, help="file .eds or .dcf")
    eds.add_argument("--dcf", action="store_true", help="with the values of one node")
    eds.add_argument("--node-id", type=int, help="1..127, for --dcf")
    eds.set_defaults(run=_eds)

    decode = commands.add_parser("decode", help="print a CAN log by meaning")
    decode.add_argument("log", type=Path, help=".log of candump, .asc, .blf, .trc, .csv")
    decode.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    decode.add_argument(
        "--node-id", type=int, nargs="+", action="extend", help="nodes that are such a drive (all)"
    )
    decode.set_defaults(run=_decode)

    homing = commands.add_parser("homing", help="draw the homing methods from real runs")
    homing.add_argument("--gallery", type=Path, required=True, help="folder for the pictures")
    homing.add_argument("--method", type=int, action="append", help="only this one; repeatable")
    homing.add_argument("--format", choices=("svg", "png"), default="svg")
    homing.set_defaults(run=_homing)

    watch = commands.add_parser("watch", help="see an environment move, in a window or recorded")
    watch.add_argument("env", metavar="ENV", help="such as LinearAxis-v0")
    watch.add_argument("--policy", default="hold", help=f"{POLICY} (hold)")
    watch.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    watch.add_argument("--episodes", type=int, default=1, help="1 or more (1)")
    watch.add_argument("--seed", type=int, default=0, help="of the first reset (0)")
    watch.add_argument("--speed", type=float, default=1.0, help="1 is real time (1)")
    watch.add_argument("--record", type=Path, help=".mp4, .gif, or a folder; else a window")
    watch.set_defaults(run=_watch)
    train = commands.add_parser("train", help="train a policy with stable-baselines3")
    train.add_argument("env", help="id of an environment, as LinearAxis-v0")
    train.add_argument("--drive", help="drive model, see `servogym drives` (generic)")
    train.add_argument("--algorithm", choices=("PPO", "SAC"), type=str.upper, help="(PPO)")
    train.add_argument("--seed", type=int, help="of environments, weights and actions (0)")
    train.add_argument("--steps", type=int, help="of all environments together")
    train.add_argument("--envs", type=int, help="environments side by side")
    _add_arguments(train)
    train.add_argument("--out", type=Path, help="folder (out/ENV-DRIVE-ALGORITHM-SEED)")
    train.add_argument("--resume", action="store_true", help="from the latest checkpoint in it")
    train.add_argument("--checkpoint-every", type=int, help="steps")
    train.add_argument("--evaluate-every", type=int, help="steps")
    train.set_defaults(run=_train)

    curves = commands.add_parser("curves", help="draw the learning curves of trainings")
    curves.add_argument("folder", type=Path, help="of a training, or with several in seed_*")
    curves.add_argument("-o", "--out", type=Path, default=Path("out/curves.png"), help="picture")
    curves.set_defaults(run=_curves)
    for name, what in (("eval", "one policy on fixed episodes"), ("compare", "several policies")):
        command = commands.add_parser(name, help=f"{what}: table, data, picture")
        command.add_argument("env", help="environment, as LinearAxis-v0")
        if name == "eval":
            command.add_argument("--policy", required=True, help=POLICY)
        else:
            command.add_argument("--policies", required=True, help="names, separated by commas")
        command.add_argument("--drive", default="generic", help="model, see `servogym drives`")
        command.add_argument("--episodes", type=int, default=50, help="1..1000 (50)")
        command.add_argument("--seed", type=int, default=0, help="of the episodes (0)")
        command.add_argument("--trace", type=int, default=0, help="episode to be drawn (0)")
        _add_arguments(command)
        command.add_argument("--out", type=Path, default=Path("out"), help="folder (out)")
        command.set_defaults(run=_compare)

    results = commands.add_parser("results", help="write the page of what was learned")
    results.add_argument("folder", nargs="?", type=Path, help="with a folder a task (ours)")
    results.set_defaults(run=_results)

    benchmark = commands.add_parser("benchmark", help="homing methods, positioning strategies")
    benchmark.add_argument("what", choices=("homing", "positioning"))
    benchmark.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    benchmark.add_argument("--quick", action="store_true", help="a small part of it")
    benchmark.add_argument("--out", type=Path, default=Path("out"), help="folder (out)")
    benchmark.set_defaults(run=_benchmark)
    return parser


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--argument", action="append", metavar="NAME=VALUE", type=_named,
        help="of the environment, VALUE in JSON or text; repeatable",
    )  # fmt: skip


def _named(text: str) -> tuple[str, Any]:
    """``"payload=3"`` -> ``("payload", 3)``."""
    name, equals, value = text.partition("=")
    if not (name.isidentifier() and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def _demo(options: argparse.Namespace, console: Console) -> int:
    from . import demo

    return demo.run(options.drive, options.out, options.payload, console)


def _bench(options: argparse.Namespace, console: Console) -> int:
    if options.repeat < 1:
        raise ValueError(f"--repeat = {options.repeat} is out of range 1..")
    if options.train:
        from . import train_bench

        return train_bench.run(options.drive, options.json, console)
    if options.can:
        from . import can_bench

        return can_bench.run(options.repeat, options.json, console)
    if options.envs:
        from . import env_bench

        return env_bench.run(options.drive, options.repeat, options.json, console)
    from . import bench

    return bench.run(options.drive, options.repeat, options.json, console)


def _node(options: argparse.Namespace, console: Console) -> int:
    from . import node

    return node.run(
        options.drive, options.node_id or [1], options.axis, options.interface, options.channel,
        options.bitrate, options.log, console,
    )  # fmt: skip


def _eds(options: argparse.Namespace, console: Console) -> int:
    from . import eds

    return eds.run(options.model, options.out, options.dcf, options.node_id, console)


def _decode(options: argparse.Namespace, console: Console) -> int:
    from . import decode

    return decode.run(options.log, options.drive, options.node_id)


def _homing(options: argparse.Namespace, console: Console) -> int:
    from . import homing_gallery

    return homing_gallery.run(options.gallery, options.method, options.format, console)


def _watch(options: argparse.Namespace, console: Console) -> int:
    from . import watch

    return watch.run(
        options.env, options.policy, options.drive, options.episodes, options.seed,
        options.speed, options.record, console,
    )  # fmt: skip


def _curves(options: argparse.Namespace, console: Console) -> int:
    from . import curves

    return curves.run(options.folder, options.out, console)


def _train(options: argparse.Namespace, console: Console) -> int:
    from . import train

    console = get_console()  # on which the bar lives: what is printed comes above it
    given = {
        name: getattr(options, name)
        for name in ("steps", "checkpoint_every", "evaluate_every")
        if getattr(options, name) is not None
    }
    return train.run(
        options.env, options.out, console, resume=options.resume, drive=options.drive,
        algorithm=options.algorithm, seed=options.seed, envs=options.envs,
        arguments=dict(options.argument) if options.argument else None,
        progress=console.is_terminal, **given,
    )  # fmt: skip


def _compare(options: argparse.Namespace, console: Console) -> int:
    from . import compare

    single = options.command == "eval"
    policies = [options.policy] if single else [p for p in options.policies.split(",") if p]
    if not policies:
        raise ValueError("--policies is empty: give names, separated by commas")
    return compare.run(
        options.command, options.env, policies, options.drive, options.episodes, options.seed,
        options.out, console, dict(options.argument or ()), options.trace,
    )  # fmt: skip


def _results(options: argparse.Namespace, console: Console) -> int:
    from . import results
    from .policies import SHIPPED

    return results.run(options.folder or SHIPPED, console)


def _benchmark(options: argparse.Namespace, console: Console) -> int:
    if options.what == "homing":
        from .homing_benchmark import run
    else:
        from .positioning_benchmark import run
    return run(options.drive, options.quick, options.out, console)


def _drives(options: argparse.Namespace, console: Console) -> int:
    from ..drive.model import load, model_names

    if options.model is None:
        table = Table("model", "title", "modes", "position cycle (µs)")
        for name in model_names():
            model = load(name)
            table.add_row(
                name, model.title, _modes(model), f"{model.cycle_time['position'] * 1e6:g}"
            )
        console.print(table)
        return 0
    model = load(options.model)
    own = [fault for fault in model.faults if fault.cause]
    faults = [f"{fault.name} {fault.code:04X}h {fault.meaning}".strip() for fault in own]
    if len(own) < len(model.faults):
        faults.append(f"{len(model.faults) - len(own)} more by injection, see faults.csv")
    page = model.folder / "README.md"
    table = Table(show_header=False, title=model.title)
    for key, value in (
        ("model", model.name),
        ("standard", model.standard),
        ("bus", model.bus),
        ("axes", "1" if model.axes == 1 else f"{model.axes}, with consecutive node-ids"),
        ("identity", _identity(model)),
        ("modes", _modes(model)),
        ("homing methods", " ".join(map(str, model.homing_methods))),
        *((f"{n} cycle", f"{t * 1e6:g} µs") for n, t in model.cycle_time.items()),
        ("objects", str(len(model.objects))),
        ("PDOs", f"{len(model.rpdos)} receive, {len(model.tpdos)} transmit"),
        ("faults", "\n".join(faults)),
        ("quirks", "\n".join(f"{n} = {q.value} ({q.source})" for n, q in model.quirks.items())),
    ):
        table.add_row(key, value or "none")
    console.print(table)
    if page.is_file():
        print(f"what is inferred, what is not supported: {page}")
    return 0


def _identity(model) -> str:
    """Identity object 1018h, as far as the model has it."""
    parts = ("vendor-id", "product code", "revision", "serial number")
    rows = [(part, model.objects.get((0x1018, n))) for n, part in enumerate(parts, start=1)]
    return "\n".join(f"{part} {row.default:08X}h" for part, row in rows if row)


def _modes(model) -> str:
    from ..drive.words import MODE_ABBREVIATION

    return " ".join(MODE_ABBREVIATION[mode] for mode in model.modes)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; what a user got wrong is one line on stderr and exit status 2."""
    options = _parser().parse_args(arguments)
    console = Console()
    try:
        return options.run(options, console)
    except (ValueError, OSError, TimeoutError, RuntimeError, ImportError, SdoAbort) as error:
        print(f"servogym {options.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
