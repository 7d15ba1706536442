"""Linking: a block is optimised with the entry that reaches it; it is machine code nowhere else."""

import math

import numba
import pytest

from servogym.drive.kernel import jit, link

pytestmark = pytest.mark.skipif(jit.DISABLED, reason="nothing is compiled")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path)


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
        assert isinstance(library(block), link.Library)
        assert not library(block)._finalized


def test_what_is_deep_below_is_optimised_once(monkeypatch):
    optimised = []
    original = link.Library._optimize_final_module

    def count(self):
        optimised.append(self.name)
        original(self)

    monkeypatch.setattr(link.Library, "_optimize_final_module", count)
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
    assert not isinstance(library(foreign), link.Library)


def test_a_compile_that_fails_leaves_numba_as_it_was():
    *_, run = make()
    codegen = run.targetctx.codegen()
    before = codegen._library_class
    with pytest.raises(numba.TypingError):
        run("text")
    assert codegen._library_class is before
    assert run(4.0) == expected(4.0)


def test_a_block_called_from_python_is_kept_like_an_entry(tmp_path):
    root, twice, _ = make()
    assert twice(4.0) == expected(4.0)
    again = make()[1]
    assert again(4.0) == expected(4.0)
    assert sum(again._alone.stats.cache_misses.values()) == 0
    assert not library(root)._finalized
