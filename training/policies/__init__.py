"""Policies through one door: `make` gives an object with `reset` and `act`, by its name.

A policy is made for one environment from what may be known of it (`known.Known`), sees observations
and gives actions. It never touches the physics nor what was drawn at random. `BuiltIn` alone is no
such object: it stands for a homing method of the drive, which runs instead of an agent.
"""

from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from ...envs.faces import PDO
from ...envs.servo_env import ServoEnv
from ...envs.tasks.commissioning import CommissioningEnv
from ...envs.tasks.compliant import CompliantAxisEnv
from ...envs.tasks.homing import HomingEnv
from ...envs.tasks.positioning import LinearAxisEnv
from ...envs.tasks.sway import GantrySwayEnv
from ...envs.tasks.tracking import LinearAxisTrackingEnv
from .feed_forward import FeedForward, RuckigFeedForward
from .file import SUFFIX, Function
from .homing import BuiltIn, search_policy
from .known import Known, known
from .learned import Learned
from .lqr import Lqr
from .pd import ProportionalDifferential
from .plc import plc_policy
from .profiles import (
    Trapezoid,
    jerk_limited_policy,
    ruckig_policy,
    ruckig_zv_policy,
    ruckig_zvd_policy,
)
from .proportional import Proportional
from .still import Chance, Hold


class Policy(Protocol):
    """What every policy is."""

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The action, float32 in -1..1, for an observation."""


class Baseline(NamedTuple):
    """A row of the table."""

    make: Callable[[Known, int], Any]
    tasks: tuple[str, ...]  # ids; none: all
    what: str
    arguments: Mapping[str, Any] = MappingProxyType({})  # that its environment has to have


LINEAR = (LinearAxisEnv.ID, CompliantAxisEnv.ID)
MOVES = (*LINEAR, GantrySwayEnv.ID)
POLICIES: dict[str, Baseline] = {
    "hold": Baseline(Hold, (), "action 0"),
    "random": Baseline(Chance, (), "uniform actions from the seed"),
    "trapezoid": Baseline(Trapezoid, MOVES, "pp profile of the drive, 6086h = 0"),
    "jerk_limited": Baseline(jerk_limited_policy, MOVES, "pp profile of the drive, 6086h = 3"),
    "ruckig": Baseline(ruckig_policy, MOVES, "time-optimal at the drive's limits"),
    "ruckig+zv": Baseline(ruckig_zv_policy, MOVES, "the same, shaped for the nominal resonance"),
    "ruckig+zvd": Baseline(ruckig_zvd_policy, MOVES, "shaped twice, less particular about it"),
    "ruckig+ff": Baseline(
        RuckigFeedForward, (CompliantAxisEnv.ID,), "ruckig with inertia and friction feed-forward"
    ),
    "lqr": Baseline(
        Lqr, (CompliantAxisEnv.ID, GantrySwayEnv.ID), "state feedback from the sensor of the load"
    ),
    "proportional": Baseline(Proportional, LINEAR, "velocity from the distance"),
    "pd": Baseline(
        ProportionalDifferential, (LinearAxisEnv.ID,), "torque from distance and velocity",
        {"mode": "cst"},
    ),
    "feed_forward": Baseline(
        FeedForward, (LinearAxisTrackingEnv.ID,), "inertia and friction of the data sheet"
    ),
    "search": Baseline(search_policy, (HomingEnv.ID,), "fast, back off, slow"),
    "built_in": Baseline(
        lambda known, seed: BuiltIn(known), (HomingEnv.ID,),
        "the drive's method for the reference; built_in:N another one",
    ),
    "built_in_fast": Baseline(
        lambda known, seed: BuiltIn(known, fast=True), (HomingEnv.ID,),
        "the quickest method to it, at the task's limits; built_in_fast:N another one",
    ),
    "plc": Baseline(plc_policy, (CommissioningEnv.ID,), "the step chain of a PLC"),
}  # fmt: skip
BUILT_IN = ("built_in", "built_in_fast")  # of which a method can be asked for


MODE = "csp"  # what policies command where they do not need another mode


def needed(name: str) -> dict[str, Any]:
    """The arguments of the environment a policy needs; none for other names than of `POLICIES`."""
    row = POLICIES.get(name.partition(":")[0])
    return dict(row.arguments) if row else {}


def names(task: str) -> list[str]:
    """Of the policies for a task, by its id."""
    return [name for name, row in POLICIES.items() if not row.tasks or task in row.tasks]


LEARNED = "learned"  # what comes with the laboratory
SHIPPED = Path(str(resources.files("servogym.assets"))) / "policies"


def trainings(name: str, task: str) -> list[str]:
    """The folders of the trainings `name` stands for: ``seed_*`` in it, or itself.

    Args:
        name: a folder, or "learned", what comes with the laboratory for a task.
        task: its id.

    Raises:
        ValueError: nothing learned comes for that task.
    """
    folder = SHIPPED / task.rpartition("/")[2] if name == LEARNED else Path(name)
    if name in POLICIES or not folder.is_dir():
        if name != LEARNED:
            return []
        known = ", ".join(sorted(path.name for path in SHIPPED.glob("*-v*"))) or "none"
        raise ValueError(
            f"policy {name!r}: nothing learned comes for {task}, only for {known}; "
            "train one with `servogym train` and give its folder"
        )
    return [str(path) for path in sorted(folder.glob("seed_*"))] or [str(folder)]


def make(name: str, env: ServoEnv, seed: int = 0) -> Policy | BuiltIn:
    """A policy for `env`.

    Args:
        name: of `POLICIES`, "learned", ``built_in:N`` with a homing method, ``FILE.py:function``
            with a function ``act(observation) -> action``, or a folder of `servogym train`; of
            several trainings ``seed_*`` in it the first is taken.
        env: whose constants it knows.
        seed: of what is random in it.

    Raises:
        ValueError: an unknown name, one for other tasks, a machine it cannot serve.
    """
    task = env.ID
    base, _, rest = name.partition(":")
    if base.endswith(SUFFIX):
        return Function(name)
    if folders := trainings(name, task):
        return Learned(Path(folders[0]), env)
    row = POLICIES.get(base)
    if row is None or (rest and base not in BUILT_IN):
        raise ValueError(
            f"policy {name!r} is unknown: for {task} choose of {', '.join(names(task))}, "
            "FILE.py:function, or a folder of `servogym train`"
        )
    if row.tasks and task not in row.tasks:
        raise ValueError(
            f"policy {name!r} is for {', '.join(row.tasks)}: for {task} choose of "
            f"{', '.join(names(task))}"
        )
    if env.face == PDO and CommissioningEnv.ID not in row.tasks and row.tasks:
        raise ValueError(f'policy {name!r} moves set-points: make {task} with action="setpoint"')
    if row.tasks:
        for argument, value in ({"mode": MODE} | needed(name)).items():
            given = vars(env).get(argument, value)
            if given != value:
                raise ValueError(
                    f"policy {name!r} does not command {argument} = {given!r}: make {task} with "
                    f"{argument}={value!r}"
                )
    data = known(env)
    if not rest:
        return row.make(data, seed)
    try:
        return BuiltIn(data, int(rest), fast=base == BUILT_IN[1])
    except ValueError:
        raise ValueError(f"policy {name!r}: after the colon comes a homing method 6098h") from None
