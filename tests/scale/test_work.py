"""Jobs in, results in their order: whoever does them, whatever dies meanwhile."""

import errno
import io
import subprocess
import sys
from pathlib import Path

import deeds
import numpy as np
import pytest
from rich.console import Console

from servogym.envs.engine.checks import cores
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training import cli
from servogym.training.evaluate.comparison import BackgroundSummary, Comparison, Request, evaluate
from servogym.training.scale import job as jobs
from servogym.training.scale import processes
from servogym.training.scale.job import Job, encoded
from servogym.training.scale.work import ALONE, Work
from servogym.training.setup import Setup

TWO = Work(workers=2)


def listed(function, n=4, **arguments):
    return [Job(f"job {x}", function, {"x": x, **arguments}) for x in range(n)]


def calls(folder):
    return [int(line) for line in (folder / "calls").read_text().split()]


def test_results_come_in_the_order_of_the_jobs_with_the_same_bytes():
    slow_first = [
        Job(f"{x}", deeds.square, {"x": x, "delay": 0.2 if x == 0 else 0.0}) for x in range(5)
    ]
    alone, two = ALONE.map(slow_first), TWO.map(slow_first)
    assert [result["name"] for result in two] == ["0", "1", "2", "3", "4"]
    assert [encoded(result) for result in alone] == [encoded(result) for result in two]
    assert alone[3]["square"].tolist() == [9.0, 3 * np.pi]


def test_a_worker_that_is_killed_loses_nothing(tmp_path):
    found = TWO.map(listed(deeds.killed, folder=str(tmp_path)))
    assert [result["x"] for result in found] == [0, 1, 2, 3]
    assert sorted(path.name for path in tmp_path.glob("once*")) == ["once1", "once3"]


def test_a_job_that_kills_each_of_its_workers_is_named(tmp_path):
    with pytest.raises(RuntimeError, match=r"job 0: 3 worker processes died over it.*SIGKILL"):
        TWO.map(listed(deeds.killed, 1, folder=str(tmp_path), always=True))


def test_what_cannot_be_sent_to_a_worker_is_named_before_anything_starts():
    with pytest.raises(ValueError, match=r"own on Moon cannot be sent to a worker .*lambda"):
        TWO.map([Job("own on Moon", deeds.square, {"x": lambda observation: observation})])


def test_a_worker_of_another_version_is_refused_with_both_named(monkeypatch):
    own = jobs.stamp()
    for module in (jobs, processes):
        monkeypatch.setattr(module, "stamp", lambda: "servogym 9.9")
    with pytest.raises(RuntimeError) as told:
        TWO.map(listed(deeds.square, 1))
    assert f"a worker process has {own}, this is servogym 9.9" in str(told.value)


def test_the_threads_of_a_worker_are_what_it_was_granted(monkeypatch):
    (one,) = Work(workers=1).map([Job("", deeds.threads, {})])
    assert one["threads"] == cores()
    found = Work(workers=cores()).map([Job(f"{i}", deeds.threads, {}) for i in range(cores())])
    assert {result["threads"] for result in found} == {1}
    monkeypatch.setenv("SERVOGYM_THREADS", "3")
    assert len(ServoVectorEnv(LinearAxisEnv, 4)._parts) == 3


@pytest.mark.parametrize("work", [ALONE, TWO], ids=["alone", "two"])
def test_after_an_error_only_what_is_missing_is_done(work, tmp_path):
    todo = listed(deeds.counted, 6, folder=str(tmp_path), fails=(5,))
    out, told = tmp_path / "out", io.StringIO()
    with pytest.raises(ValueError, match=r"^x = 5 is out of range$"):
        work.map(todo, folder=out, console=Console(file=told))
    assert "of 6 jobs are kept" in told.getvalue()
    assert "--resume" in told.getvalue()
    first = calls(tmp_path)
    done = len([*out.glob("jobs/*.npz")])
    again = Work(work.workers, resume=True)
    with pytest.raises(ValueError, match="x = 5"):
        again.map(todo, folder=out)
    assert len(calls(tmp_path)) - len(first) <= 6 - done
    (tmp_path / "calls").unlink()
    assert work.map(todo[:5], folder=out)[4] == {"x": 4}
    assert sorted(calls(tmp_path)) == [0, 1, 2, 3, 4], "without --resume all is done anew"
    work.clear(todo, out)
    assert not (out / "jobs").exists()


def test_ctrl_c_keeps_what_was_done(tmp_path):
    todo = listed(deeds.interrupted, folder=str(tmp_path))
    with pytest.raises(KeyboardInterrupt):
        ALONE.map(todo, folder=tmp_path)
    assert calls(tmp_path) == [0, 1]
    found = Work(resume=True).map(todo, folder=tmp_path)
    assert [result["x"] for result in found] == [0, 1, 2, 3]
    assert calls(tmp_path) == [0, 1, 2, 3]


def test_a_damaged_result_is_made_anew(tmp_path):
    todo = listed(deeds.counted, 2, folder=str(tmp_path))
    ALONE.map(todo, folder=tmp_path)
    next((tmp_path / "jobs").glob("*.npz")).write_bytes(b"PK\x03\x04 half of it")
    assert Work(resume=True).map(todo, folder=tmp_path) == [{"x": 0}, {"x": 1}]
    assert len(calls(tmp_path)) == 3


def test_a_full_disk_is_one_line_and_what_was_written_stays(tmp_path, monkeypatch):
    todo = listed(deeds.counted, folder=str(tmp_path))
    write = Path.write_bytes

    def full(path, data):
        if len([*path.parent.glob("*.npz")]) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"npz cannot be written: No space left on device"):
        ALONE.map(todo, folder=tmp_path)
    monkeypatch.undo()
    assert Work(resume=True).map(todo, folder=tmp_path)[3] == {"x": 3}
    assert calls(tmp_path) == [0, 1, 2, 2, 3]


def test_the_same_command_beside_this_one_may_clear_the_folder_meanwhile(tmp_path, monkeypatch):
    todo, write, cleared = listed(deeds.counted, folder=str(tmp_path)), Path.write_bytes, []

    def clearing(path, data):
        write(path, data)
        if len(cleared) < 2:
            cleared.append(path)
            ALONE.clear(todo, tmp_path)
        return len(data)

    monkeypatch.setattr(Path, "write_bytes", clearing)
    with pytest.raises(OSError, match="No such file"):
        ALONE.map(todo[:1], folder=tmp_path)
    cleared[1:] = []
    assert ALONE.map(todo, folder=tmp_path)[3] == {"x": 3}


def test_a_changed_file_of_a_policy_is_another_job(tmp_path):
    file = tmp_path / "own.py"
    file.write_text("a = 1")
    job = Job("", deeds.square, {"x": 1}, (str(file),))
    before = job.digest()
    assert job.digest() == before
    file.write_text("a = 2")
    assert job.digest() != before


def test_more_workers_than_cores_is_told():
    told = io.StringIO()
    Work(cores() + 1).map(listed(deeds.square, 1), console=Console(file=told))
    assert f"{cores() + 1} workers on {cores()} cores take turns" in told.getvalue()


def test_progress_counts_jobs_and_estimates_the_rest():
    told = io.StringIO()
    ALONE.map(listed(deeds.square, 3), console=Console(file=told, force_terminal=True, width=80))
    assert "3/3" in told.getvalue()
    assert "0:00:0" in told.getvalue()


def test_parts_of_the_episodes_by_two_processes_are_the_episodes():
    """Of several policies, of the user's own too, in environments of their own."""
    arguments = ("LinearAxis-v0", ["ruckig", "pd", Still], "generic", 11, 0)
    alone, two = evaluate(*arguments, traced=10), evaluate(*arguments, traced=10, work=TWO)
    assert [result.policy for result in two] == ["ruckig", "pd", "Still"]
    for one, other in zip(alone, two, strict=True):
        assert one.seeds == other.seeds
        assert one.faults == other.faults
        for name, values in one.values.items():
            assert values.tobytes() == other.values[name].tobytes(), name
        assert one.trace.samples.tobytes() == other.trace.samples.tobytes()
    with pytest.raises(ValueError, match=r"<lambda> on LinearAxis-v0.*FILE\.py:name"):
        evaluate("LinearAxis-v0", [lambda observation: [0.0]], "generic", 1, 0, work=TWO)


class Still:
    def __init__(self, datasheet, seed):
        self.action = np.zeros(1, np.float32)

    def reset(self, observation, info):
        pass

    def act(self, observation):
        return self.action


@pytest.mark.slow
@pytest.mark.parametrize("command", [
    "compare LinearAxis-v0 --policies hold,ruckig,pd --episodes 12",
    "eval LinearAxis-v0 --policy random --episodes 3",
    "compare LinearAxis-v0 --policies hold,ruckig --episodes 3 --conditions delay",
    "benchmark homing --quick",
    "benchmark positioning --quick",
])
def test_the_files_of_two_workers_are_those_of_none(command, tmp_path):
    for folder, more in (("alone", []), ("two", ["--workers", "2"])):
        assert cli.main([*command.split(), "--out", str(tmp_path / folder), *more]) == 0
    names = sorted(path.name for path in (tmp_path / "alone").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "two").iterdir())
    for name in names:
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.parametrize("work", [ALONE, TWO], ids=["alone", "two"])
def test_each_result_is_told_once_as_it_comes_and_what_was_kept_too(work, tmp_path):
    todo, told = listed(deeds.counted, folder=str(tmp_path)), {}

    def then(k, result):
        assert k not in told
        told[k] = result["x"]

    ALONE.map(todo[:2], folder=tmp_path)
    again = Work(work.workers, resume=True)
    again.map(todo, folder=tmp_path, then=then)
    assert told == {0: 0, 1: 1, 2: 2, 3: 3}
    assert sorted(calls(tmp_path)) == [0, 1, 2, 3]


@pytest.mark.parametrize("work", [ALONE, TWO], ids=["alone", "two"])
def test_what_fails_when_it_is_told_of_a_result_ends_the_command_and_loses_none(work, tmp_path):
    todo = listed(deeds.counted, folder=str(tmp_path))

    def then(k, result):
        if k == 3:
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        work.map(todo, folder=tmp_path, then=then)
    assert len([*tmp_path.glob("jobs/*.npz")]) == 4


def test_the_traced_episode_is_drawn_before_the_last_job_is_done():
    request = Request(Setup.of("LinearAxis-v0"), ["ruckig", "pd"], 25, traced=20)
    comparison = Comparison(request)
    drawn = []
    early = BackgroundSummary(comparison, lambda traces: drawn.append(traces) or b"PNG")
    early(1, comparison.jobs[1]())
    assert early.picture is None
    early(0, comparison.jobs[0]())
    assert [trace.policy for trace in drawn[0]] == ["ruckig", "pd"]
    early(2, comparison.jobs[2]())
    assert len(drawn) == 1
    assert early.picture == b"PNG"


def test_workers_out_of_range_are_refused(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["eval", "LinearAxis-v0", "--policy", "hold", "--workers", "0"])
    assert capsys.readouterr().err.endswith("argument --workers: 0 is out of range 1..10000\n")


def test_workers_are_forked_from_a_process_that_has_loaded_what_they_need():
    code = """
import sys
from servogym.training.scale import template
played = {"env": "LinearAxis-v0", "drive": "generic"}
assert template.prepare([("servogym.training.evaluate.parts:once", played)])
assert not [name for name in sys.modules if name.startswith(("numpy", "numba"))], "at once"
assert not template.prepare([("deeds:square", {"x": 1})]), "started for something else"
import deeds
from servogym.training.scale.job import Job
from servogym.training.scale.work import Work
(found,) = Work(workers=1).map([Job("", deeds.loaded, {})])
assert found == {"played": True, "given": "", "blas": "1"}, found
"""
    folder = Path(__file__).parent
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, cwd=folder)
