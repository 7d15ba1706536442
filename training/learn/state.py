"""The state from which a training run continues, as arrays: nothing is unpickled when it is read.

`state.npz`, beside the `weights.npz` of the policy, holds counters, the state of the optimizers,
variables of the algorithm outside its policy (the entropy coefficient of SAC), running means of
observations and rewards, and the latest episodes. `replay.npz` holds the replay buffer of SAC.
"""

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.running_mean_std import RunningMeanStd

from ...drive.model import foreign
from ..policies.trained import weights

STATE, REPLAY = "state.npz", "replay.npz"
COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")  # attributes of SB3's algorithms
EPISODE = ("r", "l", "t")  # of SB3's Monitor: return, length, time (s)
MEANS = ("obs_rms", "ret_rms")  # attributes of VecNormalize
SLACK = 2**20  # bytes of headers beside the arrays of a replay buffer


def save(model, folder: Path) -> None:
    """Write `state.npz` of an algorithm of stable-baselines3."""
    optimizers, variables = _names(model)
    arrays = {name: np.array(getattr(model, name)) for name in COUNTERS}
    for name in optimizers:
        for i, state in _attribute(model, name).state_dict()["state"].items():
            arrays |= {f"{name}/{i}/{key}": value.cpu().numpy() for key, value in state.items()}
    for name in variables:
        arrays[name] = _attribute(model, name).detach().cpu().numpy()
    if (statistics := model.get_vec_normalize_env()) is not None:
        for name in MEANS:
            means = getattr(statistics, name)
            arrays |= {f"{name}/{key}": np.array(value) for key, value in vars(means).items()}
    episodes = [[float(seen[key]) for key in EPISODE] for seen in model.ep_info_buffer or ()]
    arrays["episodes"] = np.array(episodes).reshape(-1, len(EPISODE))
    np.savez_compressed(folder / STATE, allow_pickle=False, **arrays)


def load(model, folder: Path) -> None:
    """Restore the saved state of a run in a new algorithm made with the same settings.

    Raises ValueError if the checkpoint has no state, or that of another network.
    """
    if not (folder / STATE).is_file():
        raise ValueError(
            f"{folder} has no {STATE}: an earlier version made it, with pickles that can run any "
            "program when they are read; begin a new run with another --out"
        )
    found = weights.load(folder)
    arrays = foreign.arrays(folder / STATE)
    try:
        _restore(model, arrays, found.network)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(
            f"{folder} does not fit the network of its {weights.ABOUT} ({error}): "
            "remove its folder, and the one before is taken"
        ) from None


def begin(model, first: weights.Weights, steps: int) -> None:
    """Give a new algorithm the weights and the means of observations of another training.

    Args:
        model: the algorithm, with its environments.
        first: weights of the other training.
        steps: steps of the other training, the weight of its means.

    Raises ValueError if they are of another network.
    """
    seen = tuple(model.observation_space.shape)
    if first.shape[:1] != seen:
        raise ValueError(
            f"the weights to start from see {first.shape[0]} numbers, here {seen[0]} are shown: "
            "history and previous_action have to be those of that training"
        )
    try:
        arrays = {name: torch.from_numpy(array) for name, array in first.network.items()}
        model.policy.load_state_dict(arrays)
    except (RuntimeError, TypeError) as error:
        raise ValueError(f"the weights to start from are of another network: {error}") from None
    mean, variance = first.mean, first.variance
    statistics = model.get_vec_normalize_env()
    if statistics is not None and mean is not None and variance is not None:
        means = statistics.obs_rms
        means.mean, means.var, means.count = mean.copy(), variance.copy(), float(steps)


def _restore(model, arrays: dict[str, np.ndarray], network: dict[str, np.ndarray]) -> None:
    optimizers, variables = _names(model)
    model.policy.load_state_dict({name: torch.from_numpy(a) for name, a in network.items()})
    for name in COUNTERS:
        setattr(model, name, int(arrays[name]))
    for name in optimizers:
        optimizer = _attribute(model, name)
        parameters = [p for group in optimizer.param_groups for p in group["params"]]
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key in arrays:
            if key.startswith(f"{name}/"):
                i, of = key.removeprefix(f"{name}/").split("/")
                shape = () if of == "step" else tuple(parameters[int(i)].shape)
                value = _shaped(key, arrays[key], shape)
                state.setdefault(int(i), {})[of] = torch.from_numpy(value)
        groups = optimizer.state_dict()["param_groups"]
        optimizer.load_state_dict({"state": state, "param_groups": groups})
    for name in variables:
        variable = _attribute(model, name)
        variable.data = torch.from_numpy(_shaped(name, arrays[name], tuple(variable.shape)))
    if (statistics := model.get_vec_normalize_env()) is not None:
        for name in MEANS:
            means: RunningMeanStd = getattr(statistics, name)
            means.mean = _shaped(name, arrays[f"{name}/mean"], np.shape(means.mean))
            means.var = _shaped(name, arrays[f"{name}/var"], np.shape(means.var))
            means.count = float(arrays[f"{name}/count"])
    episodes = [dict(zip(EPISODE, row, strict=True)) for row in arrays["episodes"].tolist()]
    model.ep_info_buffer = deque(episodes, maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)


def save_replay(model, folder: Path) -> None:
    """Write `replay.npz` of an algorithm that has a replay buffer."""
    buffer = model.replay_buffer
    used = buffer.buffer_size if buffer.full else min(buffer.pos + 1, buffer.buffer_size)
    arrays = {name: array[:used] for name, array in _replayed(buffer).items()}
    np.savez(folder / REPLAY, pos=buffer.pos, full=buffer.full, allow_pickle=False, **arrays)


def load_replay(model, folder: Path) -> None:
    """Read `replay.npz` into an algorithm's buffer. Raises ValueError if it is of another run."""
    buffer, file = model.replay_buffer, folder / REPLAY
    into = _replayed(buffer)
    arrays = foreign.arrays(file, sum(array.nbytes for array in into.values()) + SLACK)
    try:
        pos, full = int(arrays["pos"]), bool(arrays["full"])
        if not 0 <= pos < buffer.buffer_size:
            raise ValueError(f"position {pos}")
        used = buffer.buffer_size if full else min(pos + 1, buffer.buffer_size)
        rows = {n: _shaped(n, arrays[n], (used, *to.shape[1:])) for n, to in into.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{file} is not of this run ({error}): remove it, and the buffer is filled anew"
        ) from None
    for name, to in into.items():
        to[:used] = rows[name]
    buffer.pos, buffer.full = pos, full


def _names(model) -> tuple[list[str], list[str]]:
    """Return the names of the optimizers and of the variables outside the policy."""
    modules, variables = model._get_torch_save_params()
    return [name for name in modules if name != "policy"], variables


def _attribute(model, path: str) -> Any:
    for name in path.split("."):
        model = getattr(model, name)
    return model


def _replayed(buffer) -> dict[str, np.ndarray]:
    return {name: value for name, value in vars(buffer).items() if isinstance(value, np.ndarray)}


def _shaped(name: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if array.shape != shape:
        raise ValueError(f"{name} has the shape {array.shape} instead of {shape}")
    return array
