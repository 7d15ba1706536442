"""`servogym results --train`: repeats the trainings behind the committed rows with one command.

`trainings.json` in the folder of a task has one command per stage, with placeholders ``{seed}``,
``{steps}`` and ``{out}``, and the steps of each seed. If the checkpoints do not state the
CPU-seconds of a training, the file has an upper bound, inferred from its time on two cores.
"""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from ...drive.model import foreign
from ...envs.engine.checks import whole
from ...envs.environment.registry import of_a_file
from ..learn.hyperparameters import CONSECUTIVE
from ..policies import POLICIES
from ..policies.trained.saved import read
from ..report import markdown

FILE, MAKER = "trainings.json", "the commands of its trainings"
HEADING = ("task", "trainings", "stages", "steps each", "CPU-s each", "CPU-s")
CORES = 2  # of the machine for which the sum is stated


def folders(folder: Path) -> list[Path]:
    """Return the folders of tasks. Raises ValueError if there are none."""
    found = sorted(path for path in folder.glob("*-v*") if path.is_dir())
    if not found:
        raise ValueError(f"{folder} has no folder of a task, such as CompliantAxis-v0")
    return found


def text(path: Path, name: str, maker: str) -> str:
    """Read a file of a folder. Raises ValueError naming the command that makes a missing one."""
    if not (path / name).is_file():
        raise ValueError(f"{path} has no {name}: write it there with {maker}")
    return foreign.text(path / name)


def table_of(path: Path, name: str, maker: str, *, run_code: bool = False) -> dict[str, Any]:
    """Read a JSON file of a folder; it must hold only data, unless its programs may run.

    All commands in it are commands of servogym. One of them may name a policy in a Python file, or
    a task that another module registers; these are programs.

    Raises ValueError if the file is missing or damaged, or names a program without consent.
    """
    text(path, name, maker)
    found = foreign.table(path / name)
    commands = found.get("commands", [found.get("command", "")])
    of_a_file(found.get("env"), str(path / name), run_code)
    for line in commands if isinstance(commands, list) else []:
        if program := program_in(str(line)):
            foreign.consent(f"{path / name} names {program}, which", run_code)
    return found


def program_in(command: str) -> str:
    """Return the first FILE.py:name or module:task of another package in a command, or ''."""
    for word in re.split(r"[\s,='\"]+", command):
        module, colon, _ = word.partition(":")
        of_python = all(map(str.isidentifier, module.split("."))) and module not in POLICIES
        if ".py:" in word or (colon and of_python and module.partition(".")[0] != "servogym"):
            return word
    return ""


class Training(NamedTuple):
    """A training with one seed: its commands in order, and what they cost."""

    task: str
    seed: str
    commands: list[list[str]]  # arguments of `servogym`
    out: Path  # of the last stage
    steps: int  # of all stages
    cpu_seconds: float
    inferred: bool  # whether the time is an upper bound, because it was not recorded


def plan(folder: Path, out: Path, *, run_code: bool = False) -> list[Training]:
    """List all trainings behind the folders of tasks in `folder`, to be repeated in `out`.

    Raises ValueError if a folder has no `trainings.json`, or an invalid one.
    """
    return [
        training for path in folders(folder) for training in trainings(path, out, run_code=run_code)
    ]


def trainings(path: Path, out: Path, *, run_code: bool = False) -> list[Training]:
    """List the trainings behind the folder of a task. Raises ValueError as `plan` does."""
    data = table_of(path, FILE, MAKER, run_code=run_code)
    try:
        return list(_trainings(path, data, out))
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"{path / FILE} says no trainings ({error!r}): commands, steps") from None


def _trainings(path: Path, data: dict[str, Any], out: Path) -> Iterator[Training]:
    for seed, given in data["steps"].items():
        stages = given if isinstance(given, list) else [given]
        own = out / path.name
        commands = [
            shlex.split(line.format(seed=seed, steps=steps, out=own))[1:]
            for line, steps in zip(data["commands"], stages, strict=True)
        ]
        if not all(_stays_in(own, command) for command in commands):
            raise TypeError("a command that is not `servogym train`, into {out}")
        took, inferred = _cpu_seconds(
            path / f"seed_{seed}", stages, data.get("cpu_us_per_step_at_most")
        )
        yield Training(path.name, seed, commands, own / f"seed_{seed}", sum(stages), took, inferred)


def _stays_in(folder: Path, command: Sequence[str]) -> bool:
    """Whether a command is `servogym train`, and writes into a folder and nowhere else."""
    outs = [n for n, word in enumerate(command) if word.startswith("--o")]
    if command[:1] != ["train"] or [command[n] for n in outs] != ["--out"]:
        return False
    return Path(command[outs[0] + 1]).resolve().is_relative_to(folder.resolve())


def _cpu_seconds(folder: Path, stages: Sequence[int], rate: float | None) -> tuple[float, bool]:
    """Return the CPU time of all stages to their end; the best checkpoint may be earlier."""
    if rate is not None:
        return 1e-6 * rate * sum(stages), True
    about: dict[str, Any] | None = read(folder)
    total = 0.0
    for steps in reversed(stages):
        if about is None:
            raise KeyError("start")
        total += about["cpu_seconds"] * steps / about["steps"]
        about = about.get("start")
    return total, False


def table(trainings: Sequence[Training]) -> str:
    """Return a table of the cost of the trainings, with a row for each task and the sum."""
    rows = []
    for task in dict.fromkeys(training.task for training in trainings):
        own = [training for training in trainings if training.task == task]
        each = [training.cpu_seconds for training in own]
        most = "at most " if any(training.inferred for training in own) else ""
        steps = sorted({training.steps for training in own})
        rows.append([
            task, str(len(own)), str(len(own[0].commands)), " to ".join(f"{n:,}" for n in steps),
            f"{most}{sum(each) / len(each):.0f}", f"{most}{sum(each):.0f}",
        ])
    total = sum(training.cpu_seconds for training in trainings)
    most = "at most " if any(training.inferred for training in trainings) else ""
    rows.append(["all", str(len(trainings)), "", "", "", f"{most}{total:.0f}"])
    return markdown(HEADING, rows)


def in_sentences(trainings: Sequence[Training]) -> str:
    """State the sum in sentences, measured and inferred parts apart."""
    total = sum(training.cpu_seconds for training in trainings)
    text = f"{total:.0f} CPU-seconds, {total / 60 / CORES:.0f} minutes of {CORES} cores."
    told_of = [
        (sum(each.cpu_seconds for each in own), ", ".join(dict.fromkeys(e.task for e in own)))
        for own in ([e for e in trainings if e.inferred is inferred] for inferred in (False, True))
    ]
    (measured, of_these), (most, of_others) = told_of
    if not most:
        return f"Together they took {text} These times were measured."
    text = f"Together they took at most {text}"
    if measured:
        text += f" Of these, {measured:.0f} were measured ({of_these})."
    return (
        f"{text} The times of {of_others}, at most {most:.0f}, were not recorded: they are "
        "inferred from the time that a training took on two cores."
    )


def shared(trainings: Sequence[Training]) -> str:
    """State which trainings share episodes, empty if none does."""
    setting = f"streams={CONSECUTIVE}"
    tasks = dict.fromkeys(
        each.task for each in trainings if any(setting in line for line in each.commands)
    )
    if not tasks:
        return ""
    return (
        f"The trainings of {', '.join(tasks)} draw their episodes from consecutive streams "
        f"(`--setting {setting}`): trainings whose seeds differ by 1 have all streams but one in "
        "common, so they are no independent repetitions, and the spread between them may be too "
        "small."
    )


def run(
    folder: Path, out: Path | None, workers: int | None, console: Console, *, run_code: bool = False
) -> int:
    """Show the plan; with `out`, run it in `workers` parallel processes; -> exit status."""
    trainings = plan(folder, out or Path("out"), run_code=run_code or out is None)
    for training in trainings:
        for command in training.commands:
            console.print(f"servogym {shlex.join(command)}", soft_wrap=True, highlight=False)
    console.print(table(trainings), highlight=False, markup=False)
    console.print(in_sentences(trainings), shared(trainings), highlight=False)
    if out is None:
        return 0
    workers = whole("--workers", 1 if workers is None else workers, 1, 1000)
    with ThreadPoolExecutor(workers) as pool:
        states = list(pool.map(lambda training: _train(training, console), trainings))
    return max(states)


def _train(training: Training, console: Console) -> int:
    """Run the stages in order, each continuing where it was interrupted; -> exit status."""
    for command in training.commands:
        out = Path(command[command.index("--out") + 1])
        if (out / "checkpoints").is_dir():  # continue; `--start` is only for a new run
            steps = command[command.index("--steps") + 1]
            command = ["train", command[1], "--resume", "--steps", steps, "--out", str(out)]
        done = subprocess.run([sys.executable, "-m", "servogym.training.cli", *command])
        if done.returncode:
            return done.returncode
    console.print(f"{training.task}, seed {training.seed}: {training.out}", soft_wrap=True)
    return 0
