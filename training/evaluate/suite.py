"""A suite: tasks, drives, fixed seeds, held-out ranges and conditions, in a file with a version.

The suites of this package are in `assets/suites`; for a suite of your own, give the path of its
file.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

from ...drive.model import foreign
from ...drive.model.files import content
from ...drive.model.foreign import Key
from ...drive.model.names import hint
from ...envs.environment.registry import of_a_file, short
from ..setup import Setup
from .conditions import NOMINAL, Condition, suiting
from .episodes import LAST_SEED, fixed

SUITES = Path(str(resources.files("servogym.assets"))) / "suites"
HELD_OUT = "held_out"
MANY = LAST_SEED + 1
OF_SUBMISSION = "of_submission"  # in place of a seed
KEYS = {
    "version": Key(str, True), "drive": Key(str, True), "seed": Key((int, str), True),
    "episodes": Key(int, True), "conditions": Key(list, True), "tasks": Key(dict, True),
}
OF_A_TASK = {"drive": Key(str), "conditions": Key(list), HELD_OUT: Key(dict)}


@dataclass(frozen=True)
class Part:
    """A task of a suite."""

    setup: Setup
    rows: tuple[Condition, ...]


@dataclass(frozen=True)
class Suite:
    """A suite, as `read` returns it."""

    version: str
    seed: int | None  # of the episodes; None: each submission has its own, from its hash
    episodes: int  # in each condition
    parts: Mapping[str, Part]  # by task, without the name space
    file: str  # its name on a page
    digest: str  # of the file
    public: str = ""  # text from which the seed is drawn, known only after the last entry

    @property
    def asked(self) -> str:
        """Return the name that ``--suite`` takes."""
        return self.version if self.file == f"assets/suites/{self.version}.toml" else self.file

    def drawn(self, identity: str) -> "Suite":
        """Return the suite with the seed of a submission, if it does not have its own.

        Nobody knows this seed before the policy is finished, and anybody can derive it again. A
        change of one byte of a finished policy gives another seed, so seeds can be tried;
        `announced` draws seeds that nobody can try.

        Args:
            identity: hash of the submission, in hexadecimal digits.
        """
        return self if self.seed is not None else replace(self, seed=int(identity[:16], 16) % MANY)

    def announced(self, public: str) -> "Suite":
        """Return the suite with one seed for all entries, drawn from a public text.

        Args:
            public: a text that nobody could know before the last entry was handed in.

        Raises:
            ValueError: the suite has its own seed.
        """
        if self.seed is not None:
            raise ValueError(
                f"suite {self.version} has the seed {self.seed}: only a suite with "
                f'seed = "{OF_SUBMISSION}" draws its episodes'
            )
        identity = hashlib.sha256(f"{self.digest} {public}".encode()).hexdigest()
        return replace(self.drawn(identity), public=public)

    def only(self, tasks: Sequence[str], conditions: Sequence[str]) -> "Suite":
        """Return a part of the suite; empty lists select all. Raises ValueError for wrong names."""
        for name in tasks:
            if name not in self.parts:
                raise ValueError(
                    f"suite {self.version} has no task {name!r}: {hint(name, self.parts)}"
                )
        chosen = {name: self.parts[name] for name in tasks or self.parts}
        for name in conditions:
            known = dict.fromkeys(row.name for part in chosen.values() for row in part.rows)
            if name not in known:
                raise ValueError(
                    f"suite {self.version} has no condition {name!r}: {hint(name, known)}"
                )
        parts = {
            name: Part(
                part.setup,
                tuple(row for row in part.rows if not conditions or row.name in conditions),
            )
            for name, part in chosen.items()
        }
        parts = {name: part for name, part in parts.items() if part.rows}
        return replace(self, parts=parts)


def versions() -> list[str]:
    """Return the names of the suites in this package."""
    return sorted(path.stem for path in SUITES.glob("*.toml"))


def read(name: str, *, run_code: bool = False) -> Suite:
    """Read a suite by its version, or from the path of a file of your own.

    Raises:
        ValueError: there is no such suite, a name in it is unknown (the message suggests others),
            or a task is of another module and `run_code` is False.
    """
    path = Path(name) if name.endswith(".toml") else SUITES / f"{name}.toml"
    if not path.exists():
        raise ValueError(f"there is no suite {name!r}: {hint(name, versions())}, or give FILE.toml")
    data = content(path, "a suite")
    about = foreign.parsed(data, f"suite {path}", KEYS)
    seed = None if about["seed"] == OF_SUBMISSION else about["seed"]
    fixed(0 if seed is None else seed, about["episodes"])
    parts = {}
    for env, own in about["tasks"].items():
        where = f"suite {path}, {env}"
        if not isinstance(own, dict):
            raise ValueError(f"{where}: {own!r} is not a table")
        of_a_file(env, f"suite {path}", run_code)
        parts[short(env)] = _part(path, env, about | foreign.checked(own, where, OF_A_TASK))
    digest = hashlib.sha256(data).hexdigest()[:16]
    file = name if name.endswith(".toml") else f"assets/suites/{name}.toml"
    return Suite(about["version"], seed, about["episodes"], parts, file, digest)


def _part(path: Path, name: str, own: Mapping[str, Any]) -> Part:
    setup = Setup.of(name, own["drive"])
    known = {row.name: row for row in suiting(setup)}
    if HELD_OUT in own:
        drawn = {
            knob: tuple(value) if isinstance(value, list) else value
            for knob, value in own[HELD_OUT].items()
        }
        try:
            setup.having({"randomise": drawn}).make().close()
        except ValueError as error:
            raise ValueError(f"suite {path}, {name}, {HELD_OUT}: {error}") from None
        known[HELD_OUT] = Condition(HELD_OUT, "", drawn)
    for condition in own["conditions"]:
        if condition not in known:
            raise ValueError(
                f"suite {path}, {name}: there is no condition {condition!r}: "
                f"{hint(str(condition), known)}"
            )
    if NOMINAL not in own["conditions"]:
        raise ValueError(f"suite {path}, {name}: conditions lack {NOMINAL!r}")
    return Part(setup, tuple(known[condition] for condition in own["conditions"]))
