"""Residual learning: a bounded correction of the actions of another policy.

The action of the environment is ``clip(baseline + bounds × correction, -1, 1)``, component by
component. With a correction of 0 it is the baseline, bit for bit (Johannink et al. 2019, Silver et
al. 2018).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....envs.environment.servo_env import ServoEnv
from ....envs.environment.vector_env import ServoVectorEnv
from ....envs.exchange import fields
from ..bound import Bound
from ..homing import BuiltIn
from .saved import registered

PUBLIC = ("goal", "state", "fault")  # the infos that a policy may see


def public(info: dict[str, Any]) -> dict[str, Any]:
    """Return the part of an environment's info that a policy may see."""
    return {name: info[name] for name in PUBLIC if name in info}


def checked(bounds: Sequence[float], env: ServoEnv) -> np.ndarray:
    """Return the bounds of a correction as float32, one for each component of an action.

    Raises ValueError for another number of bounds, or a bound outside 0..1.
    """
    wanted = fields.names(env.action_record)
    array = np.asarray(bounds, np.float32)
    if array.shape != (len(wanted),):
        raise ValueError(
            f"bounds = {_listed(bounds)}: {array.size} given, {env.ID} has {len(wanted)} actions: "
            f"{', '.join(wanted)}"
        )
    if not ((array >= 0.0) & (array <= 1.0)).all():
        raise ValueError(f"bounds = {_listed(bounds)}: each is a share of an action, 0..1")
    return array


def baseline(name: str, env: ServoEnv, seed: int = 0) -> Any:
    """Return the policy that is corrected. Raises ValueError if it does not fit the task."""
    from .. import make

    policy = make(name, env, seed)
    if isinstance(policy, BuiltIn | Bound):
        raise ValueError(
            f"residual {name!r} gives no actions that could be corrected: choose another policy"
        )
    return policy


def corrected(base: np.ndarray, bounds: np.ndarray, correction: np.ndarray) -> np.ndarray:
    """Return the corrected action, float32 in -1..1."""
    return np.clip(base + bounds * np.asarray(correction, np.float32), -1.0, 1.0)


def _listed(bounds: Sequence[float]) -> str:
    return ",".join(f"{bound:g}" for bound in bounds)


class ResidualVectorEnv(ServoVectorEnv):
    """Environments whose actions are corrections of a policy, each with its own copy of it.

    Args:
        task: class of the environments.
        num_envs: number of environments.
        residual: name of the policy that is corrected, as `make` takes it.
        bounds: the largest correction of each component of an action, 0..1.
        **arguments: of `ServoVectorEnv` and of the task.

    Raises:
        ValueError: the policy does not fit the task, the bounds are wrong, or `ServoVectorEnv`
            refuses an argument.
    """

    def __init__(
        self, task: type[ServoEnv], num_envs: int = 1, *, residual: str, bounds: Sequence[float],
        **arguments: Any
    ):
        registered(residual, "--residual")
        super().__init__(task, num_envs, **arguments)
        self.bounds = checked(bounds, self.envs[0])
        self._policies = [baseline(residual, env) for env in self.envs]
        self._bases = np.zeros(self._batch.actions.shape, np.float32)
        self._residual = residual

    def _restart(self, rows: list[int], options: dict[str, Any] | None = None) -> None:
        super()._restart(rows, options)
        for i in rows:
            seen = self._batch.observed(slice(i, i + 1))[0]
            self._policies[i].reset(seen, public(self.envs[i].info()))

    def _reset(self, seed: Any, options: dict[str, Any] | None) -> Any:
        observations, infos = super()._reset(seed, options)
        mask = (options or {}).get("reset_mask", self._all)
        self._look(observations, np.flatnonzero(mask).tolist())
        return observations, infos

    def _step(self, actions: np.ndarray) -> Any:
        given = np.asarray(actions, np.float32)
        if given.shape == self._bases.shape and (np.abs(given) <= 1.0 + 1e-6).all():
            actions = corrected(self._bases, self.bounds, given)
        result = super()._step(actions)
        self._look(result[0], np.flatnonzero(~self._ended).tolist())
        return result

    def _look(self, observations: np.ndarray, rows: list[int]) -> None:
        """Ask the policies for their next actions; they see each observation once."""
        for i in rows:
            self._bases[i] = self._policies[i].act(observations[i])

    def __reduce__(self) -> tuple[Any, ...]:
        """Raise TypeError, because the memory of the policies cannot be copied."""
        raise TypeError("a ResidualVectorEnv cannot be copied or pickled in mid-episode")
