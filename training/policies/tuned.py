"""`servogym tune-policy`: policies whose numbers are fitted, and what that takes.

What a tuning costs is told in the same units as a training: steps of the environment, processor
time, and the choices that a person made on episodes of their own.
"""

import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np
from rich.console import Console

from ...drive.model.names import hint
from ...envs.engine.checks import whole
from ...envs.environment.registry import NAMESPACE, short, task
from ...envs.environment.servo_env import ServoEnv
from ..report import write_bytes
from . import basis_feed_forward

MOST = 1000  # episodes


class Tuning(NamedTuple):
    """How the numbers of a policy are found."""

    fit: Callable[..., tuple[np.ndarray, int]]  # of the task and episodes -> numbers, steps
    episodes: int
    choices: str  # of a person, and on what


TUNINGS = {
    "basis_feed_forward": Tuning(
        basis_feed_forward.fit, basis_feed_forward.EPISODES,
        "basis functions of 9 sets on 16 of them, outer loop of 3 gains on 20 of seed 11",
    ),
}


def run(
    policy: str, episodes: int | None, out: Path, console: Console, others: Sequence[str] = ()
) -> int:
    """Fit, write the numbers, and say what it took; -> exit status.

    Raises ValueError for a policy whose numbers are not fitted, with near names.
    """
    if policy not in TUNINGS:
        known = [*TUNINGS, *others]
        raise ValueError(f"policy {policy!r} is not tuned by a command: {hint(policy, known)}")
    row = TUNINGS[policy]
    count = whole("--episodes", row.episodes if episodes is None else episodes, 1, MOST)
    begin = time.process_time()
    own = _offering(policy)
    numbers, steps = row.fit(own, count)
    seconds = time.process_time() - begin
    write_bytes(out, _packed(numbers))
    console.print(
        f"{policy}: {numbers.size} numbers from {count} episodes of {short(own.ID)}, "
        f"{steps:,} steps, {seconds:.0f} CPU-seconds; chosen by hand: {row.choices}",
        highlight=False,
    )
    console.print(f"{out}", soft_wrap=True)
    return 0


def _offering(policy: str) -> type[ServoEnv]:
    """The task that offers the policy."""
    ids = [name for name in gymnasium.registry if name.startswith(NAMESPACE)]
    return next(found for found in map(task, ids) if policy in found.POLICIES)


def _packed(numbers: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, coefficients=numbers)
    return file.getvalue()
