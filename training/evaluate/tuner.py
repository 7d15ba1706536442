"""`servogym tune-policy`: one tuner with one budget for every row that has numbers.

The budget counts steps of the environment, as for a training. Two thirds of it try the untuned
numbers and then points that fill the ranges evenly (the additive recurrence R_d, Roberts 2018) on
`FEW` training episodes. The rest tries the best of them on `MANY` further episodes. Of the numbers
that succeed there no less often than the untuned ones, those with the best interquartile mean of
the task's metric are written; the mean alone would hide up to a quarter of failures. No choice is
made by hand. Only steps that were played count, so episodes that end early leave room for more
points.

A row of `FITTED` finds its numbers by a fit instead. Its cost is reported in the same units: steps
of the environment, processor time, and the choices that a person made.
"""

import io
import json
import time
from collections.abc import Iterable, Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from rich.console import Console

from ...drive.model.names import hint
from ...envs.engine.checks import whole
from ...envs.environment.registry import NAMESPACE, short, task
from ...envs.environment.servo_env import ServoEnv
from ..policies import POLICIES, basis_feed_forward
from ..policies.numbers import Tunable
from ..report import write_bytes
from .episodes import Evaluator
from .metrics import iqm, metrics

BUDGET = 300_000  # steps
FEW, MANY = 16, 48  # episodes, with seeds from 1 on, which no evaluation uses
FITTED = {"basis_feed_forward": basis_feed_forward}
MOST = 1000  # episodes of a fit


def points(ranges: Mapping[str, Any]) -> Iterator[dict[str, float]]:
    """Yield the untuned numbers, then points that fill the ranges evenly on logarithmic scales."""
    root = 1.5
    for _ in range(60):  # solves x ** (d + 1) = x + 1
        root = (1.0 + root) ** (1.0 / (len(ranges) + 1))
    steps = np.array([root ** -(k + 1) for k in range(len(ranges))])
    yield {name: one.untuned for name, one in ranges.items()}
    for i in count(1):
        shares = (0.5 + i * steps) % 1.0
        yield {
            name: float(one.low * (one.high / one.low) ** share)
            for (name, one), share in zip(ranges.items(), shares, strict=True)
        }


def tunable(policy: str) -> type[Tunable] | None:
    """Return the class of a row with numbers; None for another row or name."""
    row = POLICIES.get(policy)
    kind = row.make if row else None
    return kind if isinstance(kind, type) and issubclass(kind, Tunable) else None


def offered() -> list[str]:
    """Return the rows with numbers."""
    return [name for name in POLICIES if tunable(name)]


def tune(kind: type[Tunable], env: type[ServoEnv], budget: int = BUDGET) -> dict[str, Any]:
    """Tune a row for a task -> its numbers, the metric with them and untuned, and the steps."""
    steps, metric = 0, env.METRIC
    sign = -1.0 if metrics(env)[metric].better == "high" else 1.0

    def tried(
        candidates: Iterable[dict[str, float]], seeds: range, most: int
    ) -> list[tuple[tuple[float, float], dict[str, float]]]:
        """Return scores, lower is better, of at least two and as many as `most` steps allow.

        The first part of a score is the share of episodes that fail more often than untuned.
        """
        nonlocal steps
        evaluator = Evaluator(env, seeds=seeds, traced=None)
        scores: list[tuple[tuple[float, float], dict[str, float]]] = []
        least = 0.0
        for given in candidates:
            if len(scores) > 1 and steps + len(seeds) * evaluator.steps > most:
                break
            trial = type(kind.__name__, (kind,), {"GIVEN": given})
            values = evaluator.run(trial).values
            success = float(np.mean(values["success"]))
            least = least if scores else success
            own = sign * float(iqm(values[metric].reshape(1, -1))[0])
            scores.append(((max(least - success, 0.0), own), given))
            steps += evaluator.played
        evaluator.close()
        return scores

    first = tried(points(kind.RANGES), range(1, FEW + 1), 2 * budget // 3)
    order = sorted(first[1:], key=lambda one: one[0])
    finals = [given for _, given in (first[0], *order)]
    last = tried(finals, range(FEW + 1, FEW + MANY + 1), budget)
    (_, best), numbers = min(last, key=lambda one: one[0])
    return {
        "numbers": {name: round(value, 6) for name, value in numbers.items()},
        "metric": metric, "tuned": sign * best, "untuned": sign * last[0][0][1],
        "steps": steps, "points": len(first), "choices": f"ranges of {len(kind.RANGES)} numbers",
    }


def run(
    policy: str, env: str | None, budget: int | None, episodes: int | None, out: Path | None,
    console: Console,
) -> int:
    """Find the numbers of a row for a task, write them, and print the cost; -> exit status.

    Raises ValueError for a policy without numbers, or a task that does not offer it.
    """
    if budget is not None:
        whole("--budget", budget, 1, 10**9)
    kind = tunable(policy)
    if kind is None and policy not in FITTED:
        remark = hint(policy, [*FITTED, *offered()])
        raise ValueError(f"policy {policy!r} has no numbers to tune: {remark}")
    own = _task(policy, env)
    if kind is None:
        out = out or Path("out/tuned.npz")
        said = _fit(policy, own, episodes, out)
    else:
        out = out or Path("out/tuned.json")
        said = _tune(policy, kind, own, budget or BUDGET, out)
    console.print(said, highlight=False)
    console.print(f"{out}", soft_wrap=True)
    return 0


def _task(policy: str, env: str | None) -> type[ServoEnv]:
    """Return the task by name, or the only one that offers the policy."""
    if env is None:
        ids = [name for name in gymnasium.registry if name.startswith(NAMESPACE)]
        offering = [found for found in map(task, ids) if policy in found.POLICIES]
        if len(offering) == 1:
            return offering[0]
        raise ValueError(f"policy {policy!r}: for which task? add --task, as --task LinearAxis-v0")
    own = task(env)
    if policy not in own.POLICIES:
        raise ValueError(f"{own.ID} does not offer {policy!r}: {hint(policy, own.POLICIES)}")
    return own


def _fit(policy: str, own: type[ServoEnv], episodes: int | None, out: Path) -> str:
    row = FITTED[policy]
    asked = whole("--episodes", row.EPISODES if episodes is None else episodes, 1, MOST)
    begin = time.process_time()
    numbers, steps = row.fit(own, asked)
    seconds = time.process_time() - begin
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, coefficients=numbers)
    write_bytes(out, file.getvalue())
    return (
        f"{policy}: {numbers.size} numbers from {asked} episodes of {short(own.ID)}, "
        f"{steps:,} steps, {seconds:.0f} CPU-seconds; chosen by hand: {row.CHOICES}"
    )


def _tune(policy: str, kind: type[Tunable], own: type[ServoEnv], budget: int, out: Path) -> str:
    begin = time.process_time()
    found = tune(kind, own, budget)
    seconds = time.process_time() - begin
    command = f"servogym tune-policy {policy} --task {short(own.ID)}"
    found["command"] = command + (f" --budget {budget}" if budget != BUDGET else "")
    known = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    known.setdefault(policy, {})[short(own.ID)] = found
    write_bytes(out, (json.dumps(known, indent=1, sort_keys=True) + "\n").encode())
    numbers = ", ".join(f"{name} {value:g}" for name, value in found["numbers"].items())
    return (
        f"{policy} on {short(own.ID)}: {numbers}; {found['metric']} {found['untuned']:.4g} -> "
        f"{found['tuned']:.4g}; {found['points']} points, {found['steps']:,} steps, "
        f"{seconds:.0f} CPU-seconds"
    )
