"""`servogym eval` and `servogym compare`: policies on the same fixed episodes.

Score: 0 is holding still, 1 the reference of the task, both as the interquartile means of their
returns over the same episodes. Every policy is compared with the best baseline, episode by episode.
"""

import io
import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ...envs.about import Metric
from ...envs.registry import short, task
from ..pictures.recording import Recording
from ..policies import POLICIES, needed
from ..report import (
    GRID,
    INK,
    kept_folder,
    markdown,
    number,
    origin,
    write_bytes,
    write_json,
    write_page,
)
from ..scale.job import Result
from ..scale.work import ALONE, Work
from .episodes import Evaluation, fixed
from .metrics import METRICS, RESAMPLES, Difference, Summary, difference, iqm, summarise
from .parts import Episodes, warm

ZERO = "hold"
SCORE = Metric("score", "high", "")
# arguments that are a way to command and not a part of the task
COMMANDING = {name for row in POLICIES.values() for name in row.arguments}
ARROWS = {"high": " →", "low": " ←", "": ""}
SHARES = ("success", "limited", "faults")  # told as means in percent
SHOWN = (  # in the picture, the first six that apply
    "score", "settling_time", "tracking_error", "overshoot", "vibration", "sway",
    "reference_error", "peak_error", "rms_torque", "energy",
)  # fmt: skip
IDLE = ("hold", "random")  # would spoil the scales of all but the score


def scores(returns: np.ndarray, zero: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Of each episode; not a number where `one` earns no more than `zero`."""
    low, high = float(iqm(zero)), float(iqm(one))
    span = high - low
    return (returns - low) / span if span > 0.0 else np.full_like(returns, np.nan)


class Comparison:
    """Policies on the fixed episodes: the jobs that play them, and the evaluations they give.

    Args:
        env: id of the environment.
        policies: by name, each in an environment with the arguments it needs; or classes and
            functions (`policies.file.policy_of`).
        drive: drive model.
        episodes: how many, 1..1000.
        seed: of the episodes.
        arguments: of the environment; the ends of the score keep the way they command.
        traced: the episode to be recorded, 0 being the first.
        console: a terminal shows there how far it is.

    Raises:
        ValueError: an unknown environment, drive or policy, before the first episode.
    """

    def __init__(
        self, env: str, policies: Sequence[Any], drive: str, episodes: int, seed: int,
        arguments: Mapping[str, Any] | None = None, traced: int = 0,
    ):  # fmt: skip
        given = dict(arguments or {})
        common = {name: value for name, value in given.items() if name not in COMMANDING}
        kind = task(env)
        ends = [ZERO, kind.REFERENCE] if kind.REFERENCE else []
        seeds = fixed(seed, episodes)
        if not 0 <= traced < episodes:
            raise ValueError(
                f"--trace = {traced} is out of range 0..{episodes - 1}: "
                "choose one of the episodes, counted from 0"
            )
        self._played = [(policy, needed(policy) | given) for policy in dict.fromkeys(policies)]
        self._bounds = [(policy, common | needed(policy)) for policy in ends]
        self._episodes = {
            (policy, repr(own)): Episodes(env, policy, drive, seeds, own, traced)
            for policy, own in (*self._played, *self._bounds)
        }
        jobs = [(key, job) for key, each in self._episodes.items() for job in each.jobs]
        first = [i for i, (_, job) in enumerate(jobs) if job.arguments["traced"] is not None]
        order = [*first, *(i for i in range(len(jobs)) if i not in first)]  # `Early` waits for them
        self.jobs = [jobs[i][1] for i in order]
        self._places = {
            key: [order.index(i) for i, (owner, _) in enumerate(jobs) if owner == key]
            for key in self._episodes
        }

    def results(self, found: Sequence[Result]) -> list[Evaluation]:
        """Of each policy, from the results of the jobs; `score` where the task has a reference."""
        done = {key: self._evaluation(key, found) for key in self._episodes}
        results = [done[policy, repr(own)] for policy, own in self._played]
        if self._bounds:
            ends = [
                done[policy, repr(own)].values["episode_return"] for policy, own in self._bounds
            ]
            for result, score in [
                (result, scores(result.values["episode_return"], *ends)) for result in results
            ]:
                result.values["score"] = score
        return results

    def ready(self, found: Mapping[int, Result], k: int) -> Evaluation | None:
        """Of the policy that the k-th job belongs to, where it was the last of them."""
        key = next(key for key, places in self._places.items() if k in places)
        if any(place not in found for place in self._places[key]):
            return None
        return self._evaluation(key, found)

    def _evaluation(
        self, key: tuple[Any, str], found: Sequence[Result] | Mapping[int, Result]
    ) -> Evaluation:
        return self._episodes[key].evaluation([found[k] for k in self._places[key]])

    def traces(self, found: Mapping[int, Result]) -> list[Recording] | None:
        """Of the traced episode under each policy that recorded it; None while one is missing."""
        traces = []
        for policy, own in self._played:
            key = policy, repr(own)
            (k,) = (k for k in self._places[key] if self.jobs[k].arguments["traced"] is not None)
            if k not in found:
                return None
            if "time" in found[k]:
                traces.append(self._episodes[key].trace(found[k]))
        return traces


class Early:
    """What is made of a comparison while others still play: the second picture, and intervals.

    Args:
        comparison: whose jobs are done.
        draw: gives the bytes of a picture of what was recorded.
    """

    def __init__(self, comparison: Comparison, draw: Callable[[Sequence[Recording]], bytes]):
        self._comparison, self._draw = comparison, draw
        self._found: dict[int, Result] = {}
        self.picture: bytes | None = None

    def __call__(self, k: int, result: Result) -> None:
        """The k-th job of the comparison is done."""
        self._found[k] = result
        if self.picture is None and (traces := self._comparison.traces(self._found)) is not None:
            self.picture = self._draw(traces) if traces else b""  # a bound is never played
        if (evaluation := self._comparison.ready(self._found, k)) is not None:
            summaries([evaluation])  # resamples are kept


def evaluate(
    env: str, policies: Sequence[Any], drive: str, episodes: int, seed: int,
    arguments: Mapping[str, Any] | None = None, traced: int = 0, work: Work = ALONE,
) -> list[Evaluation]:  # fmt: skip
    """Each policy on the fixed episodes; what is given is that of `Comparison`, and who works."""
    comparison = Comparison(env, policies, drive, episodes, seed, arguments, traced)
    return comparison.results(work.map(comparison.jobs, warm=[warm(env, drive)]))


def summaries(results: Sequence[Evaluation]) -> dict[str, list[Summary | None]]:
    """By metric that applies to any: a summary for each policy, None where it does not apply."""
    table = {}
    for metric in ("score", *results[0].metrics):
        better = _row(results, metric).better
        columns = [result.by_training(metric) for result in results]
        if any(values is not None for values in columns):
            table[metric] = [
                None if values is None else summarise(values, better, share=metric in SHARES)
                for values in columns
            ]
    return table


def _row(results: Sequence[Evaluation], metric: str) -> Metric:
    return SCORE if metric == "score" else results[0].metrics[metric]


def _base(name: str) -> str:
    """Of a policy, without what stands behind the colon."""
    return name.partition(":")[0]


def best(
    table: Mapping[str, Sequence[Summary | None]], names: Sequence[str], metric: str, better: str
) -> str:
    """The best baseline by the interquartile mean of a metric; an idle one if there is no other.

    An oracle is no baseline: it knows what no controller can.

    Args:
        table: of `summaries`.
        names: of its columns.
        metric: of the task.
        better: "high" or "low".

    Returns the first policy where no baseline has that metric.
    """
    known = {
        name: s
        for name, s in zip(names, table.get(metric, ()), strict=False)
        if s is not None and _base(name) in POLICIES
    }
    rivals = [n for n in known if n not in IDLE and not POLICIES[_base(n)].told] or list(known)
    sign = -1.0 if better == "high" else 1.0
    return min(rivals, key=lambda name: sign * known[name].iqm, default=names[0])


def differences(results: Sequence[Evaluation], against: str) -> dict[str, list[Difference | None]]:
    """By metric: each policy less the one it is compared with, None where one has no value."""
    (other,) = (result for result in results if result.policy == against)
    table: dict[str, list[Difference | None]] = {}
    for metric in ("score", *results[0].metrics):
        base = other.by_training(metric)
        columns = [result.by_training(metric) for result in results]
        if base is not None:
            table[metric] = [
                None
                if values is None or result is other
                else difference(values, base, share=metric in SHARES)
                for result, values in zip(results, columns, strict=True)
            ]
    return table


def _cell(metric: str, summary: Summary | None) -> str:
    if summary is None:
        return "–"
    if metric in SHARES:
        low, high = 100 * summary.low, 100 * summary.high
        return f"{100 * summary.mean:.0f} % [{low:.0f}, {high:.0f}]"
    if metric == "score":
        return f"{summary.iqm:.2f} [{summary.low:.2f}, {summary.high:.2f}]".replace("-0.00", "0.00")
    return f"{number(summary.iqm)} [{number(summary.low)}, {number(summary.high)}]"


def _worst(metric: str, summary: Summary | None) -> str:
    """Worst training and worst 5 %."""
    if summary is None:
        return "–"
    pair = summary.worst_training, summary.tail
    if metric in SHARES:
        return ", ".join(f"{100 * value:.0f} %" for value in pair)
    return ", ".join(number(value) for value in pair)


def _apart(metric: str, found: Difference | None, better: str) -> str:
    """In bold where the interval leaves 0 out on the better side."""
    if found is None:
        return "–"
    if metric in SHARES:
        text = f"{100 * found.value:+.0f} % [{100 * found.low:+.0f}, {100 * found.high:+.0f}]"
    else:
        text = f"{number(found.value)} [{number(found.low)}, {number(found.high)}]"
    return f"**{text}**" if ahead(found, better) else text


def ahead(found: Difference, better: str) -> bool:
    """Whether the interval of a difference leaves 0 out, on the better side."""
    return found.low > 0.0 if better == "high" else found.high < 0.0 and better == "low"


def draw(
    path: Path, title: str, results: Sequence[Evaluation],
    table: Mapping[str, Sequence[Summary | None]],
) -> None:  # fmt: skip
    """Interquartile means with their intervals, a panel a metric; `table` is of `summaries`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    metrics = {"score": SCORE, **results[0].metrics}
    own = [metric for metric in metrics if metric not in METRICS and metric != "score"]
    shown = [metric for metric in (*SHOWN, *own) if metric in table][:6]
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    height = 0.8 + rows * (1.1 + 0.3 * len(results))
    figure = Figure((4.2 * columns, height), 110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    names = [_label(result.policy) for result in results]
    for panel, metric in zip(panels.flat, shown, strict=False):
        for y, (name, s) in enumerate(zip(names, table[metric], strict=True)):
            if s is None or (metric != "score" and name in IDLE):
                continue
            panel.plot([s.low, s.high], [y, y], color=INK, lw=3, alpha=0.45)
            panel.plot(s.iqm, y, "o", color=INK, ms=6)
        panel.set_xlabel(metrics[metric].heading + ARROWS[metrics[metric].better])
        panel.set_yticks(range(len(names)), names)
        panel.set_ylim(len(names) - 0.5, -0.5)
        panel.locator_params(axis="x", nbins=6)  # long numbers would touch
        panel.grid(**GRID)
        if metric == "score":
            panel.axvline(0.0, color="#8a8f98", lw=1, ls="--")
            panel.axvline(1.0, color="#8a8f98", lw=1, ls="--")
        else:
            panel.set_xlim(left=0.0)
    for panel in list(panels.flat)[len(shown) :]:
        panel.set_visible(False)
    figure.suptitle(f"{title}: interquartile mean, 95 % interval; arrow: better", fontsize=11)
    file = io.BytesIO()
    canvas.print_png(file, metadata={"Software": None})  # savefig would draw it three times
    write_bytes(path, file.getvalue())


def run(
    command: str, env: str, policies: Sequence[str], drive: str, episodes: int, seed: int,
    out: Path | None, console: Console, arguments: Mapping[str, Any] | None = None, traced: int = 0,
    work: Work = ALONE,
) -> int:  # fmt: skip
    """Evaluate, print, and write page, data and pictures named after `command`; -> exit status.

    The second picture is of the episode `traced`. Without `out` each comparison has a folder of its
    own; results of another one are never written over.
    """
    chosen = f"--policy {policies[0]}" if command == "eval" else f"--policies {','.join(policies)}"
    source = origin(
        f"servogym {command} {env} {chosen} --drive {drive} --episodes {episodes} --seed {seed}"
        + (f" --trace {traced}" if traced else "")
        + "".join(f" --argument {_quoted(*one)}" for one in (arguments or {}).items())
    )
    name = "-".join([command, folder_of(env), Path(drive).name])
    out = kept_folder(out, name, f"{command}.json", source["command"])
    comparison = Comparison(env, policies, drive, episodes, seed, arguments, traced)
    title, episode = f"{env}, drive {drive}", f"episode {traced} of seed {seed}"

    def picture(traces: Sequence[Recording]) -> bytes:
        from ..pictures import episode as pictured  # matplotlib, which no job needs

        return pictured.drawn(f"{title}, {episode}", _moving(traces))

    early = Early(comparison, picture)
    found = work.map(
        comparison.jobs, folder=out, console=console, warm=[warm(env, drive)],
        then=early,
    )  # fmt: skip
    results = comparison.results(found)
    table, metrics = summaries(results), {"score": SCORE, **results[0].metrics}
    heading = ["metric", *(_label(result.policy) for result in results)]
    rows = [
        [metrics[metric].heading, *(_cell(metric, s) for s in columns)]
        for metric, columns in table.items()
    ]
    shown = Table(*heading, title=f"{env}, drive {drive}, {episodes} episodes, seed {seed}")
    for row in rows:
        shown.add_row(*row)
    console.print(shown)
    names = [result.policy for result in results]
    by = task(env).METRIC
    against = best(table, names, by, metrics[by].better)
    apart = differences(results, against) if len(results) > 1 else {}
    sorted_out = [metric for metric in table if metrics[metric].better]
    pages = markdown(heading, rows)
    if apart:
        pages += f"\n## Against {_label(against)}, on the same episodes\n\n" + markdown(
            heading,
            [
                [
                    metrics[metric].heading,
                    *(_apart(metric, found, metrics[metric].better) for found in apart[metric]),
                ]
                for metric in sorted_out
                if metric in apart
            ],
        )
    pages += "\n## Worst training, worst 5 % of the episodes\n\n" + markdown(
        heading,
        [
            [metrics[metric].heading, *(_worst(metric, s) for s in table[metric])]
            for metric in sorted_out
        ],
    )
    notes = (
        f"Interquartile mean [95 % interval, {RESAMPLES} resamples of trainings and episodes] over "
        f"{episodes} episodes, seeds {results[0].seeds[0]} to {results[0].seeds[episodes - 1]}; "
        f"{_trainings(results)}{_needs(policies)}shares are means. Differences are those of the "
        "(interquartile) means, in bold where the interval is on the better side of 0. "
        f"Score: {_scale(env, results)}.\n\n"
    )
    notes += "\n".join(
        f"- {metrics[metric].heading}: {metrics[metric].what}"
        for metric in table
        if metrics[metric].what
    )
    write_page(out / f"{command}.md", title, pages, source, notes)
    write_json(out / f"{command}.json", _data(source, env, drive, results, table, against, apart))
    draw(out / f"{command}.png", title, results, table)
    written = f"{out / command}.md, .json and .png"
    if early.picture:
        write_bytes(out / f"{command}_trace.png", early.picture)
        written = f"{out / command}.md, .json, .png and _trace.png"
    console.print(written)
    work.clear(comparison.jobs, out)
    return 0


def folder_of(env: str) -> str:
    """The id of a task as a part of a folder's name."""
    return short(task(env).ID).replace("/", "-")


def _moving(traces: Sequence[Recording]) -> list[Recording]:
    """By their labels; of idle policies only where there is no other."""
    moving = [trace for trace in traces if trace.policy not in IDLE] or traces
    return [trace._replace(policy=_label(trace.policy)) for trace in moving]


def _quoted(name: str, value: Any) -> str:
    """As typed in a shell: ``NAME=VALUE``, a text as it is, all else in JSON."""
    return shlex.quote(f"{name}={value if isinstance(value, str) else json.dumps(value)}")


def _label(policy: str) -> str:
    """Of a folder its name."""
    return Path(policy).name if Path(policy).is_dir() else policy


def _scale(env: str, results: Sequence[Evaluation]) -> str:
    one = task(env).REFERENCE
    if not one:
        return "none, the task has no reference"
    if all(result.by_training("score") is None for result in results):
        return f"none, here {one} earns no more than {ZERO}"
    return (
        f"0 is {ZERO}, 1 is {one}, by the interquartile means of their returns on the same episodes"
    )


def _needs(policies: Sequence[str]) -> str:
    rows = [(policy, needed(policy)) for policy in policies]
    return "".join(
        f"{policy} in an environment with {', '.join(_quoted(*one) for one in own.items())}; "
        for policy, own in rows if own
    )  # fmt: skip


def _trainings(results: Sequence[Evaluation]) -> str:
    several = [f"{result.policy}: {result.trainings}" for result in results if result.trainings > 1]
    return f"trainings: {', '.join(several)}; " if several else ""


def _data(source, env, drive, results, table, against, apart) -> dict[str, Any]:
    return {
        **source,
        "env": env,
        "drive": drive,
        "seeds": sorted(set(results[0].seeds)),
        "against": against,
        "policies": {
            result.policy: {
                "summary": {
                    metric: columns[i]._asdict()
                    for metric, columns in table.items() if columns[i] is not None
                },
                "differences": {
                    metric: columns[i]._asdict()
                    for metric, columns in apart.items() if columns[i] is not None
                },
                "episodes": {
                    metric: values for metric, values in result.values.items() if metric in table
                },
                "faults": result.faults,
                "trainings": result.trainings,
            }
            for i, result in enumerate(results)
        },
    }  # fmt: skip
