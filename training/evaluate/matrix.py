"""Policies × conditions: the grid that `compare --conditions` and the suites play."""

from collections.abc import Sequence
from typing import Any

from ..policies import make
from .comparison import Request
from .conditions import Condition, applied
from .episodes import Evaluation
from .grid import Grid
from .parts import Episodes

Matrix = Grid[tuple[str, Any], Evaluation]  # by condition and policy


def matrix(request: Request, rows: Sequence[Condition]) -> Matrix:
    """Each policy in each condition, on the same fixed episodes.

    A policy that does not fit a condition, such as one that commands torque where the drive has no
    mode cst, is a gap there; one that does not fit the task is refused.

    Args:
        request: policies, episodes and the nominal environments.
        rows: the conditions.

    Raises:
        ValueError: an unknown drive or policy, before the first episode.
    """
    grid, seeds = Matrix(), request.seeds
    for policy in request.each:
        own = request.needed(policy)
        nominal = own.make()
        make(policy, nominal)
        nominal.close()
        for row in rows:
            with grid.tried(key := (row.name, policy)):
                grid.cells[key] = Episodes(applied(own, row), policy, seeds)
    return grid
