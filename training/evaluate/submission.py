"""An entry of a benchmark as one file: a policy with its weights, command, versions, table, hash.

The file is an ``.npz`` without pickles: `submission.json`, and under ``files/`` the bytes of what
the policy is made of: `checkpoint.json` and `weights.npz` of each training, ``seed_*`` in a folder
for each task; or the Python file of a user's own policy, which runs only with consent. There are
two hashes: `Submission.identity` covers the policy that plays, and a suite may draw its episodes
from it; `Submission.hash` covers the whole content of the file.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ...drive.model import foreign
from ...drive.model.files import content
from ...drive.model.foreign import Key
from ...drive.model.names import hint
from ...envs.environment.registry import task
from ..policies import ENTRY_POINTS, LEARNED, POLICIES, fitted, trainings
from ..policies.file import SUFFIX
from ..policies.trained import saved
from ..policies.trained.saved import ABOUT
from ..policies.trained.weights import WEIGHTS
from ..report import PACKAGES
from .suite import Suite

HEAD, FILES, ENDING = "submission.json", "files/", ".npz"
LARGEST = 512 * 2**20  # bytes, unpacked
KEYS = {
    "name": Key(str, True), "suite": Key(str, True), "digest": Key(str, True),
    "policy": Key(str, True), "command": Key(str, True), "versions": Key(dict, True),
    "machine": Key(str, True), "table": Key(dict, True), "hash": Key(str, True),
    "fitted": Key(str),
}
NAME = r"(?a:[\w+-]([\w+. -]{0,58}[\w+-])?)"  # of an entry
WORDS = r"[^`|<>\[\]\x00-\x1f\x7f]*"  # text that a page shows, which must not contain markup
PROGRAM = r"[\w.-]+\.py"
TRAINED = re.compile(rf"([\w.-]+-v\d+)/(seed_\d+)/({re.escape(ABOUT)}|{re.escape(WEIGHTS)})")

# by task, condition and metric: values of the episodes, shape ``(trainings, episodes)``
Table = Mapping[str, Mapping[str, Mapping[str, list[list[float | None]]]]]


@dataclass(frozen=True)
class Submission:
    """The content of a submission file."""

    name: str
    suite: str  # version
    digest: str  # of the suite's file
    policy: str  # name of a baseline, ``FILE.py:name``, or the folder the weights came from
    command: str
    versions: Mapping[str, str]
    machine: str
    table: Table
    files: Mapping[str, bytes]
    fitted: str = ""  # SHA-256 of the files that its baselines read when it was made

    @cached_property
    def identity(self) -> str:
        """Return the SHA-256 of the suite and the policy alone.

        The policy counts with its weights, its program, or its name and the numbers fitted for it.
        """
        what = [("suite", f"{self.suite} {self.digest}".encode())]
        if not self.files or self.code:
            what.append(("policy", self.plays.encode()))
        if self.fitted:
            what.append(("fitted", self.fitted.encode()))
        return foreign.digest([*what, *sorted(self.files.items())])

    @property
    def hash(self) -> str:
        """Return the SHA-256 of the whole content of the file."""
        return foreign.digest([("head", _text(self)), *sorted(self.files.items())])

    @property
    def code(self) -> str:
        """Return the name of its Python file, or an empty text."""
        return next((name for name in self.files if name.endswith(SUFFIX)), "")

    @cached_property
    def checkpoints(self) -> dict[str, list[dict[str, Any]]]:
        """Return the content of the checkpoints by task, for weights only."""
        found: dict[str, list[dict[str, Any]]] = {}
        for name, data in sorted(self.files.items()):
            if name.endswith(ABOUT):
                found.setdefault(name.partition("/")[0], []).append(saved.about(data, name))
        return found

    @property
    def plays(self) -> str:
        """Describe the policy that plays, from the files alone."""
        if self.code:
            return f"{self.code}:{self.policy.rpartition(':')[2]}"
        if not self.files:
            return self.policy
        kinds = sorted({one["algorithm"] for each in self.checkpoints.values() for one in each})
        on = self.baselines
        return ", ".join(kinds) + (f" on {', '.join(on)}" if on else "")

    @property
    def baselines(self) -> list[str]:
        """Return the shipped baselines that it plays, itself or below a correction."""
        if not self.files:
            return [self.policy]
        bases = {one.get("residual") for each in self.checkpoints.values() for one in each}
        return sorted(base for base in bases if base)

    @property
    def fitted_here(self) -> str:
        """Return the SHA-256 of the files its baselines read here; empty if they read none.

        A program counts as reading all of them, because it may use any baseline.
        """
        names = POLICIES if self.code else self.baselines
        parts = [(name, found) for name in names if (found := fitted(name))]
        return foreign.digest(parts) if parts else ""

    def informed(self, env: str) -> bool:
        """Whether a task is played by an informed policy, itself or below a correction."""
        names = {one.get("residual") for one in self.checkpoints.get(env, ())}
        names |= set() if self.files else {self.policy.partition(":")[0]}
        return any(POLICIES[name].informed for name in names if name in POLICIES)

    @property
    def budget(self) -> str:
        """Return the cost of its trainings, as their checkpoints state it; empty without any."""
        stages = []
        for one in (one for each in self.checkpoints.values() for one in each):
            stage: dict[str, Any] | None = one
            while stage is not None:
                stages.append(stage)
                stage = stage.get("start")
        if not stages:
            return ""
        steps = sum(stage["steps"] for stage in stages)
        seconds = [float(stage.get("cpu_seconds", 0.0)) for stage in stages]
        took = f", {sum(seconds):.0f} CPU-s" if all(seconds) else ""
        return f"{steps:,} steps{took}"

    def playable(self, env: str, folder: Path) -> str:
        """Return the policy for a task, as `policies.make` takes it, with its files in `folder`."""
        for name, data in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        if self.code:
            return str(folder / self.plays)
        return str(folder / env) if self.files else self.policy


def _text(submission: Submission) -> bytes:
    head = {name: getattr(submission, name) for name in KEYS if name != "hash"}
    head = {name: value for name, value in head.items() if value or KEYS[name].needed}
    return json.dumps(head, ensure_ascii=False, sort_keys=True).encode()


def packed(policy: str, tasks: Mapping[str, str]) -> dict[str, bytes]:
    """Return the files of a policy by their names in a submission; a baseline has none.

    Args:
        policy: name of a baseline, "learned", ``FILE.py:name``, or a folder: of trainings
            ``seed_*`` or one training, or with such a folder for each task.
        tasks: ids of those it plays, by their names in the suite.

    Raises:
        ValueError: it cannot be packed into a file that others can check.
    """
    file, _, _ = policy.rpartition(":")
    if file.endswith(SUFFIX):
        return {Path(file).name: content(Path(file), "a policy")}
    if policy.partition(":")[0] in POLICIES:
        return {}
    files: dict[str, bytes] = {}
    for env, identity in tasks.items():
        for one in map(Path, trainings(of_task(policy, env), identity)):
            inner = saved.folder(one)
            about = saved.read(inner)
            place = f"{env}/seed_{about.get('seed', 0)}"
            if f"{place}/{ABOUT}" in files:
                raise ValueError(
                    f"policy {policy!r}: {one} has the seed {about.get('seed', 0)} like another "
                    "training: each needs a seed of its own"
                )
            for part in (ABOUT, WEIGHTS):
                if not (inner / part).is_file():
                    raise ValueError(f"policy {policy!r}: {inner} has no {part}")
                files[f"{place}/{part}"] = content(inner / part, "a part of a submission", LARGEST)
    if not files:
        raise ValueError(
            f"policy {policy!r} of {ENTRY_POINTS} belongs to another package: give its FILE.py:name"
        )
    return files


def of_task(policy: str, env: str) -> str:
    """Return the policy for a task from a folder with one for each task."""
    own = Path(policy) / env
    return str(own) if policy not in (*POLICIES, LEARNED) and own.is_dir() else policy


def write(path: Path, submission: Submission) -> None:
    """Write a submission; equal submissions give equal bytes."""
    head = json.loads(_text(submission)) | {"hash": submission.hash}
    text = json.dumps(head, ensure_ascii=False, sort_keys=True)
    members = {HEAD: text.encode()} | {
        FILES + name: data for name, data in sorted(submission.files.items())
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    contents: Any = {name: np.frombuffer(data, np.uint8) for name, data in members.items()}
    np.savez_compressed(path, allow_pickle=False, **contents)


def read(path: Path) -> Submission:
    """Read a submission; nothing is unpickled and none of its code is run.

    Raises:
        ValueError: it is not a submission, it was changed, or it could run code without consent.
    """
    found = {name: array.tobytes() for name, array in foreign.arrays(path, LARGEST).items()}
    if HEAD not in found:
        raise ValueError(f"{path} is not a submission of `servogym benchmark`: it lacks {HEAD}")
    head = foreign.parsed(
        found.pop(HEAD), f"{path} is not a submission of `servogym benchmark`", KEYS
    )
    files = {name.removeprefix(FILES): data for name, data in found.items()}
    stated = head.pop("hash")
    submission = Submission(**head, files=files)
    sound(path, submission)
    if stated != submission.hash:
        raise ValueError(
            f"{path}: its hash is {stated}, but its content has {submission.hash}: it was changed; "
            "make it again"
        )
    return submission


def sound(path: Path, submission: Submission) -> None:
    """Raise ValueError if the files of an entry, or the texts that a page shows, are refused."""
    _files(path, submission)
    _words(path, submission)


def _words(path: Path, submission: Submission) -> None:
    """Refuse names and texts that a page would show as markup."""
    shown = {"name": NAME, "command": "servogym benchmark learned " + WORDS, "machine": WORDS}
    for key, pattern in shown.items():
        text = getattr(submission, key)
        if not re.fullmatch(pattern, text) or not text.isprintable():
            raise ValueError(f"{path}: {key} = {text!r:.80} is none that a page could show")
    for package in ("python", *PACKAGES):
        if not re.fullmatch(r"[\w.+-]+", str(submission.versions.get(package, ""))):
            raise ValueError(f"{path}: versions lack {package}, or say no version of it")
    plain = not submission.files and submission.policy.partition(":")[0]
    name = submission.name.casefold()
    if name in (*POLICIES, LEARNED) and submission.name not in (plain, LEARNED):
        raise ValueError(
            f"{path}: an entry {submission.name!r} has to be the policy of that name, this one "
            f"plays {submission.policy!r}: give it another name"
        )


def _files(path: Path, submission: Submission) -> None:
    """Refuse anything but a baseline, one program, or complete and different trainings."""
    if not submission.files:
        if submission.policy.partition(":")[0] not in POLICIES:
            raise ValueError(
                f"{path} brings no files, and {submission.policy!r} is not a baseline: "
                f"{hint(submission.policy, POLICIES)}"
            )
        return
    if submission.code:
        if len(submission.files) > 1 or not re.fullmatch(PROGRAM, submission.code):
            names = ", ".join(map(repr, submission.files))
            raise ValueError(f"{path} brings {names}: a program is one file, NAME.py")
        if not submission.plays.rpartition(":")[2].isidentifier():
            raise ValueError(f"{path}: {submission.policy!r} names nothing in {submission.code}")
        return
    for name in submission.files:
        if not TRAINED.fullmatch(name):
            raise ValueError(
                f"{path}: {name!r} is not a file of a policy: {ABOUT} and {WEIGHTS} are"
            )
        for part in (ABOUT, WEIGHTS):
            if str(PurePosixPath(name).parent / part) not in submission.files:
                raise ValueError(f"{path}: {name!r} is there without its {part}")
    for env, given in submission.checkpoints.items():
        places = sorted({n.rpartition("/")[0] for n in submission.files if n.startswith(f"{env}/")})
        for place, about in zip(places, given, strict=True):
            _training(f"{path}, {place}", env, place, about, submission.files)


def _training(
    where: str, env: str, place: str, about: Mapping[str, Any], files: Mapping[str, bytes]
) -> None:
    if about["env_id"] != task(env).ID:
        raise ValueError(f"{where} was trained for {about['env_id']}, not for {env}")
    if (stated := about.get("sha256")) is not None:
        foreign.intact(f"{where}/{WEIGHTS}", files[f"{place}/{WEIGHTS}"], stated)
    seed = about.get("seed")
    if place != f"{env}/seed_{seed}":
        raise ValueError(f"{where} states the seed {seed}, its folder another one")
    base = about.get("residual")
    if base is not None and base not in POLICIES:
        raise ValueError(
            f"{where} corrects {base!r} of another package, whose program no hash covers: enter "
            "what plays as one FILE.py:name"
        )
    if base and not np.any(np.float32(about["bounds"])):
        raise ValueError(
            f"{where} corrects {base!r} by nothing (bounds {about['bounds']}): enter "
            "that policy by its name"
        )


def fits(path: Path, submission: Submission, suite: Suite) -> None:
    """Raise ValueError for another suite, or if a condition of a task is missing."""
    if (submission.suite, submission.digest) != (suite.version, suite.digest):
        raise ValueError(
            f"{path} is of suite {submission.suite} ({submission.digest}), this is "
            f"{suite.version} ({suite.digest}): make it again with --suite {suite.asked}"
        )
    if not submission.table:
        raise ValueError(f"{path}: its table is empty")
    for env, conditions in submission.table.items():
        if env not in suite.parts:
            raise ValueError(
                f"{path}: suite {suite.version} has no task {env!r}: {hint(env, suite.parts)}"
            )
        if submission.checkpoints and env not in submission.checkpoints:
            raise ValueError(f"{path}: its table has {env}, for which it brings no training")
        names = [row.name for row in suite.parts[env].rows]
        if not isinstance(conditions, dict):
            raise ValueError(f"{path}, {env}: its table is not a table")
        for name in conditions:
            if name not in names:
                raise ValueError(
                    f"{path}, {env}: suite {suite.version} has no condition {name!r}: "
                    f"{hint(name, names)}"
                )
        if missing := [name for name in names if name not in conditions]:
            raise ValueError(f"{path}, {env}: its table lacks {', '.join(missing)}")
