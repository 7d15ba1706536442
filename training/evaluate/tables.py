"""Compares policies: summaries by metric, the best baseline, and differences from it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ...envs.view.about import Metric
from ..policies import POLICIES
from .episodes import Evaluation
from .metrics import Difference, Summary, difference, summarise

SCORE = Metric("score", "high", "")
SHARES = ("success", "limited", "faults")  # reported as means in percent
IDLE = ("hold", "random")  # left out of pictures, whose scales they would spoil


def column_of(policy: str) -> str:
    """Return the column heading of a policy; for a folder, its name."""
    return Path(policy).name if Path(policy).is_dir() else policy


def summaries(results: Sequence[Evaluation]) -> dict[str, list[Summary | None]]:
    """Summarise each applicable metric of each policy; None where it does not apply."""
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
    """Return the name of a policy without the part behind the colon."""
    return name.partition(":")[0]


def best(
    table: Mapping[str, Sequence[Summary | None]], names: Sequence[str], metric: str, better: str
) -> str:
    """Return the best baseline by the interquartile mean of a metric, an idle one as a last resort.

    An informed law is not a baseline: it knows what no controller can.

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
    rivals = [n for n in known if n not in IDLE and not POLICIES[_base(n)].informed] or list(known)
    sign = -1.0 if better == "high" else 1.0
    return min(rivals, key=lambda name: sign * known[name].iqm, default=names[0])


def differences(results: Sequence[Evaluation], against: str) -> dict[str, list[Difference | None]]:
    """Return each policy's difference from its opponent by metric; None without a value."""
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


def ahead(found: Difference, better: str) -> bool:
    """Whether the interval of a difference excludes 0 on the better side."""
    return found.low > 0.0 if better == "high" else found.high < 0.0 and better == "low"
