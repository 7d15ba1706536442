"""pytest fixtures that serve a machine to a master under test and show its true state.

Add ``pytest_plugins = ["servogym.testing"]`` to your ``conftest.py``.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from .envs.serve.laboratory import Laboratory

__all__ = ["laboratory"]


@pytest.fixture
def laboratory() -> Iterator[Callable[[str | Path | Mapping[str, Any]], Laboratory]]:
    """Return a function that serves a machine file, or a mapping of the same form, for one test.

    >>> def test_my_master_survives_an_over_voltage(laboratory):
    ...     machine = laboratory("machine.toml")
    ...     master = MyMaster(...)
    ...     master.enable()
    ...     machine.inject("feeder.x", "overvoltage")
    ...     machine.wait_until(lambda: machine.state("feeder.x") == "FAULT")

    An error that ended the thread of a bus is raised when the test is over.
    """
    opened: list[Laboratory] = []

    def serve(source: str | Path | Mapping[str, Any], seed: int = 0) -> Laboratory:
        opened.append(Laboratory(source, seed))
        return opened[-1].start()

    yield serve
    for each in opened:
        each.stop()
