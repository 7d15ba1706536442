"""The mean action of a trained network by NumPy: to play a policy takes no torch.

The networks are those of stable-baselines3's ``MlpPolicy`` with the activations it has where
nothing else is said: tanh of PPO and A2C, ReLU of SAC. Actions differ from torch's by the rounding
of float32, 1e-6.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

Layer = tuple[np.ndarray, np.ndarray]  # weights (outputs, inputs), biases (outputs,)

PLAIN = {"net_arch", "log_std_init"}  # of policy_kwargs: what changes no more than the widths
UNIT, ZERO = np.float32(1.0), np.float32(0.0)


class Kind(NamedTuple):
    """How the networks of an algorithm are built."""

    hidden: str  # prefix of its layers
    last: str
    activation: Callable[[np.ndarray], np.ndarray]
    output: Callable[[np.ndarray], np.ndarray]  # of the last layer's numbers


def _clipped(x: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(x, -UNIT), UNIT)  # np.clip takes ten times as long


def _relu(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, ZERO)


KNOWN = {
    "PPO": Kind("mlp_extractor.policy_net", "action_net", np.tanh, _clipped),
    "A2C": Kind("mlp_extractor.policy_net", "action_net", np.tanh, _clipped),
    "SAC": Kind("actor.latent_pi", "actor.mu", _relu, np.tanh),
}


def actor(
    about: Mapping[str, Any], arrays: Mapping[str, np.ndarray], shape: tuple[int, int]
) -> Callable[[np.ndarray], np.ndarray] | None:
    """The mean action, float32 in -1..1, for a normalised observation; None for other networks.

    Args:
        about: of the checkpoint.
        arrays: of the network, by the names torch gives them.
        shape: numbers seen, actions.

    Raises:
        ValueError: the arrays do not fit one another.
    """
    settings = about["hyperparameters"]
    known = KNOWN.get(about["algorithm"])
    if known is None or set(settings.get("policy_kwargs", {})) - PLAIN:
        return None
    if f"{known.last}.0.weight" in arrays:  # of SAC with use_sde: bounded
        return None
    chain = [*_layers(arrays, known.hidden), _layer(arrays, known.last)]
    wanted = shape[0]
    for weights, biases in chain:
        if weights.ndim != 2 or weights.shape[1] != wanted or biases.shape != weights.shape[:1]:
            raise ValueError(f"a layer has the shape {weights.shape}, {wanted} numbers come in")
        wanted = len(weights)
    if wanted != shape[1]:
        raise ValueError(f"{wanted} numbers come out, there are {shape[1]} actions")
    *inner, (final, offset) = chain

    def mean(x: np.ndarray) -> np.ndarray:
        for weights, biases in inner:
            x = known.activation(weights @ x + biases)
        return known.output(final @ x + offset)

    return mean


def _layers(arrays: Mapping[str, np.ndarray], name: str) -> list[Layer]:
    """In their order: between two of them is an activation, which torch counts as well."""
    count = sum(key.startswith(f"{name}.") and key.endswith(".weight") for key in arrays)
    return [_layer(arrays, f"{name}.{2 * i}") for i in range(count)]


def _layer(arrays: Mapping[str, np.ndarray], name: str) -> Layer:
    try:
        weights, biases = arrays[f"{name}.weight"], arrays[f"{name}.bias"]
    except KeyError as error:
        raise ValueError(f"{error} is missing") from None
    return np.ascontiguousarray(weights, np.float32), np.ascontiguousarray(biases, np.float32)
