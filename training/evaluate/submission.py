"""An entry of a benchmark as one file: a policy with its weights, command, versions, table, hash.

The file is an ``.npz`` without pickles: `submission.json`, and under ``files/`` the bytes of what
the policy is made of: `checkpoint.json` and `weights.npz` of each training, ``seed_*`` in a folder
a task; or the Python file of a policy of one's own, which is run for nobody who does not say so.
The hash is that of suite, policy and files.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...drive.model.near import near
from ...envs.environment.registry import task
from ..learn.hyperparameters import COMMON
from ..policies import ENTRY_POINTS, LEARNED, POLICIES, trainings
from ..policies.file import SUFFIX
from ..policies.trained.saved import ABOUT
from ..policies.trained.weights import WEIGHTS, arrays
from .suite import Suite

HEAD, FILES, ENDING = "submission.json", "files/", ".npz"
LARGEST = 512 * 2**20  # bytes, unpacked
KEYS = ("name", "suite", "digest", "policy", "command", "versions", "machine", "table", "hash")
OF_WEIGHTS = re.compile(rf"[\w.-]+-v\d+/\w+/({re.escape(ABOUT)}|{re.escape(WEIGHTS)})")
BEST = "best"

# by task, condition and metric: values of the episodes, shape ``(trainings, episodes)``
Table = Mapping[str, Mapping[str, Mapping[str, list[list[float | None]]]]]


@dataclass(frozen=True)
class Submission:
    """What the file holds."""

    name: str
    suite: str  # version
    digest: str  # of the suite's file
    policy: str  # name of a baseline, ``FILE.py:name``, or the folder the weights came from
    command: str
    versions: Mapping[str, str]
    machine: str
    table: Table
    files: Mapping[str, bytes]

    @property
    def hash(self) -> str:
        """Of what plays, and on what."""
        found = hashlib.sha256(f"{self.suite} {self.digest} {self.policy}\n".encode())
        for name, data in sorted(self.files.items()):
            found.update(f"{name} {len(data)}\n".encode() + data)
        return found.hexdigest()[:32]

    @property
    def code(self) -> str:
        """The name of its Python file; empty: it brings none."""
        return next((name for name in self.files if name.endswith(SUFFIX)), "")

    def playable(self, env: str, folder: Path) -> str:
        """The policy for a task, as `policies.make` takes it; its files are written to `folder`."""
        for name, data in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        if self.code:
            return f"{folder / self.code}:{self.policy.rpartition(':')[2]}"
        return str(folder / env) if self.files else self.policy


def packed(policy: str, tasks: list[str]) -> dict[str, bytes]:
    """The files a policy is made of, by their names in a submission; none of a baseline.

    Args:
        policy: name of a baseline, "learned", ``FILE.py:name``, or a folder: of trainings
            ``seed_*`` or one training, or with such a folder for each task.
        tasks: that it plays, without the name space.

    Raises:
        ValueError: it cannot be packed into a file that others can check.
    """
    file, _, _ = policy.rpartition(":")
    if file.endswith(SUFFIX):
        return {Path(file).name: Path(file).read_bytes()}
    if policy.partition(":")[0] in POLICIES:
        return {}
    files: dict[str, bytes] = {}
    for env in tasks:
        for one in map(Path, trainings(played(policy, env), task(env).ID)):
            inner = one if (one / ABOUT).is_file() else one / BEST
            name = one.name if re.fullmatch(r"\w+", one.name) else "training"
            for part in (ABOUT, WEIGHTS):
                if not (inner / part).is_file():
                    raise ValueError(f"policy {policy!r}: {inner} has no {part}")
                files[f"{env}/{name}/{part}"] = (inner / part).read_bytes()
            _without_code(f"policy {policy!r}", files[f"{env}/{name}/{ABOUT}"])
    if not files:
        raise ValueError(
            f"policy {policy!r} of {ENTRY_POINTS} belongs to another package: give its FILE.py:name"
        )
    return files


def played(policy: str, env: str) -> str:
    """Of a folder with one for each task, that of the task."""
    own = Path(policy) / env
    return str(own) if policy not in (*POLICIES, LEARNED) and own.is_dir() else policy


def write(path: Path, submission: Submission) -> None:
    """The same bytes for the same submission."""
    head = {name: getattr(submission, name) for name in KEYS}
    text = json.dumps(head, ensure_ascii=False, sort_keys=True)
    members = {HEAD: text.encode()} | {
        FILES + name: data for name, data in sorted(submission.files.items())
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    contents: Any = {name: np.frombuffer(data, np.uint8) for name, data in members.items()}
    np.savez_compressed(path, allow_pickle=False, **contents)


def read(path: Path) -> Submission:
    """Read one; nothing is unpickled, nothing of it is run.

    Raises:
        ValueError: it is none, it was changed since, or what it brings could run code unasked.
    """
    found = {
        name: array.tobytes() if isinstance(array, np.ndarray) else bytes(array)
        for name, array in arrays(path, LARGEST).items()
    }
    try:
        head = json.loads(found.pop(HEAD))
        kept = {key: head[key] for key in KEYS}
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{path} is no submission of `servogym benchmark` ({error!r})") from None
    files = {name.removeprefix(FILES): data for name, data in found.items()}
    told = kept.pop("hash")
    submission = Submission(**kept, files=files)
    for name, data in files.items():
        if name == submission.code and re.fullmatch(r"[\w.-]+\.py", name):
            continue
        if not OF_WEIGHTS.fullmatch(name):
            raise ValueError(f"{path}: {name!r} is no file of a policy: {ABOUT} and {WEIGHTS} are")
        if name.endswith(ABOUT):
            _without_code(str(path), data)
    if told != submission.hash:
        raise ValueError(
            f"{path}: its hash is {told}, its policy and files have {submission.hash}: it was "
            "changed; make it again"
        )
    return submission


def fits(path: Path, submission: Submission, suite: Suite) -> None:
    """Refuse one of another suite, or without all conditions of a task. Raises ValueError."""
    if (submission.suite, submission.digest) != (suite.version, suite.digest):
        raise ValueError(
            f"{path} is of suite {submission.suite} ({submission.digest}), this is "
            f"{suite.version} ({suite.digest}): make it again with --suite {suite.version}"
        )
    for env, conditions in submission.table.items():
        if env not in suite.parts:
            raise ValueError(
                f"{path}: suite {suite.version} has no task {env!r}: {near(env, suite.parts)}"
            )
        names = [row.name for row in suite.parts[env].rows]
        for name in conditions:
            if name not in names:
                raise ValueError(
                    f"{path}, {env}: suite {suite.version} has no condition {name!r}: "
                    f"{near(name, names)}"
                )
        if missing := [name for name in names if name not in conditions]:
            raise ValueError(f"{path}, {env}: its table lacks {', '.join(missing)}")


def _without_code(where: str, about: bytes) -> None:
    """Refuse a checkpoint that names what is not of this package. Raises ValueError."""
    try:
        found = json.loads(about)
        algorithm, residual = found["algorithm"], found.get("residual")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{where}: {ABOUT} is not that of a training ({error!r})") from None
    if algorithm not in COMMON:
        raise ValueError(
            f"{where}: algorithm {algorithm!r} is unknown: {near(str(algorithm), COMMON)}"
        )
    if residual and residual not in POLICIES:
        raise ValueError(
            f"{where} corrects {residual!r}, which others do not have: correct a baseline of "
            f"the table, {', '.join(POLICIES)}"
        )
