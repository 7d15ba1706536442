"""Who acts: policies by name or from a Python file.

A policy is a callable that takes an observation and gives an action.
"""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np

Policy = Callable[[np.ndarray], np.ndarray]


def hold(env: gymnasium.Env, seed: int) -> Policy:
    """Zero action: set-points stay where they are."""
    action = np.zeros(env.action_space.shape or (), np.float32)
    return lambda observation: action


def random(env: gymnasium.Env, seed: int) -> Policy:
    """Actions from all of the space, alike for the same seed."""
    env.action_space.seed(seed)
    return lambda observation: env.action_space.sample()


POLICIES: dict[str, Callable[[gymnasium.Env, int], Policy]] = {"hold": hold, "random": random}


def policy(name: str, env: gymnasium.Env, seed: int = 0) -> Policy:
    """The policy `name` for an environment: of `POLICIES`, or ``FILE.py:function``.

    Raises:
        ValueError: there is no such policy, file or function, or the file cannot be run.
    """
    if name in POLICIES:
        return POLICIES[name](env, seed)
    file, colon, function = name.rpartition(":")
    if not colon:
        raise ValueError(
            f"unknown policy {name!r}: use {', '.join(POLICIES)}, or FILE.py:function for a "
            "function that takes an observation and gives an action"
        )
    path = Path(file)
    if path.suffix != ".py" or not path.is_file():
        raise ValueError(f"policy {name!r}: there is no Python file {file}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None  # for a name that ends in .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(
            f"policy {name!r}: {file} fails: {type(error).__name__}: {error}"
        ) from error
    act = getattr(module, function, None)
    if not callable(act):
        functions = [n for n, value in vars(module).items() if callable(value) and n[0] != "_"]
        raise ValueError(
            f"policy {name!r}: {file} has no function {function!r}, "
            f"only {', '.join(functions) or 'none'}"
        )
    return act
