"""Tasks by their ids: registers tasks, and finds those of this and other packages.

A package of your own calls `register` for its tasks when it is imported. Its ids then work
everywhere, with the module in front as in Gymnasium: ``servogym train mylab:mylab/Nudge-v0``. For
tasks of this package ``servogym/`` may be omitted.
"""

import importlib
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
from gymnasium.envs.registration import load_env_creator

from ...drive.kernel.words import Mode
from ...drive.model import foreign
from ...drive.model.names import hint
from ..engine.checks import error_line, whole
from .device_env import vectors
from .servo_env import ServoEnv

NAMESPACE = "servogym/"
MOST_STEPS = 10**9  # longest episode


def register(task: type[ServoEnv]) -> None:
    """Register a task in Gymnasium by its ID, with the vector environments of this package.

    Raises:
        ValueError: the class has no ID or an invalid one, or invalid STEPS or MODES.
    """
    identity = getattr(task, "ID", None)
    if not isinstance(identity, str):
        raise ValueError(f"task {task.__name__} lacks ID: give it one such as 'mylab/Nudge-v0'")
    whole(f"task {task.__name__}: STEPS", task.STEPS, 1, MOST_STEPS)
    if not all(isinstance(mode, Mode) for mode in task.MODES):
        raise ValueError(
            f"task {task.__name__}: MODES = {task.MODES!r}: give members of Mode, such as "
            "(Mode.CYCLIC_SYNC_VELOCITY, Mode.HOMING)"
        )
    try:
        gymnasium.register(
            identity, entry_point=f"{task.__module__}:{task.__name__}",
            vector_entry_point=f"{__name__}:{identity}", max_episode_steps=task.STEPS,
        )
    except gymnasium.error.Error as error:
        raise ValueError(f"task {task.__name__}, ID = {identity!r}: {error}") from None


def __getattr__(identity: str) -> Callable[..., gymnasium.vector.VectorEnv]:
    """The vector environments of a task by its id, as Gymnasium looks up an entry point.

    An entry point has to be a text, so that the specification of an environment can be saved.
    """
    if identity not in _registry():
        raise AttributeError(f"module {__name__!r} has no attribute {identity!r}")
    return partial(vectors, task(identity))


def short(identity: str) -> str:
    """Return an id without the name space of this package, which may be omitted."""
    return identity.removeprefix(NAMESPACE)


def task(name: str | type[ServoEnv]) -> type[ServoEnv]:
    """Return the class of a task by its id.

    Args:
        name: id in Gymnasium, with ``module:`` in front if another package registers it; a name
            space equal to the name of that package may be omitted, ``mylab:Nudge-v0``. A class is
            returned as it is.

    Raises:
        ValueError: the module or the id does not exist (with similar ids), or the class is not a
            `ServoEnv`.
    """
    if isinstance(name, type) and issubclass(name, ServoEnv):
        return name
    if not isinstance(name, str):
        raise ValueError(f"environment {name!r}: give its id, such as 'LinearAxis-v0'")
    module, _, identity = name.rpartition(":")
    if module:
        _import(module, name)
    spaces = ("", NAMESPACE, f"{module.partition('.')[0]}/")
    found = next((each + identity for each in spaces if each + identity in _registry()), None)
    if found is None:
        raise ValueError(f"unknown environment {name!r}: {_hint(name, module)}")
    spec = _registry()[found]
    try:
        made = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else None
    except (ImportError, AttributeError) as error:
        raise ValueError(f"environment {name!r} cannot be loaded: {error}") from None
    made = spec.entry_point if made is None else made
    if not (isinstance(made, type) and issubclass(made, ServoEnv)):
        raise ValueError(
            f"environment {name!r} is not a task of servo drives: its class has to inherit from "
            "servogym.envs.ServoEnv"
        )
    if getattr(made, "ID", None) != found:
        raise ValueError(
            f"environment {name!r}: {made.__name__} is registered as {found!r}, give it the same ID"
        )
    return made


def of_a_file(name: Any, where: str, run_code: bool = False) -> Any:
    """Return the name of an environment in a file from elsewhere.

    Raises ValueError if `task` would import a module of another package for it, unless `run_code`
    consents.
    """
    module = name.rpartition(":")[0] if isinstance(name, str) else ""
    if module and module.partition(".")[0] != NAMESPACE[:-1]:
        foreign.consent(f"{where} names {name!r}: what module {module!r} does when imported",
                        run_code)
    return name


def _registry() -> dict[str, Any]:
    return gymnasium.registry  # type: ignore[return-value]


def _import(module: str, name: str) -> None:
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"environment {name!r}: module {module!r} cannot be imported "
            f"({error_line(error)}); install its package, or set PYTHONPATH"
        ) from error
    except Exception as error:
        raise ValueError(
            f"environment {name!r}: module {module!r} ends with an error of its own: "
            f"{error_line(error)}"
        ) from error


def _hint(name: str, module: str) -> str:
    """Suggest ids similar to `name`, of this package or of the package of `module`."""
    owner = module.partition(".")[0] or NAMESPACE[:-1]
    known = [
        f"{module}:{each.removeprefix(f'{owner}/')}" if module else short(each)
        for each, spec in _registry().items()
        if str(spec.entry_point).startswith((f"{owner}.", f"{owner}:"))
    ]
    return hint(name, known) or f"{owner} registers none, see servogym.envs.register"
