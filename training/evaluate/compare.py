"""`servogym eval` and `servogym compare`: page, data and pictures of policies on the same episodes.

Every policy is compared with the best baseline, episode by episode.
"""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ...envs.environment.registry import task
from ...envs.environment.servo_env import ServoEnv
from ...envs.view.about import Metric
from .. import report
from ..pictures.recording import Recording
from ..policies import needed
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
from ..scale.work import ALONE, Work
from ..setup import Setup
from .comparison import ZERO, BackgroundSummary, Comparison, Request, quoted
from .episodes import Evaluation
from .grid import played
from .metrics import METRICS, RESAMPLES, SEEN, Difference, Summary, metrics, paired
from .parts import warm
from .repeat import table_of
from .tables import IDLE, SCORE, SHARES, ahead, best, column_of, differences, summaries

ARROWS = {"high": " →", "low": " ←", "": ""}
SHOWN = (  # in the picture, the first six that apply
    "score", "settling_time", "tracking_error", "overshoot", "vibration", "sway",
    "reference_error", "peak_error", "rms_torque", "energy",
)


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


def _apart(metric: str, found: Difference | None, better: str, policy: str) -> str:
    """Format a difference, bold if the interval excludes 0 on the better side (not for idling)."""
    if found is None:
        return "–"
    if metric in SHARES:
        text = f"{100 * found.value:+.0f} % [{100 * found.low:+.0f}, {100 * found.high:+.0f}]"
    else:
        text = f"{number(found.value)} [{number(found.low)}, {number(found.high)}]"
    return f"**{text}**" if ahead(found, better) and policy not in IDLE else text


def draw(
    path: Path, title: str, results: Sequence[Evaluation],
    table: Mapping[str, Sequence[Summary | None]],
) -> None:
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
    names = [column_of(result.policy) for result in results]
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
    command: str, request: Request, out: Path | None, console: Console, work: Work = ALONE
) -> int:
    """Evaluate, print, and write page, data and pictures named after `command`; -> exit status.

    The second picture shows the traced episode. Without `out` each comparison gets a folder of its
    own; the results of another comparison are never overwritten.
    """
    setup = request.setup
    source = origin(request.command(command))
    out = kept_folder(out, f"{command}-{setup.stem}", f"{command}.json", source["command"])
    comparison = Comparison(request)
    episode = f"episode {request.traced} of seed {request.seed}"

    def picture(traces: Sequence[Recording]) -> bytes:
        from ..pictures import episode as pictured  # matplotlib, which no job needs

        return pictured.drawn(f"{setup}, {episode}", _moving(traces))

    early = BackgroundSummary(comparison, picture)
    with played(comparison, work, console, out, warm=[warm(setup)], then=early) as results:
        table, metrics = summaries(results), {"score": SCORE, **results[0].metrics}
        heading = ["metric", *(column_of(result.policy) for result in results)]
        rows = [
            [metrics[metric].heading, *(_cell(metric, s) for s in columns)]
            for metric, columns in table.items()
        ]
        title = f"{setup}, {request.episodes} episodes, seed {request.seed}"
        console.print(report.table(heading, rows, title))
        by = setup.task.METRIC
        against = best(table, [r.policy for r in results], by, metrics[by].better)
        apart = differences(results, against) if len(results) > 1 else {}
        pages = markdown(heading, rows) + _sections(heading, results, table, apart, against, by)
        write_page(
            out / f"{command}.md", str(setup), pages, source, _notes(request, results, table)
        )
        write_json(out / f"{command}.json", _data(source, setup, results, table, against, apart))
        draw(out / f"{command}.png", str(setup), results, table)
        written = f"{out / command}.md, .json and .png"
        if early.picture:
            write_bytes(out / f"{command}_trace.png", early.picture)
            written = f"{out / command}.md, .json, .png and _trace.png"
        console.print(written)
    return 0


def _sections(
    heading: Sequence[str], results: Sequence[Evaluation],
    table: Mapping[str, Sequence[Summary | None]],
    apart: Mapping[str, Sequence[Difference | None]], against: str, by: str,
) -> str:
    """The tables of the page below the first: differences, pairs, the worst."""
    metrics = {"score": SCORE, **results[0].metrics}
    judged = [metric for metric in table if metrics[metric].better]
    pages = ""
    if apart:
        rows = [
            [
                metrics[metric].heading,
                *(
                    _apart(metric, found, metrics[metric].better, result.policy)
                    for result, found in zip(results, apart[metric], strict=True)
                ),
            ]
            for metric in judged if metric in apart
        ]
        pages += f"\n## Against {column_of(against)}, on the same episodes\n\n"
        pages += markdown(heading, rows)
    if apart and metrics[by].better:
        pages += _pairs_page(results, against, by, metrics[by])
    rows = [[metrics[name].heading, *(_worst(name, s) for s in table[name])] for name in judged]
    return pages + "\n## Worst training, worst 5 % of the episodes\n\n" + markdown(heading, rows)


def _notes(
    request: Request, results: Sequence[Evaluation], table: Mapping[str, Sequence[Summary | None]]
) -> str:
    metrics, count = {"score": SCORE, **results[0].metrics}, request.episodes
    notes = (
        f"Values are interquartile means [95 % interval, {RESAMPLES} resamples of trainings and "
        f"episodes] over {count} episodes, seeds {results[0].seeds[0]} to "
        f"{results[0].seeds[count - 1]}; {_trainings(results)}{_needs(request.policies)}shares are "
        "means. Differences are those of the (interquartile) means, in bold where the interval is "
        "on the better side of 0. "
        f"Score: {_scale(request.setup.task.REFERENCE, results)}.\n\n"
    )
    return notes + "\n".join(
        f"- {metrics[metric].heading}: {metrics[metric].what}"
        for metric in table if metrics[metric].what
    )


def _pairs_page(results: Sequence[Evaluation], against: str, metric: str, row: Metric) -> str:
    """Write the comparison in pairs of episodes by the task's metric."""
    (other,) = (result for result in results if result.policy == against)
    base, rows = other.by_training(metric), []
    for result in results:
        values = result.by_training(metric)
        if values is None or base is None or result is other:
            continue
        found = paired(values, base, row.better)
        interval = f"{number(found.iqm)} [{number(found.low)}, {number(found.high)}]"
        shares = (f"{100 * share:.0f} %" for share in (found.improved, found.probability))
        needed = f"{found.needed:.0f}" if np.isfinite(found.needed) else "more trainings"
        rows.append([column_of(result.policy), interval, *shares, needed])
    heading = (
        "policy", "mean of the differences", "episodes improved", "probability of improvement",
        f"episodes to see {100 * SEEN:.0f} %",
    )
    return f"\n## {row.heading}, in pairs with {column_of(against)}\n\n" + markdown(heading, rows)


def _moving(traces: Sequence[Recording]) -> list[Recording]:
    """Return the policies that move, by label; idle ones only if there are no others."""
    moving = [trace for trace in traces if trace.policy not in IDLE] or traces
    return [trace._replace(policy=column_of(trace.policy)) for trace in moving]


def _scale(one: str, results: Sequence[Evaluation]) -> str:
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
        f"{policy} in an environment with {', '.join(quoted(*one) for one in own.items())}; "
        for policy, own in rows if own
    )


def _trainings(results: Sequence[Evaluation]) -> str:
    several = [f"{result.policy}: {result.trainings}" for result in results if result.trainings > 1]
    return f"trainings: {', '.join(several)}; " if several else ""


def _data(source, setup: Setup, results, table, against, apart) -> dict[str, Any]:
    return {
        **source,
        "env": setup.name,
        "drive": setup.drive,
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
    }


def read(
    path: Path, *, run_code: bool = False
) -> tuple[type[ServoEnv], dict[str, Evaluation]]:
    """Read the results of a comparison back from its JSON file, by policy.

    Raises ValueError if it is no such file, or names a program without consent.
    """
    data = table_of(path.parent, path.name, "servogym compare", run_code=run_code)
    try:
        env = task(data["env"])
        known, empty = metrics(env), np.full(len(data["seeds"]), np.nan)
        return env, {
            name: Evaluation(
                name, data["seeds"],
                {metric: np.tile(empty, one["trainings"]) for metric in known}
                | {metric: np.array(own, float) for metric, own in one["episodes"].items()},
                one["faults"], None, one["trainings"], known,
            )
            for name, one in data["policies"].items()
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is no comparison of `servogym compare` ({error!r})") from None
