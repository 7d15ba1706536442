"""Policies by name: `make` returns an object with `reset` and `act`.

A policy is made for one environment from its data sheet (`datasheet.Datasheet`), receives
observations and returns actions. It has no access to the physics or to randomly drawn parameters.
Two entries are not such objects: `BuiltIn` represents a homing method of the drive, which runs
instead of an agent, and `Bound` a limit that no policy can exceed.
"""

import os
from collections.abc import Callable, Mapping
from functools import partial
from importlib import metadata, resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from ...drive.model.names import hint
from ...envs import ON_MODELS, TASKS
from ...envs.engine.checks import error_line
from ...envs.environment.servo_env import ServoEnv
from ...envs.exchange.faces import PDO, SETPOINT
from .adaptive import AdaptiveLqr
from .adaptive_feed_forward import AdaptiveFeedForward, LeadingFeedForward
from .basis_feed_forward import BasisFeedForward
from .bound import Bound
from .datasheet import datasheet
from .disturbance_observer import DisturbanceObserver
from .feed_forward import FeedForward, RuckigFeedForward
from .file import SUFFIX, from_file, policy_of
from .gantry import (
    ConstantFeed,
    FullFeed,
    SlowSquaring,
    Squaring,
    TunedFullFeed,
    TunedSquaring,
)
from .homing import BuiltIn, TunedSearch, search_policy
from .identified import IdentifiedZv, IdentifiedZvd
from .idle import Chance, Hold
from .informed import INFORMED, PREFIX
from .lqr import Lqr
from .pd import Proportional, ProportionalDifferential, TunedProportional
from .plc import TunedTimed, plc_policy, timed_policy
from .predictive import Predictive
from .profiles import (
    Profile,
    SCurve,
    Trapezoid,
    TunedRuckig,
    extra_insensitive,
    notched,
    of_the_profile,
)
from .repeated import repeated
from .trained.learned import Learned
from .trained.saved import ZIP


class Policy(Protocol):
    """The interface of every policy."""

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the action, float32 in -1..1, for an observation."""


class Baseline(NamedTuple):
    """A row of the table. Each task lists the rows that it offers in its ``POLICIES``."""

    make: Callable[..., Any]  # from a data sheet and a seed
    what: str
    arguments: Mapping[str, Any] = MappingProxyType({})  # needed by its environment
    face: str = SETPOINT  # of its actions
    # It is made from the environment, knows what was drawn or rehearses it, and does not compete.
    informed: bool = False
    shapes: bool = False  # its path is shaped for a resonance, which the machine has to have


POLICIES: dict[str, Baseline] = {
    "hold": Baseline(Hold, "action 0"),
    "random": Baseline(Chance, "uniform actions from the seed"),
    "trapezoid": Baseline(
        partial(Trapezoid, bounds=of_the_profile), "pp profile of the drive, 6086h = 0"
    ),
    "jerk_limited": Baseline(
        partial(Profile, bounds=of_the_profile), "pp profile of the drive, 6086h = 3"
    ),
    "ruckig": Baseline(Profile, "time-optimal at the drive's limits"),
    "ruckig+zv": Baseline(
        partial(Profile, shapers=1), "ruckig through a ZV shaper for the nominal resonance",
        shapes=True,
    ),
    "ruckig+zvd": Baseline(
        partial(Profile, shapers=2), "ruckig through a ZVD shaper: slower, less sensitive",
        shapes=True,
    ),
    "ruckig+ei": Baseline(
        partial(Profile, shapers=1, shape=extra_insensitive),
        "ruckig through an extra-insensitive shaper, which leaves 5 % of the vibration",
        shapes=True,
    ),
    "s_curve": Baseline(
        SCurve, "pp profile with the jerk time of one period of the resonance", shapes=True
    ),
    "ruckig+notch": Baseline(
        partial(Profile, shapers=1, shape=notched),
        "ruckig through a notch filter at the nominal resonance", shapes=True,
    ),
    "tuned_ruckig": Baseline(TunedRuckig, "ruckig with torque and jerk fitted by the tuner"),
    "identified+zv": Baseline(
        IdentifiedZv, "ruckig shaped for the resonance identified in the first motion", shapes=True
    ),
    "identified+zvd": Baseline(
        IdentifiedZvd, "identified+zv with a ZVD shaper: slower, less sensitive", shapes=True
    ),
    "ruckig+ff": Baseline(RuckigFeedForward, "ruckig with inertia and friction feed-forward"),
    "lqr": Baseline(Lqr, "state feedback from the sensor of the load"),
    "adaptive_lqr": Baseline(AdaptiveLqr, "lqr with the resonance identified as it moves"),
    "mpc": Baseline(Predictive, "model predictive control with the limits, by OSQP"),
    "proportional": Baseline(Proportional, "velocity from the distance"),
    "tuned_proportional": Baseline(
        TunedProportional, "proportional with a braking curve and numbers of the tuner"
    ),
    "pd": Baseline(ProportionalDifferential, "torque from distance and velocity", {"mode": "cst"}),
    "feed_forward": Baseline(FeedForward, "inertia and friction of the datasheet"),
    "adaptive_feed_forward": Baseline(
        AdaptiveFeedForward, "feed_forward with mass and friction identified, and an outer loop"
    ),
    "leading_feed_forward": Baseline(
        LeadingFeedForward, "adaptive_feed_forward with set-points that lead by the identified lag"
    ),
    "basis_feed_forward": Baseline(
        BasisFeedForward,
        "leading_feed_forward with corrections fitted to the results of iterative learning",
    ),
    "disturbance_observer": Baseline(
        DisturbanceObserver, "feed_forward with the estimated disturbance, and an outer loop"
    ),
    "iterative_learning": Baseline(
        repeated, "corrections learned in rehearsals of the same motion", informed=True
    ),
    "search": Baseline(search_policy, "fast, back off, slow"),
    "tuned_search": Baseline(TunedSearch, "search at speeds of the tuner"),
    "built_in": Baseline(
        lambda datasheet, seed: BuiltIn(datasheet),
        "the drive's homing method for the task; built_in:N is method N",
    ),
    "built_in_fast": Baseline(
        lambda datasheet, seed: BuiltIn(datasheet, fast=True),
        "the quickest method to the same home, at the task's limits; built_in_fast:N is method N",
    ),
    "squaring": Baseline(
        Squaring, "slow over the home switches, then square on the way to the goal"
    ),
    "squaring_slow": Baseline(SlowSquaring, "squaring at a quarter of its speeds and ramps"),
    "tuned_squaring": Baseline(TunedSquaring, "squaring at speeds of the tuner"),
    "constant_feed": Baseline(ConstantFeed, "the path at full feed, no correction"),
    "full_feed": Baseline(FullFeed, "the path ahead of the drives' lag, slower at corners"),
    "tuned_full_feed": Baseline(
        TunedFullFeed, "full_feed with an outer loop and numbers of the tuner"
    ),
    **{
        PREFIX + law: Baseline(make, f"{law}, given what was drawn", informed=True)
        for law, make in INFORMED.items()
    },
    "bound": Baseline(
        Bound, "a limit that no policy can exceed; nothing is played", informed=True
    ),
    "plc": Baseline(plc_policy, "the step chain of a PLC", face=PDO),
    "plc_timed": Baseline(timed_policy, "the step chain by the clock, without feedback", face=PDO),
    "tuned_plc_timed": Baseline(TunedTimed, "plc_timed with times of the tuner", face=PDO),
}
ANYWHERE = ("hold", "random")  # fit every task
BUILT_IN = ("built_in", "built_in_fast")  # may be followed by ``:N``, a homing method
ENTRY_POINTS = "servogym.policies"  # of other packages: a name, and what makes a policy


MODE = "csp"  # the mode of all policies that do not name another one


def needed(name: Any) -> dict[str, Any]:
    """Return the environment arguments a policy needs; none for names outside `POLICIES`."""
    row = POLICIES.get(label(name).partition(":")[0])
    return dict(row.arguments) if row else {}


def fitted(name: str) -> bytes:
    """Return the file of fitted numbers that a row of `POLICIES` reads; empty for other rows."""
    row = POLICIES.get(name.partition(":")[0])
    read: Callable[[], bytes] = getattr(row.make if row else None, "fitted", bytes)
    return read()


def declared() -> list[str]:
    """Return all registered names: those of the table, then those of installed packages."""
    points = metadata.entry_points(group=ENTRY_POINTS)
    return [*POLICIES, *sorted({point.name for point in points} - POLICIES.keys())]


def names(task: type[ServoEnv] | ServoEnv) -> list[str]:
    """Return the policies for a task, followed by those declared by other packages.

    For an environment, policies that shape for a resonance its machine lacks are left out.
    """
    there = [n for n in declared() if n not in POLICIES or n in ANYWHERE or n in task.POLICIES]
    shapers = [n for n in there if (row := POLICIES.get(n.removeprefix(PREFIX))) and row.shapes]
    if not shapers or not isinstance(task, ServoEnv):
        return there
    still = any(axis.vibration is None for axis in datasheet(task).axes)
    return [n for n in there if not (still and n in shapers)]


POLICIES_TOLD = "FILE.py:name, a folder of `servogym train`, or model.zip of stable-baselines3"
LEARNED = "learned"  # the trained policies that are shipped
SHIPPED = Path(str(resources.files("servogym.assets"))) / "policies"


def trainings(name: Any, task: str) -> list[str]:
    """Return the training folders that `name` stands for: its ``seed_*`` folders, or itself.

    Args:
        name: a folder, a ``model.zip`` of stable-baselines3, or "learned" for the policy that is
            shipped for the task.
        task: its id.

    Raises:
        ValueError: no learned policy is shipped for that task.
    """
    if not isinstance(name, str):
        return []
    if name.endswith(ZIP) and os.path.isfile(name):
        return [name]
    folder = SHIPPED / task.rpartition("/")[2] if name == LEARNED else Path(name)
    if (
        name in POLICIES or not name.strip() or not os.path.isdir(folder)
    ):  # False for any text, long as it may be
        if name != LEARNED:
            return []
        available = ", ".join(sorted(path.name for path in SHIPPED.glob("*-v*"))) or "none"
        raise ValueError(
            f"policy {name!r}: nothing learned comes for {task}, only for {available}; "
            "train one with `servogym train` and give its folder"
        )
    return [str(path) for path in sorted(folder.glob("seed_*"))] or [str(folder)]


def label(policy: Any) -> str:
    """Return the label of a policy: its name, or the name of its class or function."""
    return policy if isinstance(policy, str) else getattr(policy, "__name__", repr(policy))


def make(name: Any, env: ServoEnv, seed: int = 0) -> Policy | BuiltIn | Bound:
    """Make a policy for `env`; one without ``act`` does not act at the steps of the environment.

    Args:
        name: of `POLICIES`, "learned", ``built_in:N`` with a homing method, a folder of
            `servogym train`; of several trainings ``seed_*`` in it the first is taken;
            ``FILE.py:name`` or an entry point ``servogym.policies`` of another package: a class
            ``(datasheet, seed)`` with ``reset`` and ``act``, or a function ``act(observation)``;
            or such a class or function itself.
        env: environment whose constants the policy knows.
        seed: seed of the policy's random numbers.

    Raises:
        ValueError: an unknown name, one for other tasks, a machine it cannot serve.
    """
    if not isinstance(name, str) and not callable(name):
        raise ValueError(f"policy {name!r}: give a name, {POLICIES_TOLD}")
    if not isinstance(env, ServoEnv):
        raise ValueError(
            f"env = {env!r}: give an environment, as task('LinearAxis-v0')() makes one; of "
            "gymnasium.make it is env.unwrapped"
        )
    task = env.ID
    if not isinstance(name, str):
        return policy_of(label(name), name, datasheet(env), seed)
    base, _, rest = name.partition(":")
    if base.endswith(SUFFIX):
        return policy_of(name, from_file(name), datasheet(env), seed)
    if folders := trainings(name, task):
        return Learned(Path(folders[0]), env, seed)
    if base not in POLICIES and (points := metadata.entry_points(group=ENTRY_POINTS, name=name)):
        return policy_of(name, _declared(next(iter(points))), datasheet(env), seed)
    row = POLICIES.get(base)
    if row is None or (rest and base not in BUILT_IN):
        raise ValueError(
            f"policy {name!r} is unknown for {task}: {hint(base, names(env))}; "
            f"or give {POLICIES_TOLD}"
        )
    for each in env.POLICIES:
        if each not in POLICIES:
            who = f"task {type(env).__name__}: POLICIES names {each!r}"
            raise ValueError(f"{who}: {hint(each, POLICIES)}")
    anywhere = base in ANYWHERE
    if not anywhere and base not in env.POLICIES:
        others = ", ".join(each.ID for each in (*TASKS, *ON_MODELS) if base in each.POLICIES)
        raise ValueError(
            f"policy {name!r} is for {others}: for {task} choose of {', '.join(names(env))}"
        )
    controls = row.face == PDO or "plc" in env.POLICIES  # there all of them do
    if not anywhere and env.face == PDO and not controls:
        raise ValueError(f'policy {name!r} moves set-points: make {task} with action="setpoint"')
    if not anywhere:
        for argument, value in ({"mode": MODE} | needed(name)).items():
            given = vars(env).get(argument, value)
            if given != value:
                raise ValueError(
                    f"policy {name!r} does not command {argument} = {given!r}: make {task} with "
                    f"{argument}={value!r}"
                )
    if base in BUILT_IN and env.homing_method is None:
        raise ValueError(
            f"policy {name!r}: task {type(env).__name__} lacks homing_method, that of the drive "
            "which looks for the same reference"
        )
    if row.informed:
        return row.make(env, seed)
    data = datasheet(env)
    if not rest:
        return row.make(data, seed)
    try:
        return BuiltIn(data, int(rest), fast=base == BUILT_IN[1])
    except ValueError:
        raise ValueError(f"policy {name!r}: after the colon comes a homing method 6098h") from None


def _declared(point: metadata.EntryPoint) -> Any:
    try:
        return point.load()
    except Exception as error:
        raise ValueError(
            f"policy {point.name!r}: its entry point {point.value} fails ({error_line(error)})"
        ) from error
