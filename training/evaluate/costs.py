"""`servogym results --costs`: every committed result with its command and the cost of it.

Results name their commands themselves, so nothing is listed twice: the pages in docs/results, the
comparisons, the numbers of the tuner and the trainings. The entries of a suite are not listed,
because the command of the leaderboard plays them all again. The processor time of a command is
measured when this command repeats it, and kept in a JSON file beside the page.
"""

import json
import math
import os
import re
import resource
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from ...drive.model import foreign
from ..report import markdown, number, origin, write_json, write_text
from . import repeat

PAGE = Path("docs", "results", "repeat.md")
OWN = re.compile(  # commands of a page, of which the last one writes it
    r"^```sh\n((?:servogym|python) [^\n#]*[^\n# ])[^\n]*\n```$"  # alone in its block
    r"|^(python [^\n#]* docs/results/\w+\.md)$"  # one of several, which names the page
    r"|`(servogym [^`]+)`, which wrote this page", re.M,
)
TESTED = re.compile(r"`(tests/[\w/]+\.py)`\s+writes\s+this\s+page")
AGAIN = "SERVOGYM_WRITE=1 python -m pytest "  # a test that compares a page also writes it
CPU = "CPU (s)"  # a column of a campaign's table
HEADING = ("result", "command", "CPU-seconds", "load", "the same again")
NOTES = """*CPU-seconds* are those of the process and its children, all threads together, with start
and import. A command takes up to twice as many on a loaded machine; *load* is the load average when
it ended. *The same again* says whether the command wrote the committed files once more, byte by
byte (of `tuned.json` the entry of the row). Trainings state their processor time in their
checkpoints. The command of the leaderboard plays every entry of the suite again. Commands of
`python` play campaigns of machines and buses, which are not rows of the benchmark, or write a page
from the rows of one. They are not repeated here. *In its rows* is the processor time that the rows
of a campaign state: that of the tuning or the fit itself, without what surrounds it. A page that
the tests write is compared in every run of the tests."""


class Result(NamedTuple):
    """A committed result."""

    file: str  # relative to the checkout
    command: str  # the command that writes it; empty for a page that is written by hand


def results(root: Path) -> list[Result]:
    """List the committed results of a checkout, without the trainings.

    Raises ValueError if `root` is no checkout.
    """
    if not (root / PAGE.parent).is_dir():
        raise ValueError(f"{root} has no {PAGE.parent}: name the folder of a checkout")
    found = []
    for path in sorted((root / PAGE.parent).glob("*.md")):
        if path != root / PAGE:
            text = path.read_text(encoding="utf-8")
            commands = ["".join(groups) for groups in OWN.findall(text)]
            commands += [AGAIN + file for file in TESTED.findall(text)]
            data = path.with_suffix(".json")  # the page beside it also has text written by hand
            source = data if data.is_file() else path
            found.append((source, commands[-1] if commands else ""))
    policies = root / "assets" / "policies"
    for path in sorted(policies.glob("*/*.json")):
        if command := foreign.table(path).get("command"):
            found.append((path, command))
    for tasks in foreign.table(policies / "tuned.json").values():
        found += [(policies / "tuned.json", one["command"]) for one in tasks.values()]
    found.append((policies / "basis_feed_forward.npz", "servogym tune-policy basis_feed_forward"))
    return [Result(path.relative_to(root).as_posix(), command) for path, command in found]


def run(root: Path, pattern: str, console: Console) -> int:
    """Repeat the results whose command contains `pattern`, if there is one, and write the page.

    Each command runs in a folder of its own in out/repeat. Its cost is kept as soon as it ends.

    Args:
        root: of the checkout.
        pattern: a command or part of some, or empty to repeat nothing.
        console: prints what was done.
    """
    every, kept = results(root), (root / PAGE).with_suffix(".json")
    known: dict[str, Any] = foreign.table(kept) if kept.is_file() else {}
    commands = dict.fromkeys(one.command for one in every if one.command.startswith("servogym "))
    chosen = [command for command in commands if pattern and pattern in command]
    chosen = [pattern] if pattern in chosen else chosen  # a whole command stands for itself alone
    if pattern and not chosen:
        raise ValueError(f"--costs {pattern!r}: no command of a committed result contains that")
    for command in chosen:
        console.print(command, soft_wrap=True, highlight=False)
        took = _measured(command, _place(root, command))
        known = foreign.table(kept) if kept.is_file() else {}  # another process may have measured
        known[command] = took
        write_json(kept, dict(sorted(known.items())))
    known = {command: known[command] for command in sorted(commands) if command in known}
    for command, own in known.items():  # a committed file may have changed since
        out = _place(root, command)
        if out.is_dir():
            files = [root / one.file for one in every if one.command == command]
            own["same"] = all(_same(file, out) for file in files)
    write_json(kept, known)
    write_text(root / PAGE, page(root, every, known))
    console.print(f"{root / PAGE}", soft_wrap=True)
    return 0


def _place(root: Path, command: str) -> Path:
    """Return the folder in which a command is repeated."""
    return root / "out" / "repeat" / re.sub(r"[^\w]+", "_", command)[-80:]


def _measured(command: str, out: Path) -> dict[str, Any]:
    """Run a command in a folder -> its cost. Raises ValueError if it fails."""
    out.mkdir(parents=True, exist_ok=True)
    for name in ("assets", "docs"):  # for commands that read committed files
        if not (out / name).is_symlink():
            (out / name).symlink_to(Path(*[".."] * 3, name))

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = spent()
    words = [sys.executable, "-m", "servogym.training.cli", *shlex.split(command)[1:]]
    if status := subprocess.run(words, cwd=out).returncode:
        raise ValueError(f"`{command}` ended with {status}")
    return {
        "cpu_seconds": round(spent() - before, 1), "load": round(os.getloadavg()[0], 1),
        "machine": origin("")["machine"],
    }


def _same(committed: Path, out: Path) -> bool:
    """Whether a command wrote a committed file again; a part is enough for a JSON file."""
    if committed.suffix == ".json":
        whole = json.loads(committed.read_bytes())
        made = (json.loads(path.read_bytes()) for path in (out / "out").rglob("*.json"))
        return any(_within(part, whole) for part in made if part)
    made_again = (path.read_bytes() for path in (out / "out").rglob(f"*{committed.suffix}"))
    return committed.read_bytes() in made_again


def _within(part: Any, whole: Any) -> bool:
    if isinstance(part, Mapping) and isinstance(whole, Mapping):
        return all(name in whole and _within(one, whole[name]) for name, one in part.items())
    return bool(part == whole)


def in_rows(root: Path, one: Result) -> float:
    """Return the processor time that the rows of a campaign state (s); 0 if they state none.

    The rows are those of the table of its page, or of a file of JSON lines that its command names.
    """
    if not one.command.startswith("python "):
        return 0.0
    seconds: list[float] = []
    for name in re.findall(r"\S+\.jsonl", one.command):
        lines = (root / name).read_text(encoding="utf-8").splitlines()
        seconds += [json.loads(line).get("cpu", 0.0) for line in lines]
    table: list[list[str]] = []
    for line in (root / one.file).read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        table = [*table, cells] if line.startswith("|") else []
        if len(table) > 2 and CPU in table[0]:
            seconds.append(float(table[-1][table[0].index(CPU)]))
    return math.fsum(seconds)


def page(root: Path, every: list[Result], known: Mapping[str, Any]) -> str:
    """Return the page: the table of all results with the sum."""
    rows, commands = [], set()
    for one in every:
        own = known.get(one.command)
        first = one.command not in commands
        commands.add(one.command)
        cost = ["not measured", "", ""]
        if not one.command:
            cost = ["written by hand", "", ""]
        elif one.command.startswith(AGAIN):
            cost = ["by the tests", "", "yes"]
        elif own and first:
            same = "yes" if own["same"] else "no"
            cost = [number(own["cpu_seconds"]), f"{own.get('load', '–')}", same]
        elif own:
            cost = ["see above", "", ""]
        elif seconds := in_rows(root, one):
            cost = [f"{seconds:.0f} in its rows", "", ""]
        rows.append([f"`{one.file}`", f"`{one.command}`" if one.command else "–", *cost])
    trainings = repeat.plan(root / "assets" / "policies", Path("out"))
    for task in dict.fromkeys(each.task for each in trainings):
        own = [each for each in trainings if each.task == task]
        most = "at most " if any(each.inferred for each in own) else ""
        took = sum(each.cpu_seconds for each in own)
        place = f"`assets/policies/{task}/seed_*`"
        rows.append([place, "`servogym results --train out/again`", f"{most}{took:.0f}", "", ""])
    measured = math.fsum(known[command]["cpu_seconds"] for command in commands if command in known)
    unknown = {one.command: in_rows(root, one) for one in every if one.command not in known}
    campaigns = [took for each, took in unknown.items() if each and not each.startswith(AGAIN)]
    trained = sum(each.cpu_seconds for each in trainings)
    total = measured + trained
    text = (
        f"{markdown(HEADING, rows)}\nThe {len(commands & known.keys())} measured commands took "
        f"{measured:.0f} CPU-seconds and the trainings at most {trained:.0f}, together "
        f"{total / 60 / repeat.CORES:.0f} minutes of {repeat.CORES} cores. "
        f"Of the other {len(campaigns)} commands, {sum(took == 0.0 for took in campaigns)} were "
        f"not measured; the rows of the rest state {math.fsum(campaigns):.0f} CPU-seconds.\n"
    )
    return (
        f"# What it takes to repeat the results\n\n{text}\n{NOTES}\n\n`servogym results --costs` "
        "writes this page from what was measured; `servogym results --costs WORDS` first repeats "
        "the results whose command contains WORDS.\n"
    )
