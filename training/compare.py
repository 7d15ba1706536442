"""`servogym eval` and `servogym compare`: policies on the same fixed episodes.

Score: 0 is holding still, 1 the reference of the task, both as the means of their returns over the
same episodes.
"""

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ..envs.tasks.commissioning import CommissioningEnv
from ..envs.tasks.compliant import CompliantAxisEnv
from ..envs.tasks.homing import HomingEnv
from ..envs.tasks.positioning import LinearAxisEnv
from ..envs.tasks.sway import GantrySwayEnv
from ..envs.tasks.tracking import LinearAxisTrackingEnv
from . import trace
from .evaluate import Evaluation, Evaluator, task
from .metrics import METRICS, RESAMPLES, Summary, summarise
from .policies import POLICIES, make, needed
from .report import GRID, INK, markdown, number, origin, write_json, write_page

ZERO = "hold"
ONE = {  # the policy whose score is 1
    LinearAxisEnv.ID: "ruckig",
    CompliantAxisEnv.ID: "ruckig",
    GantrySwayEnv.ID: "ruckig+zvd",  # plain ruckig leaves the load swinging, as holding still does
    LinearAxisTrackingEnv.ID: "feed_forward",
    HomingEnv.ID: "search",
    CommissioningEnv.ID: "plc",
}
# arguments that are a way to command and not a part of the task
COMMANDING = {name for row in POLICIES.values() for name in row.arguments}
SHARES = ("success", "limited", "faults")  # told as means in percent
SHOWN = (  # in the picture, the first six that apply
    "score", "settling_time", "tracking_error", "overshoot", "vibration", "sway",
    "reference_error", "peak_error", "rms_torque", "energy",
)  # fmt: skip
IDLE = ("hold", "random")  # would spoil the scales of all but the score


def scores(returns: np.ndarray, zero: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Of each episode; not a number where `one` earns no more than `zero`."""
    span = one.mean() - zero.mean()
    return (returns - zero.mean()) / span if span > 0.0 else np.full_like(returns, np.nan)


def evaluate(
    env: str, policies: Sequence[str], drive: str, episodes: int, seed: int,
    arguments: Mapping[str, Any] | None = None, traced: int = 0,
) -> list[Evaluation]:  # fmt: skip
    """Each policy on the fixed episodes, with the metric `score` where the task has a reference.

    Args:
        env: id of the environment.
        policies: by name, each in an environment with the arguments it needs.
        drive: drive model.
        episodes: how many, 1..1000.
        seed: of the episodes.
        arguments: of the environment; the ends of the score keep the way they command.
        traced: the episode to be recorded, 0 being the first.

    Raises:
        ValueError: an unknown environment, drive or policy, before the first episode.
    """
    given = dict(arguments or {})
    common = {name: value for name, value in given.items() if name not in COMMANDING}
    identity = task(env).ID
    ends = [ZERO, ONE[identity]] if identity in ONE else []
    played = [(policy, needed(policy) | given) for policy in dict.fromkeys(policies)]
    bounds = [(policy, common | needed(policy)) for policy in ends]
    evaluators: dict[str, Evaluator] = {}
    done: dict[tuple[str, str], Evaluation] = {}
    try:
        for policy, own in (*played, *bounds):
            if repr(own) not in evaluators:
                try:
                    evaluators[repr(own)] = Evaluator(
                        env, drive=drive, episodes=episodes, seed=seed, traced=traced, **own
                    )
                except TypeError as error:
                    raise ValueError(
                        f"--argument: {error}: see the arguments of {identity}"
                    ) from None
            make(policy, evaluators[repr(own)].env)
        for policy, own in (*played, *bounds):
            if (policy, repr(own)) not in done:
                done[policy, repr(own)] = evaluators[repr(own)].run(policy)
    finally:
        for evaluator in evaluators.values():
            evaluator.close()
    results = [done[policy, repr(own)] for policy, own in played]
    if ends:
        zero, one = (done[policy, repr(own)].values["episode_return"] for policy, own in bounds)
        values = [scores(result.values["episode_return"], zero, one) for result in results]
        for result, score in zip(results, values, strict=True):
            result.values["score"] = score
    return results


def summaries(results: Sequence[Evaluation]) -> dict[str, list[Summary | None]]:
    """By metric that applies to any: a summary for each policy, None where it does not apply."""
    table = {}
    for metric in ("score", *METRICS):
        columns = [result.strata(metric) for result in results]
        if any(columns):
            table[metric] = [summarise(strata) if strata else None for strata in columns]
    return table


def _heading(metric: str) -> str:
    return METRICS[metric].heading if metric in METRICS else "score"


def _cell(metric: str, summary: Summary | None) -> str:
    if summary is None:
        return "–"
    if metric in SHARES:
        return f"{100 * summary.mean:.0f} %"
    return f"{number(summary.iqm)} [{number(summary.low)}, {number(summary.high)}]"


def draw(path: Path, title: str, results: Sequence[Evaluation]) -> None:
    """Interquartile means with their intervals, a panel a metric."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    table = summaries(results)
    shown = [metric for metric in SHOWN if metric in table][:6]
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    figure, panels = plt.subplots(
        rows, columns, figsize=(4.2 * columns, 0.8 + rows * (1.1 + 0.3 * len(results))),
        layout="constrained", squeeze=False, sharey=True,
    )  # fmt: skip
    names = [_label(result.policy) for result in results]
    for panel, metric in zip(panels.flat, shown, strict=False):
        for y, (name, s) in enumerate(zip(names, table[metric], strict=True)):
            if s is None or (metric != "score" and name in IDLE):
                continue
            panel.plot([s.low, s.high], [y, y], color=INK, lw=3, alpha=0.45)
            panel.plot(s.iqm, y, "o", color=INK, ms=6)
        panel.set_xlabel(_heading(metric) + _arrow(metric))
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
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _arrow(metric: str) -> str:
    better = METRICS[metric].better if metric in METRICS else "high"
    return {"high": " →", "low": " ←", "": ""}[better]


def run(
    command: str, env: str, policies: Sequence[str], drive: str, episodes: int, seed: int,
    out: Path, console: Console, arguments: Mapping[str, Any] | None = None, traced: int = 0,
) -> int:  # fmt: skip
    """Evaluate, print, and write page, data and pictures named after `command`; -> exit status.

    The second picture is of the episode `traced`.
    """
    results = evaluate(env, policies, drive, episodes, seed, arguments, traced)
    table = summaries(results)
    heading = ["metric", *(_label(result.policy) for result in results)]
    rows = [
        [_heading(metric), *(_cell(metric, s) for s in columns)]
        for metric, columns in table.items()
    ]
    shown = Table(*heading, title=f"{env}, drive {drive}, {episodes} episodes, seed {seed}")
    for row in rows:
        shown.add_row(*row)
    console.print(shown)
    chosen = f"--policy {policies[0]}" if command == "eval" else f"--policies {','.join(policies)}"
    source = origin(
        f"servogym {command} {env} {chosen} --drive {drive} --episodes {episodes} --seed {seed}"
        + (f" --trace {traced}" if traced else "")
        + "".join(f" --argument {_quoted(*one)}" for one in (arguments or {}).items())
    )
    notes = (
        f"Interquartile mean [95 % interval, stratified bootstrap, {RESAMPLES} resamples] over "
        f"{episodes} episodes, seeds {results[0].seeds[0]} to {results[0].seeds[episodes - 1]}; "
        f"{_trainings(results)}{_needs(policies)}shares are means. "
        f"Score: {_scale(env, results)}.\n\n"
    )
    notes += "\n".join(
        f"- {METRICS[metric].heading}: {METRICS[metric].what}"
        for metric in table
        if metric in METRICS
    )
    title = f"{env}, drive {drive}"
    write_page(out / f"{command}.md", title, markdown(heading, rows), source, notes)
    write_json(out / f"{command}.json", _data(source, env, drive, results, table))
    draw(out / f"{command}.png", title, results)
    episode = f"episode {traced} of seed {seed}"
    trace.draw(out / f"{command}_trace.png", f"{title}, {episode}", _traces(results))
    console.print(f"{out / command}.md, .json, .png and _trace.png")
    return 0


def _traces(results: Sequence[Evaluation]) -> list[trace.Trace]:
    """By their labels; idle policies only where there is no other."""
    moving = [result for result in results if result.policy not in IDLE] or results
    return [result.trace._replace(policy=_label(result.policy)) for result in moving]


def _quoted(name: str, value: Any) -> str:
    """As typed in a shell: ``NAME=VALUE``, a text as it is, all else in JSON."""
    return shlex.quote(f"{name}={value if isinstance(value, str) else json.dumps(value)}")


def _label(policy: str) -> str:
    """Of a folder its name."""
    return Path(policy).name if Path(policy).is_dir() else policy


def _scale(env: str, results: Sequence[Evaluation]) -> str:
    task = next((task for task in ONE if env in (task, task.partition("/")[2])), "")
    if not task:
        return "none, the task has no reference"
    if not any(result.strata("score") for result in results):
        return f"none, here {ONE[task]} earns no more than {ZERO}"
    return f"0 is {ZERO}, 1 is {ONE[task]}, by their mean returns on the same episodes"


def _needs(policies: Sequence[str]) -> str:
    rows = [(policy, needed(policy)) for policy in policies]
    return "".join(
        f"{policy} in an environment with {', '.join(_quoted(*one) for one in own.items())}; "
        for policy, own in rows if own
    )  # fmt: skip


def _trainings(results: Sequence[Evaluation]) -> str:
    several = [f"{result.policy}: {result.trainings}" for result in results if result.trainings > 1]
    return f"trainings, each a stratum: {', '.join(several)}; " if several else ""


def _data(source, env, drive, results, table) -> dict[str, Any]:
    return {
        **source,
        "env": env,
        "drive": drive,
        "seeds": sorted(set(results[0].seeds)),
        "policies": {
            result.policy: {
                "summary": {
                    metric: columns[i]._asdict()
                    for metric, columns in table.items() if columns[i] is not None
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
