"""Vector of environments of one task, stepped by compiled loops on parallel threads."""

import copy
import os
import weakref
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from ..engine.checks import choice, whole
from ..engine.checks import threads as granted
from ..engine.guard import Turn
from ..engine.residence import Residence
from ..exchange.batch import shown
from ..exchange.faces import FAULT
from .servo_env import ServoEnv

MOST = 1_000_000  # environments, threads or steps


class ServoVectorEnv(gym.vector.VectorEnv):
    """`num_envs` environments of a task, stepped together, bit-identical to single environments.

    Each environment has its own machine, drives and random generator. A step makes three compiled
    calls per thread for all its environments: actions to RPDO images, machines, TPDO images to
    observations.

    Args:
        task: class of the environments.
        num_envs: number of environments.
        autoreset_mode: NEXT_STEP (the step after the end resets and ignores the action), SAME_STEP
            (``final_obs`` and ``final_info`` in the infos) or DISABLED; or their names.
        threads: number of threads; by default ``SERVOGYM_THREADS``, otherwise one per core.
        max_episode_steps: steps until an episode is truncated; by default the task's.
        **arguments: arguments of the task.

    Raises:
        ValueError: an argument that the task refuses, or actions outside the action space.
    """

    def __init__(
        self, task: type[ServoEnv], num_envs: int = 1, *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, threads: int | None = None,
        max_episode_steps: int | None = None, **arguments: Any
    ):
        if not (isinstance(task, type) and issubclass(task, ServoEnv)):
            raise ValueError(
                f"task = {task!r}: give the class of a task, such as "
                "servogym.envs.task('LinearAxis-v0')"
            )
        self._arguments = {
            "task": task, "autoreset_mode": autoreset_mode, "threads": threads,
            "max_episode_steps": max_episode_steps, **arguments,
        }
        self.num_envs = whole("num_envs", num_envs, 1, MOST)
        if arguments.get("port") is not None:
            raise ValueError(
                "port: drives on a bus belong to one environment, use gymnasium.make"
            )
        if threads is not None:
            threads = whole("threads", threads, 1, MOST)
        if max_episode_steps is not None:
            max_episode_steps = whole("max_episode_steps", max_episode_steps, 1, MOST)
        if not isinstance(autoreset_mode, AutoresetMode):
            modes = [mode.value for mode in AutoresetMode]
            autoreset_mode = AutoresetMode(choice("autoreset_mode", autoreset_mode, modes))
        self.autoreset_mode = autoreset_mode
        workers = min(threads or granted(), self.num_envs)
        edges = np.linspace(0, self.num_envs, workers + 1).astype(int).tolist()
        self.envs: list[ServoEnv] = []
        for begin, end in pairwise(edges):
            for _ in range(begin, end):
                env = task(**arguments)
                self.envs.append(env)
                if len(self.envs) == begin + 1:
                    residence = Residence(env.machine.model, env.machine.data)
                env.machine.share(residence)
        first = self.envs[0]
        self.metadata = first.metadata | {"autoreset_mode": self.autoreset_mode}
        self.render_mode = first.render_mode
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        space = gym.vector.utils.batch_space
        self.observation_space = space(self.single_observation_space, self.num_envs)
        self.action_space = space(self.single_action_space, self.num_envs)
        self.max_episode_steps = max_episode_steps or task.STEPS
        self._batch = first.batch(self.num_envs)
        for row, env in enumerate(self.envs):
            env.join(self._batch, row)
        self._worlds = self._batch.worlds.copy()
        self._parts = [self._batch.part(*edge) for edge in pairwise(edges)]
        self._pool: ThreadPoolExecutor | None = None
        self._turn = Turn()
        self._steps = np.full(self.num_envs, -1, np.int64)  # -1: not begun
        self._ended = np.zeros(self.num_envs, bool)
        self._all = np.ones(self.num_envs, bool)

    def reset(  # type: ignore[override]
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Reset all environments, or those in ``options["reset_mask"]``; the i-th gets seed + i."""
        with self._turn:
            return self._reset(seed, options)

    def _reset(
        self, seed: int | list[int | None] | None, options: dict[str, Any] | None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        options = dict(options or {})
        mask = options.pop("reset_mask", self._all)
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise ValueError(f"seed: {len(seeds)} are given for {self.num_envs} environments")
        rows = np.flatnonzero(mask).tolist()
        if seeds is not None:
            for i in rows:
                gym.Env.reset(self.envs[i], seed=seeds[i])
        self._restart(rows, options)
        if (self._steps < 0).any():
            raise ValueError("options['reset_mask']: the first reset has to be one of all")
        return self._observed(), self._infos()

    def _observed(self) -> np.ndarray:
        """Return a copy of the observations of all environments."""
        return self._batch.observed(slice(None))

    def _restart(self, rows: list[int], options: dict[str, Any] | None = None) -> None:
        """Begin an episode in each of these rows."""
        for i in rows:
            self.envs[i].restart(options)
            self._steps[i], self._ended[i] = 0, False

    def step(  # type: ignore[override]
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Run one step of every environment.

        Raises:
            ValueError: actions outside the action space.
            Exception: raised by `Machine.step`, or Ctrl-C; all environments must then be reset.
        """
        with self._turn:
            return self._step(actions)

    def _step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        batch, given = self._batch, self._checked(actions)
        if (self._steps < 0).any():
            raise gym.error.ResetNeeded("call reset() before the first step")
        resting = self._ended.copy()  # these are reset now, or wait for their reset
        moving = ~resting
        batch.worlds[:] = np.where(resting, 0, self._worlds)
        try:
            self._act_on(given, moving)
            self._run(moving)
        except BaseException:
            self._steps[:] = -1  # some have stepped, some have not
            raise
        finally:
            batch.worlds[:] = self._worlds
        self._remember(moving)
        self._steps += moving
        rewards = np.where(resting, 0.0, batch.episodes["reward"])
        terminations = batch.episodes["_terminated"] & moving
        truncations = (self._steps >= self.max_episode_steps) & moving
        self._ended = terminations | truncations
        infos: dict[str, Any] = {}
        resets = np.zeros_like(self._ended)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            resets = resting
        elif self.autoreset_mode == AutoresetMode.SAME_STEP:
            resets = self._ended.copy()
            if resets.any():
                infos = {"final_obs": self._observed(), "_final_obs": resets,
                         "final_info": self._infos(), "_final_info": resets}
        else:
            self._ended |= resting
        self._restart(np.flatnonzero(resets).tolist())
        infos |= self._infos()
        return self._observed(), rewards, terminations, truncations, infos

    def _checked(self, actions: Any) -> Any:
        """The numbers of actions. Raises ValueError if they are outside the action space."""
        try:
            given = self._numbers(actions)
        except (TypeError, ValueError):
            raise ValueError(f"actions = {actions!r} are not in {self.action_space}") from None
        if given.shape != self._batch.actions.shape:
            raise ValueError(
                f"actions of shape {tuple(given.shape)} are not in {self.action_space}: give a row "
                "for each environment"
            )
        outside = ~(abs(given) <= 1.0 + 1e-6)
        if outside.any():
            place = [int(at[0]) for at in outside.nonzero()]
            raise ValueError(
                f"actions{place} = {float(given[tuple(place)]):g} is not in -1..1: clip them, and "
                "see that the policy's output is finite"
            )
        return given

    def _numbers(self, actions: Any) -> Any:
        """Convert actions to an array. Raises TypeError or ValueError if they are not numbers."""
        return np.asarray(actions, np.float64)

    def _act_on(self, given: Any, moving: np.ndarray) -> None:
        self._batch.actions[moving] = given[moving]

    def _remember(self, moving: np.ndarray) -> None:
        """Put the observations of the rows that have moved in front of their history."""
        self._batch.remember(slice(None) if moving.all() else moving)

    def _run(self, moving: np.ndarray) -> None:
        for i, env in enumerate(self.envs):
            if moving[i]:
                env.inject_faults()
        if len(self._parts) == 1:
            self._batch.run(self._parts[0])
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(len(self._parts) - 1, "servogym")
            _with_threads.add(self)
        others = [self._pool.submit(self._batch.run, part) for part in self._parts[1:]]
        try:
            self._batch.run(self._parts[0])  # in this thread, which need not be woken
            for other in others:
                other.result()
        except BaseException:
            self._batch.stopped = True
            wait(others)
            raise
        finally:
            self._batch.stopped = False

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy or a pickle is a vector of its own in the present state, without threads."""
        with self._turn:
            kept = [env.snapshot() for env in self.envs]
            own = self._steps.copy(), self._ended.copy(), copy.deepcopy(self._np_random)
            return _rebuild, (self.num_envs, self._arguments, kept, own)

    def _infos(self) -> dict[str, Any]:
        batch = self._batch
        names = [name for name in batch.episodes.dtype.names if shown(name)]
        infos: dict[str, Any] = {name: np.array(batch.episodes[name]) for name in names}
        if self.envs[0].parameters:
            infos["parameters"] = {
                name: np.array([env.parameters[name] for env in self.envs])
                for name in self.envs[0].parameters
            }
        if self.envs[0].line is not None:
            infos["frames_lost"] = np.array([env.line.lost for env in self.envs if env.line])
        infos |= {f"_{name}": self._all.copy() for name in infos}
        faulty = (batch.words & FAULT != 0).any(axis=1)
        if faulty.any() or batch.lines:
            words = batch.words.tolist()
            faults = [env.faults(word) for env, word in zip(self.envs, words, strict=True)]
            faulty = np.array([fault != "" for fault in faults])
            if faulty.any():
                infos |= {"fault": np.array(faults, object), "_fault": faulty}
        return infos

    def render(self) -> tuple[Any, ...] | None:
        """Return an image of each environment."""
        for env, steps in zip(self.envs, self._steps.tolist(), strict=True):
            env._steps = steps  # which only the vector counts
        return tuple(env.render() for env in self.envs) if self.render_mode == "rgb_array" else None

    def close_extras(self, **arguments: Any) -> None:
        """Stop the threads and close all renderers."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
        for env in self.envs:
            env.close()


_with_threads: "weakref.WeakSet[ServoVectorEnv]" = weakref.WeakSet()


def _forked() -> None:
    """Forget the threads in a forked process, where they do not exist."""
    for vector in _with_threads:
        vector._pool = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def _rebuild(num_envs: int, arguments: dict[str, Any], kept: list, own: tuple) -> ServoVectorEnv:
    vector = ServoVectorEnv(num_envs=num_envs, **arguments)
    for env, its in zip(vector.envs, kept, strict=True):
        env.restore(its)
    vector._steps[:], vector._ended[:], vector._np_random = own
    return vector
