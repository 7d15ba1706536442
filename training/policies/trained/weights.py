"""A trained policy as arrays, in a file that runs no code when it is read.

`weights.npz` holds the arrays of the network by name, the numbers of its inputs and outputs, and
the running means that normalise its observations. Playing it needs NumPy, but not torch. An older
checkpoint has `model.zip` instead, which `zipped` reads.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ....drive.model import foreign
from ....drive.model.files import content
from .network import CLIP, RELU, TANH, forward
from .saved import ABOUT, stable_baselines3

WEIGHTS = "weights.npz"
NETWORK = "network/"
Layer = tuple[np.ndarray, np.ndarray]  # weights (outputs, inputs), biases (outputs,)

PLAIN = {"net_arch", "log_std_init"}  # the policy_kwargs that change at most the widths


WIDEST, MOST_LAYERS = 4096, 64  # limits of a network in a file, because memory is allocated for it


class Kind(NamedTuple):
    """The structure of an algorithm's network; activations are those of `network`."""

    hidden: str  # prefix of its hidden layers
    last: str  # name of the last layer; empty: the last hidden layer is it
    activation: int
    output: int  # activation of the last layer


KNOWN = {
    "PPO": Kind("mlp_extractor.policy_net", "action_net", TANH, CLIP),
    "A2C": Kind("mlp_extractor.policy_net", "action_net", TANH, CLIP),
    "SAC": Kind("actor.latent_pi", "actor.mu", RELU, TANH),
    "TD3": Kind("actor.mu", "", RELU, TANH),
    "DDPG": Kind("actor.mu", "", RELU, TANH),
}


class Weights(NamedTuple):
    """The content of `weights.npz`."""

    shape: tuple[int, int]  # numbers of inputs and actions
    network: dict[str, np.ndarray]
    mean: np.ndarray | None  # of the observations; None: they are not normalised
    variance: np.ndarray | None
    limits: tuple[float, float]  # largest normalised observation, addition to the variance

    def policy(self, about: dict[str, Any]) -> Any:
        """Return the policy of stable-baselines3. Raises ValueError if the arrays do not fit."""
        import gymnasium as gym
        import torch

        algorithm = getattr(stable_baselines3(), about["algorithm"])
        settings = about["hyperparameters"]
        seen, actions = (gym.spaces.Box(-1.0, 1.0, (n,), np.float32) for n in self.shape)
        more = dict(settings.get("policy_kwargs", {}))
        if settings.get("use_sde"):
            more["use_sde"] = True
        if oversize := [n for n in _numbers(more) if n > WIDEST] or _numbers(more)[MOST_LAYERS:]:
            raise ValueError(
                f"{ABOUT}: policy_kwargs ask for {oversize[0]} neurons or more than {MOST_LAYERS} "
                f"numbers: a layer has at most {WIDEST} neurons"
            )
        try:
            policy = algorithm.policy_aliases["MlpPolicy"](seen, actions, lambda _: 0.0, **more)
        except Exception as error:  # layers raise anything for arguments they cannot take
            raise ValueError(f"{ABOUT}: policy_kwargs = {more} make no network: {error}") from None
        try:
            arrays = {name: torch.from_numpy(array) for name, array in self.network.items()}
            policy.load_state_dict(arrays)
        except (RuntimeError, TypeError) as error:
            raise ValueError(f"{WEIGHTS} does not fit the network: {error}") from None
        policy.set_training_mode(False)
        return policy

    def actor(self, about: dict[str, Any]) -> Callable[[np.ndarray], np.ndarray]:
        """Return a function from observation to mean action; raises as `policy` does.

        It is compiled if the network is `known`, and played by torch otherwise.
        """
        if (kind := known(about, self.network)) is not None:
            return self.played(kind)
        policy = self.policy(about)
        return lambda seen: policy.predict(self.normalised(seen), deterministic=True)[0]

    def played(self, kind: Kind) -> Callable[[np.ndarray], np.ndarray]:
        """Return the policy of a network. Raises ValueError if the arrays do not fit."""
        try:
            mean = compiled(kind, self.network, self.shape)
        except ValueError as error:
            raise ValueError(f"{WEIGHTS} does not fit the network: {error}") from None
        return lambda seen: mean(self.normalised(seen))

    def normalised(self, observation: np.ndarray) -> np.ndarray:
        """Return an observation normalised as in the training."""
        if self.mean is None or self.variance is None:
            return observation
        clip, epsilon = self.limits
        scaled = (observation - self.mean) / np.sqrt(self.variance + epsilon)
        return np.minimum(np.maximum(scaled, -clip), clip).astype(np.float32)


def _numbers(settings: Any) -> list[float]:
    """Return all numbers in a table or list at any depth."""
    if isinstance(settings, dict | list):
        inner = settings.values() if isinstance(settings, dict) else settings
        return [number for value in inner for number in _numbers(value)]
    return [settings] if isinstance(settings, int | float) else []


def compiled(
    kind: Kind, arrays: Mapping[str, np.ndarray], shape: tuple[int, int]
) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function from normalised observation to mean action, float32 in -1..1.

    Actions differ from torch's by the rounding of float32, 1e-6.

    Args:
        kind: structure of the network.
        arrays: arrays of the network by torch's names.
        shape: numbers of inputs and actions.

    Raises:
        ValueError: the arrays do not fit one another.
    """
    layers = chain(kind, arrays)
    wanted = shape[0]
    for weights, biases in layers:
        if weights.ndim != 2 or weights.shape[1] != wanted or biases.shape != weights.shape[:1]:
            raise ValueError(f"a layer has the shape {weights.shape}, {wanted} numbers come in")
        wanted = len(weights)
    if wanted != shape[1]:
        raise ValueError(f"{wanted} numbers come out, there are {shape[1]} actions")
    numbers = np.concatenate([part.ravel() for w, b in layers for part in (w.T, b)])
    widths = np.array([shape[0], *(len(b) for _, b in layers)])

    def mean(x: np.ndarray) -> np.ndarray:
        output = np.empty(shape[1], np.float32)
        seen = np.ascontiguousarray(x, np.float32)
        forward(numbers, widths, kind.activation, kind.output, seen, output)
        return output

    return mean


def known(about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Kind | None:
    """Return the structure of a checkpoint's network; None if only its library can play it.

    The networks of ``MlpPolicy`` with default activations are known: tanh for PPO and A2C, ReLU for
    SAC, TD3 and DDPG.
    """
    kind = KNOWN.get(about["algorithm"])
    if kind is None or set(about["hyperparameters"].get("policy_kwargs", {})) - PLAIN:
        return None
    bounded = kind.last and f"{kind.last}.0.weight" in arrays  # SAC with use_sde
    return None if bounded else kind


def chain(kind: Kind, arrays: Mapping[str, np.ndarray]) -> list[Layer]:
    """Return weights and biases of each layer. Raises ValueError if one is missing."""
    layers = _layers(arrays, kind.hidden)
    if kind.last:
        layers.append(_layer(arrays, kind.last))
    if not layers:
        raise ValueError(f"{kind.hidden} is missing")
    return layers


def _layers(arrays: Mapping[str, np.ndarray], name: str) -> list[Layer]:
    """Return the layers in order; torch counts the activation between two of them as well."""
    count = sum(key.startswith(f"{name}.") and key.endswith(".weight") for key in arrays)
    return [_layer(arrays, f"{name}.{2 * i}") for i in range(count)]


def _layer(arrays: Mapping[str, np.ndarray], name: str) -> Layer:
    try:
        weights, biases = arrays[f"{name}.weight"], arrays[f"{name}.bias"]
    except KeyError as error:
        raise ValueError(f"{error} is missing") from None
    return np.ascontiguousarray(weights, np.float32), np.ascontiguousarray(biases, np.float32)


def save(model, folder: Path) -> None:
    """Write the weights of an algorithm of stable-baselines3 into the folder of a checkpoint."""
    _write(folder, model.policy.state_dict(), _widths(model), model.get_vec_normalize_env())


def load(folder: Path) -> Weights:
    """Read weights without unpickling. An older `checkpoint.json` states no SHA-256 of them.

    Raises:
        ValueError: the file is missing, is not one of weights, or was changed.
    """
    file = folder / WEIGHTS
    if not file.is_file():
        raise ValueError(f"{folder} has no {WEIGHTS}")
    found = foreign.arrays(file)
    if (folder / ABOUT).is_file() and (stated := foreign.table(folder / ABOUT).get("sha256")):
        foreign.intact(str(file), content(file, "weights", foreign.LARGEST_ARRAYS), stated)
    try:
        seen, actions = map(int, found["shape"])
        clip, epsilon = map(float, found["limits"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file} holds no weights of a policy: {error}") from None
    for name, array in found.items():
        if array.dtype.kind not in "fiu":
            raise ValueError(f"{file}: {name} has elements of {array.dtype}, no numbers")
    network = {n.removeprefix(NETWORK): a for n, a in found.items() if n.startswith(NETWORK)}
    mean, variance = found.get("mean"), found.get("variance")
    shapes = {None if array is None else array.shape for array in (mean, variance)}
    if shapes not in ({None}, {(seen,)}):
        raise ValueError(f"{file}: mean and variance are not {seen} numbers each")
    return Weights((seen, actions), network, mean, variance, (clip, epsilon))


def _widths(model) -> tuple[int, int]:
    return model.observation_space.shape[0], model.action_space.shape[0]


def _write(folder: Path, network, shape: tuple[int, int], statistics) -> None:
    kept = {f"{NETWORK}{name}": tensor.numpy() for name, tensor in network.items()}
    limits = (0.0, 0.0)
    if statistics is not None:
        kept |= {"mean": statistics.obs_rms.mean, "variance": statistics.obs_rms.var}
        limits = statistics.clip_obs, statistics.epsilon
    np.savez_compressed(
        folder / WEIGHTS, shape=np.array(shape), limits=np.array(limits), allow_pickle=False, **kept
    )
