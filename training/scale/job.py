"""A job: a function of a module with its arguments; its result is plain data.

Every executor sends and keeps results as the bytes of an ``.npz`` without pickles, so that a result
is the same whether it was read from disk, made on another node or made here.
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

Result = dict[str, Any]  # by name: an array, or a value that JSON can represent
LARGEST = 2**32  # bytes of a result, unpacked
REST = "_rest"  # name in the archive for all values that are not arrays
PACKAGES = ("mujoco", "numpy", "numba", "gymnasium", "ruckig")  # that affect a result
SOURCES = ("servogym.drive", "servogym.envs", "servogym.training", "servogym.assets")
LEARNED = "policies"  # folder in the assets; a job watches the policies that it plays


class Job(NamedTuple):
    """One of many jobs.

    Args:
        name: shown in progress and errors.
        function: function of a module; returns arrays and JSON values by name.
        arguments: arguments of the function.
        watched: files and folders whose contents affect the result.
    """

    name: str
    function: Callable[..., Result]
    arguments: Mapping[str, Any]
    watched: tuple[str, ...] = ()

    def __call__(self) -> Result:
        """Do the job in this process."""
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
        """Encode the job for another process. Raises ValueError with its name if that fails."""
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
    """Decode a result. Raises ValueError for other data."""
    arrays = foreign.arrays(data, LARGEST, "the result of a job")
    if REST not in arrays:
        raise ValueError("this archive is not a result of a job")
    return arrays | foreign.parsed(arrays.pop(REST).tobytes(), "the result of a job")


class Done(NamedTuple):
    """The answer of a worker: the bytes of a result, or an error."""

    data: bytes = b""
    error: BaseException | None = None
    refused: str = ""  # the stamp of a worker of another version


def do(expected: str, threads: int, payload: bytes) -> Done:
    """Do a job in a worker if its version is the `expected` one, with a number of threads."""
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
    """The built-in type for an error of a worker; other types may not pass through a pipe."""
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
    """Versions and a digest of servogym's own sources: equal stamps mean equal results."""
    found = hashlib.sha256()
    for package in SOURCES:
        for path in sorted(Path(str(files(package))).iterdir()):
            if path.name != LEARNED or package != SOURCES[-1]:
                _read(found, path)
    own = f"servogym {version('servogym')} (sources {found.hexdigest()[:8]})"
    others = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return f"{own}, Python {platform.python_version()}, {others}"


def _read(found: Any, path: Path) -> None:
    """Add the name and content of a file, or of all files in a folder."""
    if path.is_dir():
        if path.name != "__pycache__":
            for inner in sorted(path.iterdir()):
                _read(found, inner)
    elif path.is_file() and path.suffix != ".pyc":
        data = path.read_bytes()
        found.update(f"{path.name} {len(data)}\n".encode() + data)
