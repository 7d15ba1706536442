"""`servogym results`: learned policies compared with the best baseline, from their folders.

Each folder is named after its task. It holds the `compare.json` that `servogym compare` wrote,
pictures, and a README.md with a paragraph that begins with `HONEST`. The page has no other source.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ...envs.environment.registry import task
from ...envs.view.about import Metric
from ..policies import LEARNED, POLICIES, SHIPPED
from ..policies.trained.saved import read
from ..report import markdown, number
from . import repeat
from .headroom import ROUGHER
from .metrics import METRICS, Difference, Summary, metrics, paired
from .repeat import folders, table_of, text
from .tables import SHARES, ahead
from .tuner import BUDGET

FILE, PAGE, HONEST = "compare.json", "README.md", "**Where the baseline is better**"
PICTURES = {  # shown if they exist
    "compare_trace.png": "one episode",
    "compare.png": "comparison",
    "curves.png": "learning curves",
}
HEADING = (
    "task", "metric", "learned", "best baseline", "difference", "of pairs", "episodes improved",
    "worst training", "worst 5 %",
    *(METRICS[share].heading for share in SHARES)
)
HEAD = """# What was learned

The table compares the policy `learned` of each task with the baseline that is best by the metric of
that task, on the same fixed episodes and the same drive. Values are interquartile means with their
95 % intervals, for which trainings and episodes are resampled. *Difference* is the difference of
these means on the same episodes. *Of pairs* is the mean of the differences of pairs, which leaves
out the episodes in which the two differ most. Both are in bold where the interval is on the better
side of 0. *Episodes improved* is the share of episodes in which the learned policy is the better
one. The worst training and the worst 5 % of the episodes are those of the learned policy. Shares
are means over the episodes, first of the learned policy, then of that baseline. The pictures show
one episode under each policy; if it has several trainings, under the first.

"""
ROOM = """The next table shows the room for improvement. It gives the interquartile mean of the same
metric for doing nothing, for random actions, for the best baseline, and for the best law that is
given the randomly drawn parameters or rehearses. Such a law is not a limit: learned policies and
baselines are ahead of some. Only the last value is one: no controller can be better than `bound`.

"""
WIN = f"""## What is missing for a win

A learned policy wins against the strongest row if the interval of the mean of the differences of
pairs lies on the better side of 0, at no more than {ROUGHER} times the jerk of that row, and if
each training took at most {BUDGET:,} steps, the budget of the tuner. It also has to stay ahead off
nominal and on other drives, which the comparisons here do not show. The table lists the attempts
of this page; `servogym results --train` prints and repeats their commands.

"""
ATTEMPT = (
    "task", "trained", "trainings × steps at most", "CPU-s", "strongest row", "of pairs", "jerk",
    "missing",
)
ENDS, LIMIT, TOLD = ("hold", "random"), "bound", "informed"  # columns beside the best baseline
AGAIN = """## Repeat all trainings

`servogym results --train out/again --workers 2` repeats all of them, and continues where it was
interrupted; without a folder it prints the commands. They come from the `trainings.json` of each
folder.

"""
FOOT = """Written by `servogym results` from the `compare.json` of each folder.
"""


def page(folder: Path, at: str = ".", *, run_code: bool = False) -> str:
    """Return the page about the policies in `folder`, which has a folder for each task.

    `at` is the path to it, relative to the page.

    Raises:
        ValueError: there are none, or one lacks a file, the policy `learned` or the paragraph.
    """
    rows, room, attempts, sections = [], [], [], []
    for path in folders(folder):
        data = table_of(path, FILE, "servogym compare", run_code=run_code)
        kind = task(data["env"])
        known = metrics(kind)
        own, baseline = _chosen(path, data, kind.METRIC, known)
        sign = -1.0 if known[kind.METRIC].better == "high" else 1.0
        rows.append(_row(path.name, own, baseline, known, kind.METRIC))
        room.append(
            [path.name, known[kind.METRIC].heading, *_room(data, baseline, kind.METRIC, sign)]
        )
        if (path / repeat.FILE).is_file():
            attempts.append(_attempt(path, own, baseline, known[kind.METRIC].better, kind.METRIC))
        sections.append(
            _section(
                path, path.name if at == "." else f"{at}/{path.name}", data, own, baseline, known
            )
        )
    trained = [path for path in folders(folder) if (path / repeat.FILE).is_file()]
    common = repeat.shared([one for path in trained for one in repeat.trainings(path, Path("out"))])
    tables = markdown(HEADING, rows) + (f"\n{common}\n" if common else "") + "\n" + ROOM
    tables += (
        markdown(("task", "metric", *ENDS, "best baseline", TOLD, LIMIT, LEARNED), room) + "\n"
    )
    tables += WIN + markdown(ATTEMPT, attempts) + "\n" if attempts else ""
    return HEAD + tables + "".join(sections) + _again(folder) + FOOT


def run(folder: Path | None, out: Path | None, console: Console, *, run_code: bool = False) -> int:
    """Write the page; -> exit status.

    Args:
        folder: has a folder for each task; by default the policies of this package.
        out: the page; by default README.md of `folder`, or ``out/learned.md``, because nothing is
            written into the installed package.
        console: prints the name of the page.
    """
    page_at = out or (folder / PAGE if folder else Path("out", "learned.md"))
    installed = SHIPPED.resolve()
    if "site-packages" in installed.parts and page_at.resolve().is_relative_to(installed):
        raise ValueError(f"{page_at} is in the installed package: name another page with --out")
    source = folder or SHIPPED
    text = page(source, os.path.relpath(source, page_at.parent), run_code=run_code)
    page_at.parent.mkdir(parents=True, exist_ok=True)
    page_at.write_text(text, encoding="utf-8")
    console.print(f"{page_at}", soft_wrap=True)
    return 0


def _again(folder: Path) -> str:
    """Return how to repeat all trainings, with the cost, if every folder states it."""
    if not all((path / repeat.FILE).is_file() for path in folders(folder)):
        return ""
    trainings = repeat.plan(folder, Path("out"))
    return AGAIN + repeat.table(trainings) + f"\n{repeat.in_sentences(trainings)}\n\n"


class _Policy(NamedTuple):
    """A policy in a `compare.json`."""

    name: str
    summary: dict[str, Summary]  # by metric
    differences: dict[str, Difference]  # from the best baseline, by metric
    trainings: int
    values: np.ndarray | None  # of the metric of the task, shape (trainings, episodes)


def _pairs(own: _Policy, baseline: _Policy, better: str) -> list[str]:
    """Return the interquartile mean of paired differences and the share of episodes improved."""
    if own.values is None or baseline.values is None:
        return ["–", "–"]
    found = paired(own.values, baseline.values, better)
    text = f"{number(found.iqm)} [{number(found.low)}, {number(found.high)}]"
    sure = ahead(Difference(found.iqm, found.low, found.high), better)
    return [f"**{text}**" if sure else text, f"{100 * found.improved:.0f} %"]


def _attempt(
    path: Path, own: _Policy, baseline: _Policy, better: str, metric: str
) -> list[str]:
    """Return what was trained for a task, its cost, and what it lacks against the strongest row."""
    trainings = list(repeat.trainings(path, Path("out")))
    about = read(path / f"seed_{trainings[0].seed}")
    how = "from demonstrations" if about.get("demonstrate") else "from rewards"
    how = f"correction of `{about['residual']}`" if about.get("residual") else how
    took, steps = sum(one.cpu_seconds for one in trainings), max(one.steps for one in trainings)
    most = "at most " if any(one.inferred for one in trainings) else ""
    missing, (pairs, _) = [], _pairs(own, baseline, better)
    if not pairs.startswith("**"):
        missing.append("not ahead")
    jerks = [one.summary["rms_jerk"].iqm for one in (own, baseline) if "rms_jerk" in one.summary]
    ratio = jerks[0] / jerks[1] if len(jerks) == 2 else None
    if ratio is not None and ratio > ROUGHER:
        missing.append("jerk")
    if steps > BUDGET:
        missing.append("budget")
    return [
        path.name, how, f"{len(trainings)} × {steps:,}", f"{most}{took:.0f}", f"`{baseline.name}`",
        pairs, "–" if ratio is None else f"{number(ratio)} ×", ", ".join(missing) or "off nominal",
    ]


def _values(policy: Mapping[str, Any], metric: str) -> np.ndarray | None:
    """Return the value of each episode; None if an older file lacks them."""
    values = policy.get("episodes", {}).get(metric)
    return None if values is None else np.array(values, float).reshape(policy["trainings"], -1)


def _chosen(
    path: Path, data: Mapping[str, Any], metric: str, known: Mapping[str, Metric]
) -> tuple[_Policy, _Policy]:
    """Return the learned policy and the baseline that is best by the metric of the task."""
    policies = data["policies"]
    if LEARNED not in policies:
        raise ValueError(
            f"{path / FILE} has no policy {LEARNED!r}, only {', '.join(policies)}: "
            f"run `servogym compare {data['env']} --policies …,{LEARNED} --out {path}`"
        )
    against = data.get("against")
    if against is None or metric not in policies[against]["summary"] or against == LEARNED:
        raise ValueError(
            f"{path / FILE} has no baseline with {metric} beside {LEARNED!r}: run "
            f"`servogym compare {data['env']} --policies …,{LEARNED} --out {path}` with one"
        )
    own, baseline = (
        _Policy(
            name, {m: Summary(**row) for m, row in policies[name]["summary"].items()},
            {m: Difference(**row) for m, row in policies[name]["differences"].items()},
            policies[name]["trainings"], _values(policies[name], metric),
        )
        for name in (LEARNED, against)
    )
    return own, baseline


def _row(
    name: str, own: _Policy, baseline: _Policy, known: Mapping[str, Metric], metric: str
) -> list[str]:
    trainings = f"{own.trainings} trainings" if own.trainings > 1 else "1 training"
    learned, found = own.summary[metric], own.differences[metric]
    apart = f"{number(found.value)} [{number(found.low)}, {number(found.high)}]"
    return [
        f"[{name}](#{name.lower()}), {trainings}",
        known[metric].heading,
        _interval(learned),
        f"{baseline.name}: {_interval(baseline.summary[metric])}",
        f"**{apart}**" if ahead(found, known[metric].better) else apart,
        *_pairs(own, baseline, known[metric].better),
        number(learned.worst_training),
        number(learned.tail),
        *(f"{_share(own, share)}, {_share(baseline, share)}" for share in SHARES),
    ]


def _room(data: Mapping[str, Any], baseline: _Policy, metric: str, sign: float) -> list[str]:
    """Return the metric of each policy from doing nothing to the limit; a dash if it is missing."""
    known = {
        name: row["summary"][metric]["iqm"]
        for name, row in data["policies"].items() if metric in row["summary"]
    }
    informed = [
        name for name in known
        if name != LIMIT and (own := POLICIES.get(name.partition(":")[0])) and own.informed
    ]
    best = min(informed, key=lambda name: known[name] * sign, default=TOLD)
    return [
        (f"{name}: " if name in (baseline.name, best) and name in known else "")
        + (number(known[name]) if name in known else "–")
        for name in (*ENDS, baseline.name, best, LIMIT, LEARNED)
    ]


def _share(policy: _Policy, share: str) -> str:
    return f"{100 * policy.summary[share].mean:.0f} %" if share in policy.summary else "–"


def _behind(found: Difference, row: Metric) -> bool:
    return ahead(found, "low" if row.better == "high" else "high")


def _interval(summary: Summary) -> str:
    return f"{number(summary.iqm)} [{number(summary.low)}, {number(summary.high)}]"


def _section(
    path: Path, place: str, data: Mapping[str, Any], own: _Policy, baseline: _Policy,
    known: Mapping[str, Metric],
) -> str:
    page = text(path, PAGE, "a text editor")
    honest = re.search(rf"^{re.escape(HONEST)}.*?(?=\n\s*\n|\Z)", page, re.M | re.S)
    if honest is None:
        raise ValueError(
            f"{path / PAGE} has no paragraph that begins with {HONEST}: write where it loses"
        )
    pictures = "".join(
        f"![{path.name}, {what}]({place}/{name})\n"
        for name, what in PICTURES.items() if (path / name).is_file()
    )
    lost = [
        row.heading for metric, row in known.items()
        if metric in own.differences and row.better and _behind(own.differences[metric], row)
    ]
    better = ", ".join(lost) or "nothing"
    intervals = f"By the intervals of the differences {baseline.name} is better in: {better}."
    loses = re.sub(r"\]\((?![a-z]+:|#|/)", f"]({place}/", honest.group().strip())
    link = f"[{place}/{PAGE}]({place}/{PAGE})"
    return (
        f"## {path.name}\n\n{pictures}\n{loses}\n\n{intervals}\n\nHow it was trained: {link}\n\n"
        f"```sh\n{data['command']}\n```\n\n"
    )
