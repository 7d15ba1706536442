"""`servogym benchmark learned` plays a suite; `servogym results --suite` checks and ranks entries.

Entries are ranked by the return: the mean over the conditions of its interquartile means. Rewards
are never below 0, so ending an episode early gains nothing. A condition that a policy does not
support earns 0.
"""

import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ...drive.model import foreign
from ...envs.environment.registry import short
from ...envs.environment.servo_env import ServoEnv
from ..policies import Bound, make, needed
from ..report import PACKAGES, markdown, number, origin, write_text
from ..scale.work import ALONE, Work
from .comparison import Request
from .episodes import Evaluation
from .grid import Grid, played
from .matrix import matrix
from .metrics import Summary, metrics, summarise
from .parts import warm
from .submission import ENDING, Submission, Table, fits, of_task, packed, read, sound, write
from .suite import Suite

RETURN, SUCCESS = "episode_return", "success"
DECIDING = ("servogym", "mujoco")  # other versions make another environment of the same id
GAP = "gap"


class Cell(NamedTuple):
    """The result of an entry in a condition; a gap if it has no values."""

    earned: Summary | None
    metric: Summary | None
    success: Summary | None


def play(
    suite: Suite, policies: Mapping[str, str], console: Console, work: Work = ALONE,
    folder: Path | None = None,
) -> Table:
    """Play each task under its policy in all conditions.

    Args:
        suite: the tasks and their conditions.
        policies: a policy for each task, as `policies.make` takes them.
        console: shows the progress.
        work: runs the jobs.
        folder: keeps the results of finished jobs until all are done.
    """
    assert suite.seed is not None, "it is drawn from a submission"
    parts = {env: suite.parts[env] for env in policies}
    grid = Grid({
        env: matrix(Request(part.setup, [policies[env]], suite.episodes, suite.seed), part.rows)
        for env, part in parts.items()
    })
    warming = [warm(part.setup) for part in parts.values()]
    with played(grid, work, console, folder, warm=warming) as found:
        return {
            env: {
                row.name: _values(part.setup.task, found[env].get((row.name, policies[env])))
                for row in part.rows
            }
            for env, part in parts.items()
        }


def _values(kind: type[ServoEnv], result: Evaluation | None) -> dict[str, list[list[float | None]]]:
    """Return the values that a table shows of an evaluation, by metric; nothing for a gap."""
    if result is None:
        return {}
    names = dict.fromkeys((RETURN, SUCCESS, kind.METRIC))
    kept = {name: values for name in names if (values := result.by_training(name)) is not None}
    return {name: [[_plain(value) for value in row] for row in v] for name, v in kept.items()}


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def cell(kind: type[ServoEnv], values: Mapping[str, Any]) -> Cell:
    """Summarise a condition of a table. Raises ValueError for entries that are not numbers."""
    known = metrics(kind)

    def summary(metric: str) -> Summary | None:
        if metric not in values:
            return None
        array = np.array(values[metric], float)
        if array.ndim != 2 or not np.isfinite(array).any():
            raise ValueError(f"{short(kind.ID)}: {metric} are not values of trainings and episodes")
        return summarise(array, known[metric].better, share=metric == SUCCESS)

    return Cell(summary(RETURN), summary(kind.METRIC), summary(SUCCESS))


def suiting(suite: Suite, policy: str, asked: Sequence[str]) -> dict[str, str]:
    """Return the policy for each task of a suite that it fits. Raises ValueError if it fits none.

    Args:
        suite: the suite with the tasks.
        policy: a baseline, "learned", ``FILE.py:name``, or a folder (`submission.packed`).
        asked: tasks that it has to fit.
    """
    chosen, reasons = {}, {}
    for env, part in suite.parts.items():
        own = of_task(policy, env)
        try:
            nominal = part.setup.having(needed(own)).make()
            if isinstance(make(own, nominal), Bound):
                raise ValueError(f"policy {own!r} is a limit and plays nothing")
            nominal.close()
        except ValueError as error:
            reasons[env] = str(error)
        else:
            chosen[env] = own
    refused = [env for env in asked if env in reasons] or ([] if chosen else [*reasons])
    if refused:
        raise ValueError(reasons[refused[0]])
    return chosen


def enter(
    suite: Suite, policy: str, entry: str, command: str, out: Path, console: Console,
    work: Work, *, tasks: Sequence[str] = (), conditions: Sequence[str] = (),
) -> int:
    """Play the suite and write the submission, a file ``out/ENTRY.npz``; -> exit status.

    If only a part of the conditions is played, no submission is written.
    """
    whole, suite = suite, suite.only(tasks, conditions)
    chosen = suiting(suite, policy, tasks)
    files = packed(policy, {env: suite.parts[env].setup.task.ID for env in chosen})
    file = out / f"{entry}{ENDING}"
    source = origin(command)
    made = Submission(
        name=entry, suite=suite.version, digest=suite.digest, policy=_named(policy),
        command=command, versions={name: source[name] for name in ("python", *PACKAGES)},
        machine=source["machine"], table={}, files=files,
    )
    sound(file, made)
    made = replace(made, fitted=made.fitted_here)
    table = play(suite.drawn(made.identity), chosen, console, work, out)
    made = replace(made, table=table)
    for env in chosen:
        console.print(
            _lines(suite.only([env], []), env, {entry: table[env]}), markup=False, soft_wrap=True
        )
    if conditions:
        console.print(f"a part of the conditions of {whole.version}: no submission is written")
        return 0
    write(file, made)
    console.print(f"{file}: hash {made.identity}", soft_wrap=True)
    return 0


def _named(policy: str) -> str:
    """Return the name of a policy without the folders of this machine."""
    return Path(policy).name if "/" in policy else policy


def rank(
    suite: Suite, folder: Path, out: Path, console: Console, work: Work, *, run_code: bool = False
) -> int:
    """Play each submission in a folder again, and write the leaderboard; -> exit status.

    In a suite that was `announced`, all play the same episodes, and not those of their tables.

    A submission that cannot be checked, or whose table differs, is reported in one line and left
    out; then the exit status is 2.
    """
    files = sorted(folder.glob(f"*{ENDING}"))
    if not files:
        raise ValueError(
            f"{folder} has no submission: write one there with `servogym benchmark learned "
            f"--suite {suite.asked} --policy … --out {folder}`"
        )
    entries: dict[str, Submission] = {}
    status = 0
    for file in files:
        try:
            submission = read(file)
            fits(file, submission, suite)
            for other in entries.values():
                if submission.name.casefold() == other.name.casefold():
                    raise ValueError(f"{file}: there is an entry {other.name!r} already")
                if submission.identity == other.identity:
                    raise ValueError(f"{file} plays the same as the entry {other.name!r}")
            played = check(file, submission, suite, console, work, run_code)
            for other in entries.values():
                if played.table == other.table:
                    raise ValueError(
                        f"{file} plays every episode as the entry {other.name!r} does, to the bit"
                    )
            entries[submission.name] = played
        except (ValueError, ImportError) as error:
            print(f"servogym results: {' '.join(str(error).split())}", file=sys.stderr)
            status = 2
    if entries:
        command = ["servogym", "results", folder.as_posix(), "--suite", suite.asked]
        command += ["--public", suite.public] if suite.public else []
        write_text(out, page(suite, entries, shlex.join([*command, "-o", out.as_posix()])))
        console.print(f"{out}", soft_wrap=True)
    return status


def check(
    file: Path, submission: Submission, suite: Suite, console: Console, work: Work, run_code: bool
) -> Submission:
    """Play a submission again -> the same submission with the table that was played.

    Raises:
        ValueError: it brings code without consent to run it, or its table of the same episodes
            differs.
    """
    if submission.code:
        foreign.consent(f"{file} brings {submission.code}, which", run_code)
    present = origin("")
    for package in DECIDING:
        if (then := submission.versions[package]) != present[package]:
            raise ValueError(
                f"{file} was made with {package} {then}, this is {present[package]}: check it with "
                "that version, or make it again with this one"
            )
    if submission.fitted != submission.fitted_here:
        raise ValueError(
            f"{file} was made with other fitted numbers of {submission.plays} than come with this "
            f"laboratory: make it again with `{submission.command}`"
        )
    with TemporaryDirectory() as folder:
        chosen = {env: submission.playable(env, Path(folder)) for env in submission.table}
        console.print(f"{file.name}: {', '.join(chosen)}", highlight=False)
        found = play(suite.drawn(submission.identity), chosen, console, work)
    for env, conditions in found.items():
        _apart(f"{file}, {env}", conditions)
        for condition, values in conditions.items() if not suite.public else ():
            _same(f"{file}, {env}, {condition}", submission, submission.table[env][condition],
                  values, suite.parts[env].setup.task)
    return replace(submission, table=found)


def _apart(where: str, conditions: Mapping[str, Mapping[str, list[list[float | None]]]]) -> None:
    """Refuse one training entered as several, whose intervals would be too narrow.

    It is known by what it plays: files can differ in what does not matter.
    """
    tables = [values for row in conditions.values() for values in row.values()]
    seen: set[str] = set()
    for training in map(repr, zip(*tables, strict=True)):
        if training in seen:
            raise ValueError(
                f"{where}: one of its trainings plays every episode as another one does, to the "
                "bit: each training counts once"
            )
        seen.add(training)


def _same(
    where: str, submission: Submission, claimed: Any, found: Mapping[str, Any], kind: type[ServoEnv]
) -> None:
    """Refuse a table that differs in any bit. Raises ValueError with the first two numbers."""
    if claimed == found:
        return
    again = f"make it again with `{submission.command}`"
    if not isinstance(claimed, dict) or claimed.keys() != found.keys():
        raise ValueError(f"{where}: its table has other columns than {', '.join(found)}; {again}")
    known = metrics(kind)
    metric = next(name for name in found if claimed[name] != found[name])
    try:
        one, other = np.array(claimed[metric], float), np.array(found[metric], float)
    except (TypeError, ValueError):
        one, other = np.empty(0), np.array(found[metric], float)
    if one.shape != other.shape:
        raise ValueError(
            f"{where}: its table has {known[metric].heading} of the shape {one.shape}, it plays "
            f"{other.shape}, trainings and episodes; {again}"
        )
    differ = np.argwhere(~((one == other) | (np.isnan(one) & np.isnan(other))))
    place = tuple(differ[0])
    versions = [f"{n} {v}" for n, v in submission.versions.items() if origin("").get(n) != v]
    others = f" (made with {', '.join(versions)})" if versions else ""
    raise ValueError(
        f"{where}: its table says {known[metric].heading} {float(one[place])!r} in episode "
        f"{place[1]}, it plays {float(other[place])!r}, and {len(differ)} of {one.size} differ"
        f"{others}; {again}"
    )


def page(suite: Suite, entries: Mapping[str, Submission], command: str) -> str:
    """Return the leaderboard that a command writes."""
    conditions = len(dict.fromkeys(row.name for p in suite.parts.values() for row in p.rows))
    whose = "drawn for each entry from its hash" if suite.seed is None else "the same for all"
    whose += f", drawn from the public text `{suite.public}`" if suite.public else ""
    text = (
        f"# Benchmark, suite {suite.version}\n\nEach entry plays {suite.episodes} episodes, "
        f"{whose}, in each of up to {conditions} conditions: `{suite.file}`. Entries are ranked "
        "by the return, the mean over the conditions of its interquartile means; a condition that "
        "a policy does not support is a gap and earns 0. The columns of the conditions show the "
        "metric of the task as interquartile mean [95 % interval, trainings and episodes "
        "resampled]. A policy that is given the randomly drawn parameters, that rehearses, or that "
        "corrects such a policy is listed below the others without a rank.\n\n"
    )
    for env in suite.parts:
        own = {name: entry.table[env] for name, entry in entries.items() if env in entry.table}
        if own:
            text += f"## {env}\n\n{_lines(suite, env, own, entries)}\n"
    rows = [
        [name, f"`{entry.plays}`", str(_trainings(entry)), entry.budget or "–",
         f"`{entry.identity[:12]}`", f"`{entry.command}`"]
        for name, entry in sorted(entries.items())
    ]
    heading = ["entry", "policy", "trainings", "stated budget", "hash", "command"]
    text += "## Entries\n\n" + markdown(heading, rows)
    versions = {", ".join(f"{n} {one.versions[n]}" for n in DECIDING) for one in entries.values()}
    return text + (
        f"\nAll numbers were reproduced from the weights by `{command}`, which wrote this page, "
        f"with {'; '.join(sorted(versions))}. Other versions refuse these entries.\n"
    )


def _trainings(entry: Submission) -> int:
    return max(
        len(values[RETURN])
        for conditions in entry.table.values()
        for values in conditions.values()
        if RETURN in values
    )


def _lines(
    suite: Suite, env: str, tables: Mapping[str, Mapping[str, Any]],
    entries: Mapping[str, Submission] | None = None,
) -> str:
    """Return the table of a task, the best entry first."""
    names, kind = [row.name for row in suite.parts[env].rows], suite.parts[env].setup.task
    cells = {
        entry: [cell(kind, conditions.get(name, {})) for name in names]
        for entry, conditions in tables.items()
    }
    earned = {
        entry: float(np.mean([c.earned.iqm if c.earned else 0.0 for c in row]))
        for entry, row in cells.items()
    }

    def informed(entry: str) -> bool:
        return entries is not None and entries[entry].informed(env)

    order = sorted(cells, key=lambda entry: (informed(entry), -earned[entry], entry))
    ranked = [entry for entry in order if not informed(entry)]
    heading = ["entry", "rank", "return", SUCCESS, *names]
    rows = [
        [
            entry,
            str(ranked.index(entry) + 1) if entry in ranked else "–",
            number(earned[entry]),
            f"{100 * np.mean([c.success.mean if c.success else 0.0 for c in cells[entry]]):.0f} %",
            *(_cell(c) for c in cells[entry]),
        ]
        for entry in order
    ]
    return f"{metrics(kind)[kind.METRIC].heading}\n\n" + markdown(heading, rows)


def _cell(found: Cell) -> str:
    if found.earned is None:
        return GAP
    s = found.metric
    return f"{number(s.iqm)} [{number(s.low)}, {number(s.high)}]" if s else "–"
