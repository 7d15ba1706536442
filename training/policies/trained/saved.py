"""Trained policies as a training run saves them: one folder each.

`weights.npz` is the policy; `checkpoint.json` describes the run and its progress. A folder may come
from anybody: its files are read by `servogym.drive.model.foreign`, and the names in them are looked
up in tables, never imported.
"""

from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from ....drive.model import foreign
from ....drive.model.files import content
from ....drive.model.foreign import Key
from ....drive.model.names import hint
from ....envs.engine.checks import flag, in_range, whole

BEST = "best"  # folder of a run with the policy of the best evaluation
ABOUT, MODEL, STATISTICS = "checkpoint.json", "model.zip", "vecnormalize.pkl"
ZIP = ".zip"  # of a model that stable-baselines3 saved
ALGORITHMS = ("PPO", "SAC", "A2C", "TD3", "DDPG")  # of stable-baselines3, whose policies are played
# Seeds of all episodes by which policies are judged; no training may use them.
HELD_OUT_SEEDS = range(1_000_000, 1_000_000 + 1_000 * 1_000_001)
COUNTED = {"envs": (1, 100_000), "seed": (0, 2**31 - 1)}  # of a training: lowest, highest
MOST_STEPS = 10**15  # of a training, and also the limit of its time (s)
NOTHING = type(None)
KEYS = {  # of `checkpoint.json`
    "env_id": Key(str, True), "algorithm": Key(str, True), "arguments": Key(dict, True),
    "hyperparameters": Key(dict, True), "steps": Key(int, True), "versions": Key(dict, True),
    "drive": Key(str), "seed": Key(int), "envs": Key(int),
    "residual": Key((str, NOTHING)), "bounds": Key((list, NOTHING)), "start": Key((dict, NOTHING)),
    "demonstrate": Key((str, NOTHING)), "device": Key((str, NOTHING)), "mean_reward": Key(float),
    "cpu_seconds": Key(float), "sha256": Key(str),
}


def stable_baselines3() -> ModuleType:
    """Return the library. Raises ImportError with the command that installs it if missing."""
    try:
        import stable_baselines3
    except ModuleNotFoundError as error:
        raise ImportError(
            f"training needs stable-baselines3 ({error}): pip install 'servogym[train]'"
        ) from None
    with suppress(ImportError):  # optimizers import it; its LLVM crashes if Mesa's came first
        import triton  # noqa: F401
    return stable_baselines3


def folder(of: Path) -> Path:
    """Return the checkpoint folder, of a run its best one. Raises ValueError without one."""
    if (of / ABOUT).is_file():
        return of
    if not (of / BEST).is_dir():
        raise ValueError(
            f"{of} is not a checkpoint and has no {BEST}/, that of a run's best evaluation: go on "
            "with --resume, or give one of its checkpoints/"
        )
    return of / BEST


def read(folder: Path) -> dict[str, Any]:
    """Return the content of `checkpoint.json`. Raises ValueError if no run wrote it."""
    try:
        return about(content(folder / ABOUT, "a checkpoint"), str(folder / ABOUT))
    except OSError as error:
        raise ValueError(f"{folder / ABOUT} cannot be read ({error}): {INSTEAD}") from None
    except ValueError as error:
        raise ValueError(f"{error}; {INSTEAD}") from None


INSTEAD = "remove its folder, and the one before is taken"


def about(data: bytes, where: str) -> dict[str, Any]:
    """Parse the bytes of a checkpoint's description.

    Raises ValueError if they are damaged, or name an algorithm or a corrected policy that is not in
    the tables: nothing that a file names is imported.
    """
    found = foreign.parsed(data, where, KEYS)
    one: dict[str, Any] | None = found
    while one is not None:
        foreign.checked(one, where, KEYS)
        _fits(one, where)
        one = one.get("start")
    return found | {"cpu_seconds": float(found.get("cpu_seconds", 0.0))}  # of all threads; 0: none


def _fits(found: dict[str, Any], where: str) -> None:
    if found["algorithm"] not in ALGORITHMS:
        remark = hint(found["algorithm"], ALGORITHMS)
        raise ValueError(f"{where}: algorithm {found['algorithm']!r} is unknown: {remark}")
    judged_apart(where, found.get("seed", 0), found.get("envs", 1))
    for name, limits in COUNTED.items():
        whole(f"{where}: {name}", found.get(name, limits[0]), *limits)
    whole(f"{where}: steps", found["steps"], 0, MOST_STEPS)
    in_range(f"{where}: cpu_seconds", found.get("cpu_seconds", 0.0), 0.0, MOST_STEPS)
    arguments, settings = found["arguments"], found["hyperparameters"]
    whole(f"{where}: history", arguments.get("history", 1), 1, 100)
    flag(f"{where}: previous_action", arguments.get("previous_action", False))
    if not isinstance(settings.get("policy_kwargs", {}), dict):
        raise ValueError(f"{where}: policy_kwargs = {settings['policy_kwargs']!r} is not a table")
    if found.get("residual") is not None:
        registered(found["residual"], where)
    if (found.get("residual") is None) != (found.get("bounds") is None):
        raise ValueError(f"{where}: residual and bounds belong together")
    if found.get("residual") is not None:
        for bound in found["bounds"]:
            in_range(f"{where}: bounds", bound, 0.0, 1.0)


def judged_apart(where: str, seed: int, envs: int) -> None:
    """Raise ValueError if a training would use episodes by which policies are judged."""
    low, high = HELD_OUT_SEEDS.start, HELD_OUT_SEEDS.stop - 1
    if seed <= high and seed + envs > low:
        raise ValueError(
            f"{where}: seed = {seed} with {envs} environments meets the episodes of evaluations "
            f"and suites, seeds {low} to {high}: take a seed below {low - envs}"
        )


def registered(residual: str, where: str) -> None:
    """Raise ValueError if a policy to be corrected has no registered name.

    The folder of a correction may be passed on; a file beside it would be a foreign program.
    """
    from .. import ENTRY_POINTS, declared

    names = declared()
    if residual not in names:
        raise ValueError(
            f"{where} corrects {residual!r}, which is not a registered policy: "
            f"{hint(residual, names)}; one of your own is registered by an entry point, "
            f"{ENTRY_POINTS}"
        )
