"""Speed, as ratios within one run: drive, environments, field buses, training.

Blocks of the things that are compared alternate, so that a machine that grows slower meanwhile
slows all of them.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

Tell = Callable[[str], object]  # called with what is being measured


class Peer(NamedTuple):
    """One thing to be compared: `envs` environments that `step` steps once."""

    name: str
    what: str
    envs: int
    step: Callable[[], Any]
    restart: Callable[[], Any]


def alternate(blocks: Iterable[Callable[[], Any]], repeat: int) -> np.ndarray:
    """Run each block `repeat` times in turn, after a warm-up; -> results (repeat, blocks, ...)."""
    blocks = [*blocks]
    return np.array([[block() for block in blocks] for _ in range(repeat + 1)][1:])


def step_time(
    step: Callable[[], Any], steps: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Mean time of a step (s)."""
    begin = clock()
    for _ in range(steps):
        step()
    return (clock() - begin) / steps


def rates(
    peers: Sequence[Peer], steps: int, repeat: int,
    clock: Callable[[], float] = time.perf_counter,
) -> list[dict[str, Any]]:
    """Medians of the steps per second of each peer, and of the first peer's ratio to it."""

    def rate(peer: Peer) -> float:
        peer.restart()
        return peer.envs / step_time(peer.step, steps, clock)

    taken = alternate([partial(rate, peer) for peer in peers], repeat)
    ratios = np.median(taken[:, :1] / taken, axis=0)
    medians = np.median(taken, axis=0)
    return [
        {"name": p.name, "what": p.what, "envs": p.envs, "per_s": float(r), "ours_over": float(q)}
        for p, r, q in zip(peers, medians, ratios, strict=True)
    ]


def show_table(
    console: Console, title: str, heading: Sequence[str], rows: Iterable[Sequence[str]],
    texts: Sequence[int] = (0,),
) -> None:
    """Print a table of numbers; the columns `texts` hold words."""
    table = Table(title=title)
    for i, column in enumerate(heading):
        table.add_column(column, justify="left" if i in texts else "right")
    for row in rows:
        table.add_row(*row)
    console.print(table)
