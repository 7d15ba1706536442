"""Policies × conditions: the jobs that play them, and what each found; or why there is a gap."""

from collections.abc import Mapping, Sequence
from typing import Any

from ...envs.engine.checks import words
from ...envs.environment.registry import task
from ..policies import make, needed
from ..scale.job import Job, Result
from .conditions import Condition, setting
from .episodes import Evaluation, fixed
from .parts import Episodes

Row = list[Evaluation | None]


class Matrix:
    """Each policy in each condition, on the same fixed episodes.

    A policy that does not fit a condition, such as one that commands torque where the drive has no
    mode cst, is a gap there; one that does not fit the task is refused.

    Args:
        env: id of the environment.
        policies: by name, each in an environment with the arguments it needs.
        drive: drive model, where a condition has no other.
        seed: of the episodes.
        episodes: how many, 1..1000.
        arguments: of the environment.
        rows: the conditions.

    Raises:
        ValueError: an unknown environment, drive or policy, before the first episode.
    """

    def __init__(
        self, env: str, policies: Sequence[Any], drive: str, seed: int, episodes: int,
        arguments: Mapping[str, Any], rows: Sequence[Condition],
    ):  # fmt: skip
        kind, seeds = task(env), fixed(seed, episodes)
        self.policies, self.rows = list(dict.fromkeys(policies)), list(rows)
        self.gaps: dict[tuple[str, Any], str] = {}  # by condition and policy: the reason
        self._cells: dict[tuple[str, Any], Episodes] = {}
        for policy in self.policies:
            own = needed(policy) | dict(arguments)
            try:
                nominal = kind(drive=drive, **own)
            except TypeError as error:
                raise ValueError(f"--argument: {words(error)}") from None
            make(policy, nominal)
            nominal.close()
            for row in self.rows:
                try:
                    given = setting(kind, drive, own, row)
                    cell = Episodes(env, policy, row.drive or drive, seeds, given)
                except ValueError as error:
                    self.gaps[row.name, policy] = str(error)
                else:
                    self._cells[row.name, policy] = cell

    @property
    def jobs(self) -> list[Job]:
        """All of them."""
        return [job for cell in self._cells.values() for job in cell.jobs]

    def results(self, found: Sequence[Result]) -> dict[str, Row]:
        """By condition: of each policy, from the results of the jobs; None where there is a gap."""
        left, done = iter(found), {}
        for key, cell in self._cells.items():
            done[key] = cell.evaluation([next(left) for _ in cell.jobs])
        return {
            row.name: [done.get((row.name, policy)) for policy in self.policies]
            for row in self.rows
        }

    def told(self) -> str:
        """The gaps, a line each; empty without any."""
        return "".join(
            f"- {condition}, {policy}: {reason}\n"
            for (condition, policy), reason in self.gaps.items()
        )
