"""`servogym results`: what was learned, beside the best baseline, from the folders of the policies.

Each folder, named after its task, has the `compare.json` that `servogym compare` wrote, pictures,
and a README.md with a paragraph that begins with `HONEST`. Nothing else is on the page.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from ..envs.tasks.contour import GantryContourEnv
from ..envs.tasks.tracking import LinearAxisTrackingEnv
from .compare import IDLE, SHARES
from .evaluate import task
from .metrics import METRICS, Summary
from .policies import LEARNED
from .report import markdown, number

FILE, PAGE, HONEST = "compare.json", "README.md", "**Where the baseline is better**"
PICTURES = {  # as far as they are there
    "compare_trace.png": "one episode",
    "compare.png": "comparison",
    "curves.png": "learning curves",
}
METRIC = {  # what a task is about, where that is not settling
    LinearAxisTrackingEnv.ID: "tracking_error",
    GantryContourEnv.ID: "episode_return",
}
SETTLING = "settling_time"
HEADING = (
    "task", "metric", "learned", "best baseline", *(METRICS[share].heading for share in SHARES)
)  # fmt: skip
HEAD = """# What was learned

The policy `learned` of each task, and the baseline that is best by the metric of that task, on the
same fixed episodes and the same drive: interquartile means with their 95 % intervals over all
trainings, in bold where the learned policy is better and the intervals do not meet. Shares are
means over the episodes, of the learned policy and of that baseline. One episode is drawn under each
policy, of several trainings under the first.

"""
FOOT = """Written by `servogym results` from the `compare.json` of each folder.
"""


def page(folder: Path) -> str:
    """The page about the policies in `folder`, a folder a task.

    Raises:
        ValueError: there are none, or one lacks a file, the policy `learned` or the paragraph.
    """
    folders = sorted(path for path in folder.glob("*-v*") if path.is_dir())
    if not folders:
        raise ValueError(f"{folder} has no folder of a task, such as CompliantAxis-v0")
    rows, sections = [], []
    for path in folders:
        data = json.loads(_text(path, FILE, "servogym compare"))
        own, baseline, metric = _chosen(path, data)
        rows.append(_row(path.name, own, baseline, metric))
        sections.append(_section(path, data, own, baseline))
    return HEAD + markdown(HEADING, rows) + "\n" + "".join(sections) + FOOT


def run(folder: Path, console: Console) -> int:
    """Write the page; -> exit status."""
    text = page(folder)
    (folder / PAGE).write_text(text, encoding="utf-8")
    console.print(f"{folder / PAGE}")
    return 0


def best(policies: Mapping[str, Any], metric: str) -> str:
    """The best baseline by the interquartile mean of a metric; an idle one if there is no other.

    Raises:
        ValueError: no baseline has that metric.
    """
    known = [name for name, row in policies.items() if name != LEARNED and metric in row["summary"]]
    if not known:
        raise ValueError(f"no baseline with {metric} beside {LEARNED!r}: add one to --policies")
    moving = [name for name in known if name not in IDLE] or known
    sign = -1.0 if METRICS[metric].better == "high" else 1.0
    return min(moving, key=lambda name: sign * policies[name]["summary"][metric]["iqm"])


class _Policy(NamedTuple):
    """One of a `compare.json`."""

    name: str
    summary: dict[str, Summary]  # by metric
    trainings: int


def _chosen(path: Path, data: Mapping[str, Any]) -> tuple[_Policy, _Policy, str]:
    """The learned policy, the best baseline, and the metric of the task."""
    policies = data["policies"]
    if LEARNED not in policies:
        raise ValueError(
            f"{path / FILE} has no policy {LEARNED!r}, only {', '.join(policies)}: "
            f"run `servogym compare {data['env']} --policies …,{LEARNED} --out {path}`"
        )
    metric = METRIC.get(task(data["env"]).ID, SETTLING)
    own, baseline = (
        _Policy(
            name,
            {metric: Summary(**row) for metric, row in policies[name]["summary"].items()},
            policies[name]["trainings"],
        )
        for name in (LEARNED, best(policies, metric))
    )
    return own, baseline, metric


def _row(name: str, own: _Policy, baseline: _Policy, metric: str) -> list[str]:
    trainings = f"{own.trainings} trainings" if own.trainings > 1 else "1 training"
    learned = _interval(own.summary[metric])
    return [
        f"[{name}](#{name.lower()}), {trainings}",
        METRICS[metric].heading,
        f"**{learned}**" if _ahead(own, baseline, metric) else learned,
        f"{baseline.name}: {_interval(baseline.summary[metric])}",
        *(f"{_share(own, share)}, {_share(baseline, share)}" for share in SHARES),
    ]


def _share(policy: _Policy, share: str) -> str:
    return f"{100 * policy.summary[share].mean:.0f} %" if share in policy.summary else "–"


def _ahead(one: _Policy, other: _Policy, metric: str) -> bool:
    """Whether the intervals do not meet, and that of `one` is on the better side."""
    if not METRICS[metric].better or not {metric} <= one.summary.keys() & other.summary.keys():
        return False
    here, there = one.summary[metric], other.summary[metric]
    if METRICS[metric].better == "high":
        return here.low > there.high
    return here.high < there.low


def _interval(summary: Summary) -> str:
    return f"{number(summary.iqm)} [{number(summary.low)}, {number(summary.high)}]"


def _section(path: Path, data: Mapping[str, Any], own: _Policy, baseline: _Policy) -> str:
    told = _text(path, PAGE, "a text editor")
    honest = re.search(rf"^{re.escape(HONEST)}.*?(?=\n\s*\n|\Z)", told, re.M | re.S)
    if honest is None:
        raise ValueError(
            f"{path / PAGE} has no paragraph that begins with {HONEST}: write where it loses"
        )
    pictures = "".join(
        f"![{path.name}, {what}]({path.name}/{name})\n"
        for name, what in PICTURES.items() if (path / name).is_file()
    )  # fmt: skip
    lost = [
        row.heading for metric, row in METRICS.items()
        if metric not in SHARES and _ahead(baseline, own, metric)
    ]  # fmt: skip
    intervals = f"By its intervals {baseline.name} is better in: {', '.join(lost) or 'nothing'}."
    text = re.sub(r"\]\((?![a-z]+:|#|/)", f"]({path.name}/", honest.group().strip())
    link = f"[{path.name}/{PAGE}]({path.name}/{PAGE})"
    return (
        f"## {path.name}\n\n{pictures}\n{text}\n\n{intervals}\n\nHow it was trained: {link}\n\n"
        f"```sh\n{data['command']}\n```\n\n"
    )


def _text(path: Path, name: str, maker: str) -> str:
    if not (path / name).is_file():
        raise ValueError(f"{path} has no {name}: write it there with {maker}")
    return (path / name).read_text(encoding="utf-8")
