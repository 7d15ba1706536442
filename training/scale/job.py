"""A job: a function of a module and what it is called with; its result is plain data.

Results travel and are kept as the bytes of an ``.npz`` without pickles, in every executor, so that
one that was read from disk, one of another node and one that was made here are the same.
"""

import hashlib
import io
import json
import os
import pickle
import platform
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...drive.model import foreign
from ...envs.engine.checks import THREADS

Result = dict[str, Any]  # by name: an array, or what JSON has
LARGEST = 2**32  # bytes of a result, unpacked
REST = "_rest"  # of the archive: what is not an array
PACKAGES = ("mujoco", "numpy", "numba", "gymnasium", "ruckig")  # that decide a result
SOURCES = ("servogym.drive", "servogym.envs", "servogym.training", "servogym.assets")
LEARNED = "policies"  # in the assets; a job watches those it plays


class Job(NamedTuple):
    """One of many.

    Args:
        name: told in progress and errors.
        function: of a module; its result has arrays and what JSON has, by name.
        arguments: of the function.
        watched: files and folders whose contents the result depends on.
    """

    name: str
    function: Callable[..., Result]
    arguments: Mapping[str, Any]
    watched: tuple[str, ...] = ()

    def __call__(self) -> Result:
        """Do it here."""
        return self.function(**self.arguments)

    @property
    def place(self) -> str:
        """Place of the function: ``module:name``."""
        return f"{self.function.__module__}:{self.function.__qualname__}"

    def digest(self) -> str:
        """Return a digest of everything that determines the result."""
        arguments = sorted(self.arguments.items())
        found = hashlib.sha256(repr((stamp(), self.name, self.place, arguments)).encode())
        for path in map(Path, self.watched):
            _read(found, path)
        return found.hexdigest()[:32]

    def sent(self) -> bytes:
        """For another process. Raises ValueError naming the job where that is not possible."""
        try:
            return pickle.dumps(tuple(self))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ValueError(
                f"{self.name} cannot be sent to a worker ({error}): define the policy at the top "
                "of a module, or give FILE.py:name"
            ) from None


def encoded(result: Result) -> bytes:
    """Encode a result for transfer and storage."""
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    rest = {name: value for name, value in result.items() if name not in arrays}
    text = np.frombuffer(json.dumps(rest).encode(), np.uint8)
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays, **{REST: text})
    return file.getvalue()


def decoded(data: bytes) -> Result:
    """What was encoded. Raises ValueError where it is something else."""
    arrays = foreign.arrays(data, LARGEST, "the result of a job")
    if REST not in arrays:
        raise ValueError("this archive is not a result of a job")
    return arrays | foreign.parsed(arrays.pop(REST).tobytes(), "the result of a job")


class Done(NamedTuple):
    """What a worker answers: the bytes of a result, or what went wrong."""

    data: bytes = b""
    error: BaseException | None = None
    refused: str = ""  # the worker's stamp where it is another one


def do(expected: str, threads: int, payload: bytes) -> Done:
    """Do a job in a worker: of the version that sent it, with so many threads."""
    if stamp() != expected:
        return Done(refused=stamp())
    os.environ[THREADS] = str(threads)
    name = "a job"
    try:
        job = Job(*pickle.loads(payload))
        name = job.name
        return Done(encoded(job()))
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        return Done(error=type_of(error)(str(error)))
    except Exception as error:
        return Done(error=RuntimeError(f"{name}: {type(error).__name__}: {error}"))


def type_of(error: Exception) -> type[Exception]:
    """The plain type a worker's error is told as; others may not come through a pipe."""
    kinds = (ValueError, OSError, ImportError, RuntimeError)
    return next(kind for kind in kinds if isinstance(error, kind))


def result(done: Done, where: str) -> bytes:
    """Decode the result from an answer.

    Raises:
        RuntimeError: the worker has another version.
        Exception: what the job raised.
    """
    if done.refused:
        raise RuntimeError(
            f"{where} has {done.refused}, this is {stamp()}: install the same version there"
        )
    if done.error is not None:
        raise done.error
    return done.data


@cache
def stamp() -> str:
    """Versions, and the digest of servogym's own sources: equal where results are equal."""
    found = hashlib.sha256()
    for package in SOURCES:
        for path in sorted(Path(str(files(package))).iterdir()):
            if path.name != LEARNED or package != SOURCES[-1]:
                _read(found, path)
    own = f"servogym {version('servogym')} (sources {found.hexdigest()[:8]})"
    others = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return f"{own}, Python {platform.python_version()}, {others}"


def _read(found: Any, path: Path) -> None:
    """Add names and contents, of a folder those of all files in it."""
    if path.is_dir():
        if path.name != "__pycache__":
            for inner in sorted(path.iterdir()):
                _read(found, inner)
    elif path.is_file() and path.suffix != ".pyc":
        data = path.read_bytes()
        found.update(f"{path.name} {len(data)}\n".encode() + data)
