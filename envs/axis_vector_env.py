"""servogym/LinearAxis-v0 many times over: the compiled loops run side by side on threads."""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from ..drive.words import Mode
from .axis_env import FAULT_BIT, METRE, RPDO, STROKE, TPDO, LinearAxisEnv
from .supervisor import ENABLED

RPDO_TYPE = np.dtype([("controlword", "<u2"), ("mode", "i1"), ("target", "<i4")])
TPDO_TYPE = np.dtype(
    [("statusword", "<u2"), ("position", "<i4"), ("torque", "<i2"), ("velocity", "<i4"),
     ("following_error", "<i4")]
)  # fmt: skip
assert RPDO_TYPE.itemsize == RPDO.size
assert TPDO_TYPE.itemsize == TPDO.size


class LinearAxisVectorEnv(gym.vector.VectorEnv):
    """`num_envs` environments `LinearAxisEnv`, stepped together, bit for bit as one by one.

    Each has its own machine, drive and generator. A step writes one RPDO image to each drive, runs
    all compiled loops on threads, without Python in them, and takes the TPDO images as arrays.

    Args:
        num_envs: how many.
        autoreset_mode: NEXT_STEP (the step after the end resets and ignores the action), SAME_STEP
            (``final_obs`` and ``final_info`` in the infos) or DISABLED; or their names.
        threads: of the pool; one a core if not given.
        max_episode_steps: steps until an episode is truncated.
        **arguments: of `LinearAxisEnv`.

    Raises:
        ValueError: as `LinearAxisEnv`, and for wrong actions.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        max_episode_steps: int = 200,
        **arguments: Any,
    ):
        if num_envs != int(num_envs) or num_envs < 1:
            raise ValueError(f"num_envs = {num_envs!r} must be a whole number from 1 on")
        if threads is not None and threads < 1:
            raise ValueError(f"threads = {threads!r} must be a whole number from 1 on")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = LinearAxisEnv.metadata | {"autoreset_mode": self.autoreset_mode}
        self.envs = [LinearAxisEnv(**arguments) for _ in range(num_envs)]
        first = self.envs[0]
        self.num_envs = int(num_envs)
        self.render_mode = first.render_mode
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        batch = gym.vector.utils.batch_space
        self.observation_space = batch(self.single_observation_space, self.num_envs)
        self.action_space = batch(self.single_action_space, self.num_envs)
        self.max_episode_steps = max_episode_steps
        self._workers = min(threads or os.cpu_count() or 1, self.num_envs)
        self._pool: ThreadPoolExecutor | None = None
        self._shares = np.array_split(np.arange(self.num_envs), self._workers)
        self._rpdos = np.zeros(self.num_envs, RPDO_TYPE)
        self._rpdos["controlword"] = ENABLED
        self._rpdos["mode"] = Mode.CYCLIC_SYNC_POSITION
        self._tpdos = [b""] * self.num_envs
        self._target = np.zeros(self.num_envs)
        self._goal = np.zeros(self.num_envs)
        self._steps = np.zeros(self.num_envs, np.int64)
        self._ended = np.zeros(self.num_envs, bool)

    def reset(  # type: ignore[override]
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin anew, all, or those of ``options["reset_mask"]``; seed + i is that of the i-th."""
        options = dict(options or {})
        mask = options.pop("reset_mask", np.ones(self.num_envs, bool))
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise ValueError(f"seed: {len(seeds)} are given for {self.num_envs} environments")
        for i in np.flatnonzero(mask).tolist():
            self._reset_one(i, seeds[i] if seeds else None, options)
        if not all(self._tpdos):
            raise ValueError("options['reset_mask']: the first reset has to be one of all")
        return self._observe(), self._infos()

    def _reset_one(self, i: int, seed: int | None = None, options=None) -> None:
        env = self.envs[i]
        env.reset(seed=seed, options=options)
        self._target[i], self._goal[i] = env._target, env.goal
        self._steps[i], self._ended[i] = 0, False
        self._tpdos[i] = env.drive.collect()

    def step(  # type: ignore[override]
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One step of each. Raises ValueError for actions out of the space."""
        shares = np.asarray(actions, np.float64)
        if shares.shape != (self.num_envs, 1) or not (np.abs(shares) <= 1.0 + 1e-6).all():
            raise ValueError(
                f"actions of shape {shares.shape} are not in {self.action_space}: "
                "clip them, and see that the policy's output is finite"
            )
        resting = self._ended.copy()  # these are reset instead, or wait for their reset
        first = self.envs[0]
        way = shares[:, 0] * first._speed * first.step_time
        target = np.minimum(np.maximum(self._target + way, 0.0), STROKE)
        self._target = np.where(resting, self._target, target)
        self._rpdos["target"] = np.rint(self._target * METRE)
        self._run(resting)
        observations = self._observe()
        near, settled = self._terms[1:]
        rewards = np.where(resting, 0.0, 0.5 * near + 0.5 * settled)
        self._steps += ~resting
        terminations = (self._words & FAULT_BIT != 0) & ~resting
        truncations = (self._steps >= self.max_episode_steps) & ~resting
        self._ended = terminations | truncations
        infos: dict[str, Any] = {}
        anew = np.zeros(self.num_envs, bool)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            anew = resting
        elif self.autoreset_mode == AutoresetMode.SAME_STEP:
            anew = self._ended.copy()
            if anew.any():
                infos = {"final_obs": observations, "_final_obs": anew,
                         "final_info": self._infos(), "_final_info": anew}  # fmt: skip
        else:
            self._ended |= resting
        if anew.any():
            for i in np.flatnonzero(anew).tolist():
                self._reset_one(i)
            observations = self._observe()
        infos |= self._infos()
        return observations, rewards, terminations, truncations, infos

    def _run(self, resting: np.ndarray) -> None:
        images = self._rpdos.tobytes()

        def work(indices: np.ndarray) -> None:
            for i in indices.tolist():
                if resting[i]:
                    continue
                env = self.envs[i]
                env.inject_faults()
                env.drive.latch(images[i * RPDO.size : (i + 1) * RPDO.size])
                env.machine.step(env.cycles_per_step)
                self._tpdos[i] = env.drive.collect()

        if self._workers == 1:
            work(self._shares[0])
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._workers, "servogym")
        list(self._pool.map(work, self._shares))

    def _observe(self) -> np.ndarray:
        tpdos = np.frombuffer(b"".join(self._tpdos), TPDO_TYPE)
        first = self.envs[0]
        self._words = tpdos["statusword"]
        self._terms = first.measure(
            self._goal,
            self._target,
            tpdos["position"] / METRE,
            tpdos["velocity"] / METRE,
            tpdos["following_error"] / METRE,
            tpdos["torque"] / first._max_torque,
        )
        clipped = [np.minimum(np.maximum(q, -1.0), 1.0) for q in self._terms[0]]
        return np.stack(clipped, axis=1).astype(np.float32)

    def _infos(self) -> dict[str, Any]:
        quantities, near, settled = self._terms
        infos: dict[str, Any] = {
            "distance": quantities[0] * STROKE,
            "goal": self._goal.copy(),
            "reward_near": near,
            "reward_settled": settled.astype(float),
            "is_success": settled,
        }
        infos |= {f"_{name}": np.ones(self.num_envs, bool) for name in infos}
        faulty = self._words & FAULT_BIT != 0
        if faulty.any():
            faults = [env.drive.fault for env in self.envs]
            infos |= {"fault": np.array(faults, object), "_fault": faulty}
        return infos

    def render(self) -> tuple[Any, ...] | None:
        """An image of each environment."""
        return tuple(env.render() for env in self.envs) if self.render_mode == "rgb_array" else None

    def close_extras(self, **arguments: Any) -> None:
        """Stop the threads, close what was rendered."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
        for env in self.envs:
            env.close()
