"""A `ServoVectorEnv` as the `VecEnv` of stable-baselines3.

>>> env = make("LinearAxis-v0", 64, drive="kollmorgen_akd")
>>> PPO("MlpPolicy", VecMonitor(env)).learn(100_000)
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from ...envs.environment.device_env import vectors
from ...envs.environment.registry import task
from ...envs.environment.servo_env import ServoEnv
from ...envs.environment.vector_env import ServoVectorEnv
from ..policies.trained.residual import ResidualVectorEnv
from ..policies.trained.saved import stable_baselines3

stable_baselines3()  # raises ImportError with the command that installs it
STREAM = 0x5E40  # separates the seeds of trainings from other uses of the same number

# isort: split
import torch  # noqa: E402
from stable_baselines3.common.utils import LinearSchedule  # noqa: E402
from stable_baselines3.common.vec_env import VecEnv  # noqa: E402


def make(
    env_id: str, num_envs: int = 1, *, residual: str | None = None,
    bounds: Sequence[float] | None = None, device: str | None = None, **arguments: Any,
) -> "ServoVecEnv":
    """Return environments for SB3.

    Args:
        env_id: id of any task, see `servogym.envs.environment.registry.task`.
        num_envs: number of environments.
        residual: name of a policy; the actions are bounded corrections of its actions.
        bounds: the largest correction of each component of an action, 0..1.
        device: warp device on which physics and drives are stepped; the CPU if not given. SB3 keeps
            results in NumPy arrays, so they are copied back at each step.
        **arguments: of `ServoVectorEnv` and of the task.

    Raises:
        ValueError: an unknown id, a residual without bounds or the contrary, or an argument that
            `ServoVectorEnv` or `ResidualVectorEnv` refuses.
    """
    kind, same = task(env_id), AutoresetMode.SAME_STEP
    if (residual is None) != (bounds is None):
        raise ValueError(
            f"residual = {residual!r} and bounds = {bounds!r} belong together: give the policy "
            "that is corrected and the largest correction of each action, or neither"
        )
    if residual is not None and bounds is not None:
        if device is not None:
            raise ValueError(
                f"residual = {residual!r} and device = {device!r}: a policy that is corrected acts "
                "in Python, on the cores; leave one of them out"
            )
        return ServoVecEnv(
            ResidualVectorEnv(
                kind, num_envs, residual=residual, bounds=bounds, autoreset_mode=same, **arguments
            )
        )
    made: Any = vectors(kind, num_envs, device=device, autoreset_mode=same, **arguments)
    return ServoVecEnv(made)


def learning_rate(rate: float | Sequence[float]) -> float | LinearSchedule:
    """Return a learning rate as SB3 takes it: a number, or a linear schedule of two.

    Raises ValueError for any other number of numbers.
    """
    if not isinstance(rate, Sequence):
        return rate
    if len(rate) != 2:
        raise ValueError(f"learning_rate = {rate!r}: give one number, or the first and the last")
    first, last = rate
    return LinearSchedule(first, last, 1.0)


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread, because a second one costs more than it gains in small networks."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class ServoVecEnv(VecEnv):
    """Environments for SB3 that return the same numbers as SB3's `DummyVecEnv`.

    An info is nearly empty until an episode ends: then it is that of the last step, with
    ``terminal_observation`` and ``TimeLimit.truncated``, but without ``state``, ``time`` and
    ``injected``, which a `ServoVectorEnv` does not tell.

    Args:
        vector: the environments, with `AutoresetMode.SAME_STEP`.

    Raises:
        ValueError: for another autoreset.
    """

    independent = False  # streams of episodes, see `seed`

    def __init__(self, vector: ServoVectorEnv):
        if vector.autoreset_mode != AutoresetMode.SAME_STEP:
            raise ValueError(
                f"autoreset_mode = {vector.autoreset_mode.value!r}, SB3 expects the first "
                "observation of the next episode in the step that ends one: make the vector with "
                "autoreset_mode='SameStep'"
            )
        self.vector = vector
        self._actions = np.zeros(vector.action_space.shape or ())
        super().__init__(
            vector.num_envs, vector.single_observation_space, vector.single_action_space
        )

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next reset: `seed` + k for environment k.

        With `independent` they are drawn from `seed` (numpy.random.SeedSequence), so that vectors
        of other seeds have no episode in common.
        """
        if not self.independent or seed is None:
            return super().seed(seed)
        drawn = np.random.SeedSequence([STREAM, seed]).generate_state(self.num_envs, np.uint64)
        self._seeds = [int(each) for each in drawn]
        return self._seeds

    def reset(self) -> np.ndarray:
        """Begin anew with the seeds and options set before, shape ``(num_envs, width)``.

        Raises ValueError where `set_options` was given different ones.
        """
        if any(options != self._options[0] for options in self._options):
            raise ValueError("set_options: the environments are reset together, give one dict")
        observations, _ = self.vector.reset(seed=self._seeds, options=self._options[0])
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [env.info() for env in self.vector.envs]
        return _array(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`, shape ``(num_envs, actions)`` in [-1, 1]."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all environments; return observations, rewards, dones and infos."""
        *given, ended = self.vector.step(self._actions)
        observations, rewards, terminated, truncated = map(_array, given)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in dones]
        last = _array(ended["final_obs"]) if dones.any() else observations
        for i in np.flatnonzero(dones).tolist():
            infos[i] = _row(ended["final_info"], i)
            infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
            infos[i]["terminal_observation"] = last[i].copy()
            self.reset_infos[i] = self.vector.envs[i].info()
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Stop the threads and close the renderers."""
        self.vector.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return a picture of each environment with ``render_mode="rgb_array"``, else None."""
        return self.vector.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute of the environments. Raises AttributeError if there is none."""
        return [getattr(env, attr_name) for env in self._chosen(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Set an attribute of the environments."""
        for env in self._chosen(indices):
            setattr(env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None,
        **method_kwargs: Any
    ) -> list[Any]:
        """Return the results of a method of the environments."""
        return [
            getattr(env, method_name)(*method_args, **method_kwargs)
            for env in self._chosen(indices)
        ]

    def env_is_wrapped(
        self, wrapper_class: type, indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """Return False for each environment, because SB3 wraps all of them together."""
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices: int | Iterable[int] | None) -> list[ServoEnv]:
        return [self.vector.envs[i] for i in self._get_indices(indices)]


def _array(given: Any) -> np.ndarray:
    """Return an array, copied from its device if it is a tensor."""
    return given.cpu().numpy() if isinstance(given, torch.Tensor) else given


def _row(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """Return the info of environment `i` from the infos of all, in Python's types."""
    shown = {name: values for name, values in infos.items() if not name.startswith("_")}
    drawn = shown.pop("parameters", {})
    info = {name: values[i : i + 1].tolist()[0] for name, values in shown.items()}
    info.setdefault("fault", "")
    info["parameters"] = {name: values[i : i + 1].tolist()[0] for name, values in drawn.items()}
    return info
