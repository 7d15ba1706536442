"""Reads weights from `model.zip` of stable-baselines3 without running its pickles.

The file holds the arrays of the network in torch's format and its settings as JSON with embedded
pickles. The running means are often in a pickle beside it, `vecnormalize.pkl`. Arrays are read by
torch's weights-only loader. Of the settings only the text beside the pickles is read. The running
means are read by an unpickler that makes NumPy arrays, and for every other name an object that does
nothing.
"""

import io
import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ....drive.model import foreign
from ....drive.model.files import content
from .network import RELU, TANH
from .saved import MODEL, STATISTICS, stable_baselines3
from .weights import KNOWN, WEIGHTS, Kind, Weights, chain, load

ACTIVATIONS = {"Tanh": TANH, "ReLU": RELU}
TELLING = {  # a part of an array's name, and the algorithm whose policy has it
    "mlp_extractor.policy_net": "PPO", "action_net.": "PPO", "actor.latent_pi.": "SAC",
    "actor.mu.": "TD3",
}
OWN = "play it as a class in a file, FILE.py:name, which is a program that you name yourself"


def of(folder: Path) -> Weights:
    """Return the weights of a checkpoint's folder, from `weights.npz` or else `model.zip`.

    Raises ValueError as `weights.load` and `read` do.
    """
    zipped = not (folder / WEIGHTS).is_file() and (folder / MODEL).is_file()
    return read(folder / MODEL)[0] if zipped else load(folder)


def read(file: Path) -> tuple[Weights, Kind]:
    """Return the weights in `file`, with the running means beside it, and the network's structure.

    Raises:
        ValueError: the file is invalid or its network unknown; the message says what to do.
        ImportError: torch is missing; the message has the command.
    """
    parts = _parts(file)
    network = _network(file, parts["policy.pth"])
    kind = _kind(file, _settings(file, parts["data"]), network)
    layers = chain(kind, network)
    shape = layers[0][0].shape[-1], len(layers[-1][1])
    mean, variance, limits = _means(file.with_name(STATISTICS))
    if mean is not None and mean.shape != shape[:1]:
        raise ValueError(
            f"{file} sees {shape[0]} numbers, {STATISTICS} beside it has the means of {mean.size}"
        )
    return Weights(shape, network, mean, variance, limits), kind


def _parts(file: Path) -> dict[str, bytes]:
    try:
        data = content(file, "a saved model", foreign.LARGEST_ARRAYS)
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > 4 * foreign.LARGEST_ARRAYS:
                raise ValueError("it is larger than a policy can be")
            return {name: packed.read(name) for name in ("data", "policy.pth")}
    except (OSError, zipfile.BadZipFile, KeyError, RuntimeError, NotImplementedError) as error:
        raise ValueError(f"{file} is not a model that stable-baselines3 saved: {error}") from None


def _network(file: Path, data: bytes) -> dict[str, np.ndarray]:
    stable_baselines3()
    import torch

    try:
        found = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        return {str(name): np.asarray(tensor.numpy()) for name, tensor in found.items()}
    except Exception as error:  # torch raises anything
        said = " ".join(str(error).split())[:100]
        raise ValueError(f"{file} holds no weights that can be read alone: {said}; {OWN}") from None


def _settings(file: Path, data: bytes) -> dict[str, Any]:
    settings = foreign.parsed(data, f"{file}, data").get("policy_kwargs", {})
    if not isinstance(settings, dict):
        raise ValueError(f"{file}: its policy_kwargs are not a table")
    return {name: value for name, value in settings.items() if not name.startswith(":")}


def _kind(file: Path, settings: dict[str, Any], network: dict[str, np.ndarray]) -> Kind:
    name = next(
        (kind for part, kind in TELLING.items() if any(n.startswith(part) for n in network)), ""
    )
    strange = [n for n in network if "features_extractor." in n or n == "actor.log_std"]
    if not name or strange or settings.get("squash_output"):
        what = strange[0] if strange else ", ".join([*network][:2]) or "nothing"
        raise ValueError(f"{file} is none of the networks that are known ({what}): {OWN}")
    kind = KNOWN[name]
    if "activation_fn" in settings:
        found = re.fullmatch(r"<class '[\w.]*?(\w+)'>", str(settings["activation_fn"]))
        if found is None or found[1] not in ACTIVATIONS:
            given = settings["activation_fn"]
            raise ValueError(f"{file}: activation_fn = {given} is not known here: {OWN}")
        kind = kind._replace(activation=ACTIVATIONS[found[1]])
    return kind


class Nothing:
    """Stands for an unknown name in a pickle, and accepts everything."""

    state: Any = None

    def __new__(cls, *given: Any, **more: Any) -> "Nothing":
        """Accept any arguments."""
        return super().__new__(cls)

    def __init__(self, *given: Any, **more: Any):
        pass

    def __call__(self, *given: Any, **more: Any) -> "Nothing":
        """Called with anything."""
        return Nothing()

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def __setitem__(self, name: Any, value: Any) -> None:
        pass

    append = extend = add = update = __call__


def _empty(subtype: Any, shape: Any, kind: Any) -> np.ndarray:
    """Return an empty array, whose shape and numbers are unpickled afterwards."""
    return np.ndarray.__new__(np.ndarray, (0,), "b")


def _filled(buffer: Any, kind: np.dtype, shape: Any, order: str) -> np.ndarray:
    return np.frombuffer(buffer, dtype=kind).reshape(shape, order=order)  # type: ignore[call-overload]


def _number(kind: np.dtype, data: bytes) -> Any:
    return np.frombuffer(data, dtype=kind, count=1)[0]


ARRAYS = {
    "_reconstruct": _empty, "dtype": np.dtype, "_frombuffer": _filled, "scalar": _number,
}


class Numbers(pickle.Unpickler):
    """Reads arrays and numbers from a pickle without calling any function it names."""

    def find_class(self, module: str, name: str) -> Any:
        """Return the object that represents a name in the pickle."""
        numpy = module == "numpy" or module.startswith(("numpy.core.", "numpy._core."))
        return ARRAYS.get(name, Nothing) if numpy else Nothing


def _means(file: Path) -> tuple[np.ndarray | None, np.ndarray | None, tuple[float, float]]:
    """Return mean and variance of the observations with their limits, or None."""
    if not file.exists():
        return None, None, (0.0, 0.0)
    try:
        state = Numbers(io.BytesIO(content(file, "running means"))).load().state
        if not state.get("norm_obs", True):
            return None, None, (0.0, 0.0)
        means = state["obs_rms"].state
        mean, variance = (np.array(means[name], np.float64) for name in ("mean", "var"))
        if mean.ndim != 1 or mean.shape != variance.shape:
            raise ValueError(f"means of the shape {mean.shape}")
        return mean, variance, (float(state["clip_obs"]), float(state["epsilon"]))
    except Exception as error:  # a pickle that was forged raises anything
        said = " ".join(str(error).split())[:100]
        raise ValueError(f"{file} holds no running means that can be read: {said}") from None
