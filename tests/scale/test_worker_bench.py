"""The bench of workers: three runs in turns, whose files have to be the same."""

import pytest

from servogym.training.bench import workers


def played(monkeypatch, differs=False):
    """Runs that take 8 s on one thread, 6 s alone and 4 s by workers, and what each was told."""
    calls = []

    def seconds(env, policies, drive, out, more=(), **variables):
        calls.append((out.name, *more, *variables))
        out.mkdir(exist_ok=True)
        (out / "compare.json").write_text(out.name if differs else "same")
        return 4.0 if more else 8.0 if variables else 6.0

    monkeypatch.setattr(workers, "_seconds", seconds)
    return calls


def test_each_round_runs_all_three(monkeypatch):
    calls = played(monkeypatch)
    row = workers.measure("LinearAxis-v0", "hold", "generic", 2, 2)
    once = [("serial", "SERVOGYM_THREADS"), ("alone",), ("shared", "--workers", "2")]
    assert calls == [("alone",), *once, *once]
    assert (row["ratio_to_one_thread"], row["ratio"]) == (2.0, 1.5)


def test_files_that_differ_are_no_result(monkeypatch):
    played(monkeypatch, differs=True)
    with pytest.raises(RuntimeError, match="LinearAxis-v0: the files of 2 workers are not"):
        workers.measure("LinearAxis-v0", "hold", "generic", 2, 1)


def test_a_run_that_fails_says_why(tmp_path):
    with pytest.raises(RuntimeError, match=r"compare Nothing-v0 .*unknown"):
        workers._seconds("Nothing-v0", "hold", "generic", tmp_path)
