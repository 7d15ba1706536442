"""A block is optimised with the entry that reaches it, and is machine code nowhere else.

What is left out of the compiling changes neither what compiled code does nor Numba itself.
"""

import gc
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import postproc

from servogym.drive.kernel import code_cache, jit
from servogym.drive.kernel.compiler import Library

pytestmark = pytest.mark.skipif(jit.DISABLED, reason="nothing is compiled")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(code_cache, "cache_directory", lambda: tmp_path)


def make():
    """An entry over two blocks, one below the other, that use what Numba brings with it."""

    @jit.block
    def root(x):
        return math.gcd(int(max(x, 2.0)), 6) + math.sqrt(x)

    @jit.block
    def twice(x):
        return root(x) + root(x + 1.0)

    @jit.entry
    def run(x):
        return twice(x)

    return root, twice, run


def library(function):
    """What the one signature of a function was compiled to."""
    (compiled,) = function.overloads.values()
    return compiled._asdict()["library"]


def expected(x):
    return sum(math.gcd(int(max(v, 2.0)), 6) + math.sqrt(v) for v in (x, x + 1.0))


def test_only_the_entry_becomes_machine_code():
    root, twice, run = make()
    assert run(4.0) == expected(4.0)
    assert library(run)._finalized
    for block in (root, twice):
        assert isinstance(library(block), Library)
        assert not library(block)._finalized


def test_what_is_deep_below_is_optimised_once(monkeypatch):
    optimised = []
    original = Library._optimize_final_module

    def count(self):
        optimised.append(self.name)
        original(self)

    monkeypatch.setattr(Library, "_optimize_final_module", count)
    *_, run = make()
    run(4.0)
    assert [name.rpartition(".")[2] for name in optimised] == ["run"]


def test_a_function_of_another_kind_may_call_a_block_of_an_entry():
    root, twice, run = make()
    run(4.0)

    @numba.njit
    def foreign(x):
        return twice(x) + root(x)

    assert foreign(4.0) == run(4.0) + root(4.0)
    assert run(9.0) == expected(9.0)


def test_two_entries_share_a_block():
    _, twice, run = make()

    @jit.entry
    def second(x):
        return twice(x) - 1.0

    assert second(4.0) == run(4.0) - 1.0 == expected(4.0) - 1.0
    assert not library(twice)._finalized


def test_what_others_compile_is_linked_as_numba_does():
    *_, run = make()
    run(4.0)

    @numba.njit
    def foreign(x):
        return x + 1.0

    foreign(1.0)
    assert not isinstance(library(foreign), Library)


def numba_as_it_is(function):
    """What is another while an entry is compiled."""
    codegen, record, functions = function.targetctx.codegen(), numba.types.Record, numba.types
    return (
        codegen._library_class, record.__repr__, functions.BaseFunction.get_call_type,
        postproc.PostProcessor.run, gc.isenabled(),
    )


def test_a_compile_leaves_numba_as_it_was_also_when_it_fails():
    *_, run = make()
    before = numba_as_it_is(run)
    with pytest.raises(numba.TypingError):
        run("text")
    assert numba_as_it_is(run) == before
    assert run(4.0) == expected(4.0)
    assert numba_as_it_is(run) == before


def test_who_collects_no_garbage_is_not_made_to():
    gc.disable()
    try:
        assert make()[-1](4.0) == expected(4.0)
        assert not gc.isenabled()
    finally:
        gc.enable()


def compiled_as_numba_does(function):
    """The same function with all of Numba's passes."""
    return numba.njit(error_model="numpy")(function)


def closures(x, n):
    def power(k):
        return x**k

    return sum([power(k) for k in range(n)])


def whole_arrays(x, n):
    values = np.arange(n) * x + 1.0
    return (np.sqrt(values) / np.array([x, 2.0, 3.0, 4.0])).sum()


def words_as_keys(x, n):
    total = 0.0
    for row in np.zeros(n, PAIR):
        row.a, row.b = 2.5, n
        total += row["a"] * x + row["b"]
    return total


def tuples_and_powers(x, n):
    pair = (n, x)
    return pair[1] ** 2 + x**3 + pair[0] if isinstance(n, int) else 0.0


PAIR = np.dtype([("a", "f8"), ("b", "i4")])


@pytest.mark.parametrize("function", [closures, whole_arrays, words_as_keys, tuples_and_powers])
def test_what_blocks_do_not_do_works_as_with_all_passes(function):
    assert jit.entry(function)(1.7, 4) == compiled_as_numba_does(function)(1.7, 4)


def test_a_block_called_from_python_is_kept_like_an_entry(tmp_path):
    root, twice, _ = make()
    assert twice(4.0) == expected(4.0)
    again = make()[1]
    assert again(4.0) == expected(4.0)
    assert sum(again._alone.stats.cache_misses.values()) == 0
    assert not library(root)._finalized


PLAIN = """
import math, sys
BEFORE
from servogym.drive.kernel import jit

@jit.block
def root(x):
    return math.gcd(int(max(x, 2.0)), 6) + math.sqrt(x)

@jit.entry
def run(x):
    return root(x) + root(x + 1.0)

fenced = [
    f"servogym.drive.kernel.{name}" in sys.modules for name in ("dispatchers", "compiler", "reach")
]
print(jit.PLAIN, any(fenced), all(fenced), repr(run(4.0)))
"""
OTHER = "import numba; numba.__version__ = '0.99.1'"
GONE = "import numba.core.registry as place; del place.CPUDispatcher"


@pytest.mark.parametrize(
    ("setting", "before", "fenced"),
    [
        ("", "", (False, True, True)),
        ("1", "", (True, False, False)),  # asked for
        ("", OTHER, (True, False, False)),  # a release that was not tested
        ("", GONE, (True, False, False)),  # one that is not as it was released
    ],
)
def test_without_the_inner_names_of_numba_the_same_is_computed(tmp_path, setting, before, fenced):
    file = tmp_path / "plain.py"
    file.write_text(PLAIN.replace("BEFORE", before))
    places = {"SERVOGYM_PLAIN_NUMBA": setting, "SERVOGYM_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, file], env=os.environ | places, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [*map(str, fenced), repr(expected(4.0))]
    # nobody waits for minutes without a word, not even in a pipe
    assert ("compiled anew at each start" in done.stderr) is fenced[0]


def test_inner_names_of_numba_are_used_behind_the_fence_alone():
    """Those of numba-cuda stand in `envs.engine.gpu`."""
    root = Path(jit.__file__).parents[2]
    inner = re.compile(r"^\s*(?:from|import) numba\.(?:core|np|parfors|misc)\b", re.M)
    rooms = (root / name for name in ("drive", "envs", "training"))
    found = {p.name for room in rooms for p in room.rglob("*.py") if inner.search(p.read_text())}
    assert found == {"compiler.py", "dispatchers.py", "reach.py"}


MACHINE = """
import hashlib
import gymnasium
from servogym.drive.kernel import jit
env = gymnasium.make("servogym.envs:servogym/LinearAxis-v0")
seen, _ = env.reset(seed=1)
digest = hashlib.sha256(seen.tobytes())
env.action_space.seed(1)
for _ in range(50):
    seen, reward, *_ = env.step(env.action_space.sample())
    digest.update(seen.tobytes() + repr(float(reward)).encode())
print(jit.PLAIN, digest.hexdigest())
"""


@pytest.mark.slow
def test_a_machine_compiled_by_plain_numba_does_the_same_to_the_bit():
    answers = []
    for setting in ("", "1"):
        done = subprocess.run(
            [sys.executable, "-c", MACHINE], env=os.environ | {"SERVOGYM_PLAIN_NUMBA": setting},
            capture_output=True, text=True, check=True,
        )
        answers.append(done.stdout.split())
    assert [plain for plain, _ in answers] == ["False", "True"]
    assert answers[0][1] == answers[1][1]
