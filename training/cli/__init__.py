"""The command line ``servogym``: a table of commands, each in a module of its own."""

import argparse
import atexit
import ctypes
import gc
import importlib
import io
import os
import re
import signal
import sys
import textwrap
import threading
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console

from .arguments import COUNT, add_run_code, consent


@dataclass(frozen=True)
class Command:
    """A row of the command table.

    Args:
        module: module of this package, imported only when its command is used. Its function
            ``add_NAME`` or ``add`` declares the options of the command.
        purpose: purpose of the command in one line, shown in the list of commands.
        example: command line that works as printed, without the program's name.
        more: further text of ``--help``.
    """

    module: str
    purpose: str
    example: str
    more: str = ""


COMMANDS = {
    "demo": Command(
        "demo", "enable, home and move an axis, then stop it, and draw the run",
        "demo --drive kollmorgen_akd --payload 10 --out out",
        "This is the quickest check of an installation: it prints the accuracy of each part.",
    ),
    "bench": Command(
        "bench", "measure the cost of drives, buses and environments", "bench --json",
        "The figures are ratios within one run, because computers differ and may be busy.",
    ),
    "drives": Command(
        "drives", "list the drive models, describe one, or make one from a file or a slave",
        "drives kollmorgen_akd",
    ),
    "node": Command(
        "node", "serve drives with moving axes as CANopen nodes, in real time",
        "node --drive festo_cmmp_as --node-id 1 -i udp_multicast -c 239.74.163.2 --log run.log",
        "Any CANopen master can enable, home and move them. udp_multicast needs no hardware.",
    ),
    "ethercat": Command(
        "ethercat", "serve drives with moving axes as EtherCAT slaves on a network interface",
        "ethercat --udp --drive kollmorgen_akd --slaves 2 --log run.pcapng",
        "Unmodified masters bring them to OP. -i INTERFACE is a raw Ethernet port, which needs "
        "root or CAP_NET_RAW; docs/how-to/ethercat.md shows how to make a virtual pair.",
    ),
    "serve": Command(
        "serve", "serve a whole machine on its buses, as a machine file describes it",
        "serve machine.toml --seed 1",
        "Use it to test your own master; servogym.testing offers the same as pytest fixtures. "
        "docs/how-to/serve.md has a machine.toml.",
    ),
    "deploy": Command(
        "deploy", "play a policy on the drives of a bus, behind a guard",
        "deploy LinearAxis-v0 --policy trapezoid --slow 0.2 --home 17 -i socketcan -c can0",
        "Task, observations and policy are the same as in memory. CAN uses python-can, EtherCAT "
        "uses SOEM.",
    ),
    "eds": Command(
        "sheets", "write the EDS or DCF of a drive model (CiA 306)",
        "eds festo_cmmp_as -o festo.eds",
    ),
    "esi": Command(
        "sheets", "write the EtherCAT device description (ESI) or EEPROM image of a drive model",
        "esi kollmorgen_akd -o akd.xml",
    ),
    "observe": Command(
        "observe", "read out a drive on CAN or EtherCAT, and compare it with a drive model",
        "observe --node-id 5 -i socketcan -c can0 -o drive.json",
        "The power stage stays off. Next: servogym observe --compare drive.json --drive generic.",
    ),
    "decode": Command(
        "decode", "explain a log of a CAN or EtherCAT bus, frame by frame",
        "decode run.log --drive festo_cmmp_as",
    ),
    "machines": Command(
        "machines", "size an axis: inertia ratio, torque, resonance, margins, profile",
        "machines toothed_belt --drive kollmorgen_akd --set payload=20",
        "Without a name, the command prints a table of all machines with the drive.",
    ),
    "bode": Command(
        "bode", "measure the loops of a drive: Bode plot, margins, inertia, resonances",
        "bode vertical --drive generic",
    ),
    "tune": Command(
        "tune", "measure an axis, fit the gains of its drive to margins, and store them",
        "tune toothed_belt --detuned 3",
    ),
    "twin": Command(
        "twin", "turn a bus log into a model of the machine, with intervals and a verdict",
        "twin moves.log --drive generic --mechanics auto -o out/twin",
        "The log has to contain the frames of the master and of the drive (607Ah, 6041h, 6064h, "
        "6077h). --plan writes the experiment to record; docs/how-to/twin.md records a moves.log.",
    ),
    "replay": Command(
        "replay", "play a log into a drive model and score its answers, or into a machine",
        "replay run.pcapng --drive kollmorgen_akd",
        "Without a machine, each answer is equal, explained by time or by physics, or differs; for "
        "a difference, register or object are printed with both values. With a machine or --twin, "
        "the set-points of the log move it, and the measured and simulated position and torque are "
        "written to a CSV.",
    ),
    "scope": Command(
        "scope", "record channels of a move, a running node or a log, with a trigger",
        "scope rigid --channels 6064h,axis.torque --trigger 6064h:rising:20000",
    ),
    "homing": Command(
        "homing", "draw a diagram of each homing method from a simulated run",
        "homing --gallery out/homing",
    ),
    "watch": Command(
        "watch", "show a policy in an environment, in a window or as a video",
        "watch LinearAxis-v0 --policy ruckig --record out/run.gif",
    ),
    "panel": Command(
        "panel", "commission a drive in the browser: state, motion, scope, Bode, lessons",
        "panel --axis vertical --drive festo_cmmp_as",
    ),
    "classroom": Command(
        "classroom", "serve a machine for each pupil in the browser, and a wall for the teacher",
        "classroom --pupils 24 --host 0.0.0.0 --results out/class",
        "Pupils open the printed address and enter the class code and a name.",
    ),
    "course": Command(
        "course", "list the exercises of the course, show one, or check solutions in Python",
        "course show 12_stop_it",
        "`check solution.py` runs the file: check only solutions whose author you trust. `replay` "
        "replays a run that a classroom has stored.",
    ),
    "train": Command(
        "train", "train a policy with stable-baselines3",
        "train LinearAxis-v0 --steps 200000 --seed 1 --out out/axis",
    ),
    "tune-policy": Command(
        "tune_policy", "fit the numbers of a baseline, and report the effort",
        "tune-policy basis_feed_forward --out out/tuned.npz",
        "The effort is counted as for a training: steps, processor time, manual choices.",
    ),
    "curves": Command(
        "train", "draw the learning curves of trainings", "curves out/axis",
    ),
    "eval": Command(
        "compare", "play one policy on fixed episodes: table, data, picture",
        "eval LinearAxis-v0 --policy ruckig",
    ),
    "compare": Command(
        "compare", "play several policies on the same episodes: table, data, picture",
        "compare LinearAxis-v0 --policies hold,trapezoid,ruckig",
    ),
    "results": Command(
        "results", "write the page of learned policies, check submissions, repeat trainings",
        "results",
    ),
    "benchmark": Command(
        "benchmark", "compare homing methods, positioning strategies or learned policies",
        "benchmark positioning",
    ),
    "sweep": Command(
        "sweep", "play or train in each cell of tasks, drives, conditions, seeds and values",
        "sweep LinearAxis-v0 --policies trapezoid,ruckig --drives generic,kollmorgen_akd",
    ),
}
FORMAT = warnings.formatwarning
OF_LIBRARIES = (SystemError, ctypes.ArgumentError)  # errors that Ctrl-C causes in C libraries
# one thread for NumPy's linear algebra: with our small matrices, threads would only wait
BLAS = "OPENBLAS_NUM_THREADS"


def _path(text: str) -> Path:
    """Parse a path; an empty word is refused, because it would mean the working directory."""
    if not text.strip():
        raise argparse.ArgumentTypeError("it is empty, give a path")
    return Path(text)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors suggest similar names."""

    commands: dict[str, "Parser"]

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        self.register("type", Path, _path)
        self.register("type", int, COUNT)  # bit rates of python-can
        self._negative_number_matcher = re.compile(r"-\.?\d")  # not an option: -1e-3 as well

    def error(self, message: str) -> NoReturn:
        """Print usage, error and similar names; exit with status 2."""
        from ...drive.model.names import hint

        if wrong := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            known = re.findall(r"[^\s,']+", wrong[2])
            remark = hint(wrong[1], known)
            message = f"{message.partition('invalid choice')[0]}there is no {wrong[1]!r}: {remark}"
        super().error(message)

    def refuse(self, unknown: list[str]) -> NoReturn:
        """Refuse unknown options and words."""
        from ...drive.model.names import hint

        known = [*self._option_string_actions]
        options = [word.partition("=")[0] for word in unknown if word.startswith("-")]
        hints = [hint(option, known) for option in options if option.startswith("--")]
        hints = [f"; {remark}" for remark in hints if remark.startswith("did")]
        self.error(f"unrecognized: {' '.join(unknown)}{hints[0] if hints else ''}")


class Version(argparse.Action):
    """The option ``--version``, which looks the version up when it is used."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print the version and exit."""
        from ... import __version__

        print(f"servogym {__version__}")
        parser.exit()


def parser(asked: str | None = None) -> Parser:
    """All commands by name, with the options of the command `asked` for, or of all commands."""
    parser = Parser(
        prog="servogym",
        description="A laboratory for motion control: axes in MuJoCo, moved by an emulated drive.",
    )
    parser.add_argument("--version", action=Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    for name, row in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=row.purpose,
            description=textwrap.fill(
                f"{row.purpose[0].upper()}{row.purpose[1:]}. {row.more}", 78,
                break_on_hyphens=False,
            ),
            formatter_class=argparse.RawDescriptionHelpFormatter,  # an example stays one line
        )
        if asked in (None, name):
            of = importlib.import_module(f".{row.module}", __name__)
            (getattr(of, f"add_{name}", None) or of.add)(command)
            add_run_code(command)
        note = textwrap.fill(command.epilog or "", 78, break_on_hyphens=False)
        command.epilog = f"example:\n  servogym {row.example}\n\n{note}".rstrip()
    parser.commands = commands.choices
    return parser


def _joined(words: list[str]) -> list[str]:
    """Join ``hold, ruckig`` into one word, as if there were no space after the comma."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1].endswith(",") and len(joined[-1]) > 1 and word[:1] not in "-":
            joined[-1] += word
        else:
            joined.append(word)
    return joined


def _parsed(words: list[str]) -> argparse.Namespace:
    own = parser(next((word for word in words if not word.startswith("-")), ""))
    options, unknown = own.parse_known_args(words)
    if unknown:
        own.commands[options.command].refuse(unknown)
    return options


def _line(error: BaseException) -> str:
    """Format an error of the user, their task or policy in a line; empty for an internal error."""
    from ...drive.objects.abort import SdoAbort

    if not isinstance(error, (ValueError, OSError, RuntimeError, ImportError, SdoAbort)):
        from ...envs.engine.checks import error_line, place_of

        return error_line(error) if place_of(error) else ""
    if isinstance(error, OSError) and error.strerror:  # the system's words, without the number
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


def _warned(
    message: Warning | str, category: type[Warning], filename: str, lineno: int,
    line: str | None = None,
) -> str:
    """Format a warning to the user in a line; other warnings keep their place in the code."""
    if category is UserWarning:
        return f"servogym: {message}\n"
    return FORMAT(message, category, filename, lineno, line)


def _leave() -> None:
    """Skip the garbage collection at exit, which takes 0.6 s, unless triton needs it.

    Further signals are ignored: Python has removed the handlers by now, so they would kill.
    """
    if "triton" not in sys.modules:
        gc.freeze()
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; a user's mistake gives one line on stderr and exit status 2.

    SIGTERM ends a command as Ctrl-C does.
    """
    interrupts: list[int] = []

    def interrupt(number: int, frame: Any) -> None:
        interrupts.append(number)
        signal.default_int_handler(number, frame)

    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ours = ours and threading.current_thread() is threading.main_thread()
    if ours:
        signal.signal(signal.SIGINT, interrupt)
    try:
        return _main(arguments, interrupts)
    except (KeyboardInterrupt, *OF_LIBRARIES) as error:
        if not (interrupts or isinstance(error, KeyboardInterrupt)):
            raise
        print("interrupted", file=sys.stderr)
        return 130
    finally:
        if ours and signal.getsignal(signal.SIGINT) is interrupt:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _main(arguments: list[str] | None, interrupts: list[int]) -> int:
    os.environ.setdefault(BLAS, "1")
    gc.set_threshold(50_000)  # by default Python scans the loaded modules again and again
    atexit.register(_leave)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without µ shows a ?
    try:
        here = os.getcwd()
    except OSError:
        print("servogym: the working directory no longer exists", file=sys.stderr)
        return 2
    if here not in sys.path:
        sys.path.append(here)  # so that modules with tasks of your own are found, as by `python -m`
    try:
        options = _parsed(_joined(sys.argv[1:] if arguments is None else arguments))
    except ImportError as error:  # a package is missing, or its release is refused
        if interrupts:
            raise KeyboardInterrupt from error
        print(f"servogym: {_line(error)}", file=sys.stderr)
        return 2
    console = Console()
    warnings.formatwarning = _warned
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for kind in ("files", "folders"):
            for name in getattr(options, kind, ()):
                given = getattr(options, name)
                for path in given if isinstance(given, list) else [given] * (given is not None):
                    from ..report import writable

                    writable(f"--{name.replace('_', '-')}", Path(path), file=kind == "files")
        for name in getattr(options, "inputs", ()):  # before anything is loaded or built for them
            path = getattr(options, name)
            if path is not None and not path.exists():
                raise ValueError(f"--{name.replace('_', '-')} {path}: there is no such file")
        consent(options)
        return options.run(options, console)
    except BrokenPipeError:  # the reader has closed the pipe, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        from ..report import interrupted

        loading = isinstance(error, (ImportError, *OF_LIBRARIES))
        if interrupted(error) or (loading and interrupts):
            raise KeyboardInterrupt from error
        line = _line(error)
        if not line:
            raise
        print(f"servogym {options.command}: {line}", file=sys.stderr)
        return 2
