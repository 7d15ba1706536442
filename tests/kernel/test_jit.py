"""The compile cache: what makes compiled code another one, who compiles, and where it is kept."""

import fcntl
import importlib
import io
import os
import pickle
import subprocess
import sys
import tempfile
import textwrap
import threading

import numba
import numpy as np
import pytest

from servogym.drive.kernel import code_cache, dispatchers, jit
from servogym.drive.kernel.reach import reach

pytestmark = pytest.mark.skipif(jit.DISABLED, reason="nothing is compiled")

MAIN = '''
"""A kernel of two files."""
import math
from servogym.drive.kernel.jit import block, entry
from . import brake

def scaler(factor):
    @block
    def scaled(x):
        return x * factor
    return scaled

scaled = scaler(3.0)

def not_compiled():
    return "anything"

@entry
def run(x):
    return scaled(brake.run(x)) + math.floor(0.5)
'''
BRAKE = '''
"""The other file."""
from enum import IntEnum
import numpy as np
from servogym.drive.kernel.jit import block
from . import words as w

class Mode(IntEnum):
    OFF = 0
    ON = 1

GAIN = 2.0
TABLE = (1, 5, 7)
WEIGHTS = np.array([1.0, 2.0])
RECORD = np.dtype([("x", "f8"), ("n", "i4")], align=True)

@block
def helper(x, add=0.25):
    return x + add

@block
def run(x):
    y = x * GAIN + (TABLE[1] + Mode.ON) + WEIGHTS[1]
    if x in (1.0, 2.0):
        y += w.OFFSET
    return helper(y) + np.zeros(1, RECORD)[0]["n"]

@block
def neighbour(x):
    return x + 17.0
'''
WORDS = "OFFSET = 4\nOTHER = 5\n"
FILES = {"__init__": "", "main": MAIN, "brake": BRAKE, "words": WORDS}


def write(folder, edits=()):
    """The package in a new folder, with ``(file, old, new)`` replaced."""
    files = dict(FILES)
    for file, old, new in edits:
        assert files[file].count(old) == 1
        files[file] = files[file].replace(old, new)
    package = folder / "plant"
    package.mkdir(parents=True)
    for file, text in files.items():
        (package / f"{file}.py").write_text(text)
    return folder


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Import the package with edits, each time from another folder; -> its entry."""
    folders = iter(range(100))

    def load(*edits):
        folder = write(tmp_path / str(next(folders)), edits)
        for name in [name for name in sys.modules if name.partition(".")[0] == "plant"]:
            del sys.modules[name]
        with monkeypatch.context() as path:
            path.syspath_prepend(folder)
            return importlib.import_module("plant.main").run

    yield load
    for name in [name for name in sys.modules if name.partition(".")[0] == "plant"]:
        del sys.modules[name]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setattr(code_cache, "cache_directory", lambda: folder)
    code_cache.cannot_keep.cache_clear()
    return folder


def compiled(function):
    """How often it was compiled, not loaded."""
    return sum(function.stats.cache_misses.values())


SAME = {
    "comment": ("brake", "    y = x", "    # why\n\n    y = x"),
    "docstring added": ("brake", "def run(x):\n", 'def run(x):\n    """Run."""\n'),
    "docstring of the module": ("main", "A kernel", "Another kernel"),
    "neighbour": ("brake", "17.0", "18.0"),
    "constant not reached": ("words", "OTHER = 5", "OTHER = 6"),
    "function not compiled": ("main", '"anything"', '"something"'),
    "annotation": ("brake", "def helper(x, add", "def helper(x: float, add"),
}
OTHER = {
    "called block": ("brake", "x * GAIN", "x / GAIN"),
    "constant in the code": ("brake", "x in (1.0, 2.0)", "x in (1.0, 3.0)"),
    "global number": ("brake", "GAIN = 2.0", "GAIN = 2.5"),
    "type of a number": ("brake", "GAIN = 2.0", "GAIN = 2"),
    "tuple": ("brake", "(1, 5, 7)", "(1, 6, 7)"),
    "array": ("brake", "[1.0, 2.0]", "[1.0, 2.5]"),
    "enum member": ("brake", "ON = 1", "ON = 2"),
    "name of a field": ("brake", '("x", "f8")', '("y", "f8")'),
    "type of a field": ("brake", '("n", "i4")', '("n", "i8")'),
    "alignment": ("brake", "align=True", "align=False"),
    "closure": ("main", "scaler(3.0)", "scaler(4.0)"),
    "default": ("brake", "add=0.25", "add=0.5"),
    "module two steps away": ("words", "OFFSET = 4", "OFFSET = 5"),
    "attribute of a module": ("main", "math.floor", "math.ceil"),
    "block of a block": ("brake", "return x + add", "return x - add"),
}


@pytest.mark.parametrize("edit", SAME.values(), ids=SAME)
def test_what_is_not_compiled_does_not_count(load, edit):
    before = reach(load().py_func, {})
    assert reach(load(edit).py_func, {}) == before


@pytest.mark.parametrize("edit", OTHER.values(), ids=OTHER)
def test_what_is_compiled_counts(load, edit):
    before = reach(load().py_func, {})
    assert reach(load(edit).py_func, {}) != before


def test_changing_a_docstring_does_not_count(load):
    texts = [("brake", "def run(x):\n", f'def run(x):\n    """{t}."""\n') for t in ("A", "B")]
    assert len({reach(load(edit).py_func, {}) for edit in texts}) == 1


def test_an_edited_block_in_another_file_is_compiled_anew_and_a_comment_is_not(load, cache):
    first = load()
    assert first(1.0) == 3.0 * (2.0 + 5 + 1 + 2.0 + 4 + 0.25)
    comment, block = load(SAME["comment"]), load(OTHER["global number"])
    assert (comment(1.0), block(1.0)) == (first(1.0), 3.0 * (2.5 + 5 + 1 + 2.0 + 4 + 0.25))
    assert [compiled(f) for f in (first, comment, block)] == [1, 0, 1]
    again = load()  # the edit is taken back: it is still there
    assert again(1.0) == first(1.0)
    assert compiled(again) == 0


DIGEST = """
import importlib, os, sys
import gymnasium, mujoco, numba
sys.pycache_prefix = os.environ.get("EMPTY")
from servogym.drive.kernel.reach import reach
for module, name in (
    ("servogym.envs.engine.job", "settle"),
    ("servogym.drive.kernel.cycle", "run"),
    ("plant.main", "run"),
):
    print(reach(getattr(importlib.import_module(module), name).py_func, {}))
"""


def python(code, folder, **environment):
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(code)], cwd=folder,
        env=os.environ | environment, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )


def test_the_digest_is_the_same_in_every_process(tmp_path):
    strings = (
        "brake",
        "    y = x",
        "    if 'a' in {'a', 'b', 'c', 'd'}:\n        x += 1.0\n    y = x",
    )
    folder = write(tmp_path, [strings])
    compiled = {"EMPTY": str(tmp_path / "empty"), "PYTHONDONTWRITEBYTECODE": "1"}
    runs = [{"PYTHONHASHSEED": "1"}, {"PYTHONHASHSEED": "2"} | compiled]
    processes = [python(DIGEST, folder, **run) for run in runs]
    answers = [process.communicate(timeout=120) for process in processes]
    assert [error for _, error in answers] == [""] * 2
    assert len({out for out, _ in answers}) == 1
    assert len(set(answers[0][0].split("\n"))) == 4


COUNT = """
from plant.main import run
print("ready", flush=True)
input()
run(1.0)
print(sum(run.stats.cache_misses.values()))
"""


def test_of_two_processes_with_a_cold_cache_one_compiles(tmp_path):
    folder, cache = write(tmp_path), tmp_path / "cache"
    cache.mkdir()
    with open(cache / "lock", "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        processes = [python(COUNT, folder, SERVOGYM_CACHE_DIR=str(cache)) for _ in range(2)]
        for process in processes:
            assert process.stdout.readline() == "ready\n"
            process.stdin.write("\n")
            process.stdin.flush()
        with pytest.raises(subprocess.TimeoutExpired):  # both wait
            processes[0].wait(1)
        assert processes[1].poll() is None
        assert not list(cache.glob("*.nb*"))
    answers = [process.communicate(timeout=120) for process in processes]
    assert sorted(out for out, _ in answers) == ["0\n", "1\n"], answers
    assert [error for _, error in answers] == ["", ""]


def is_free(folder):
    with open(folder / "lock", "a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def test_a_compile_that_fails_releases_the_lock(load, cache):
    with pytest.raises(numba.TypingError):
        load()("text")
    assert is_free(cache)
    assert load()(1.0)


def test_an_entry_compiled_within_another_does_not_wait_for_itself(load, cache):
    nested = ("main", "    return scaled(", "    return inner(x) + scaled(")
    inner = ("main", "@entry\n", "@entry\ndef inner(x):\n    return x\n\n@entry\n")
    assert load(inner, nested)(1.0) == load()(1.0) + 1.0
    assert is_free(cache)


def test_of_many_threads_one_compiles(load, cache):
    run = load()
    threads = [threading.Thread(target=run, args=(1.0,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert compiled(run) == 1


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_who_waits_at_a_terminal_is_told_once(load, cache, monkeypatch):
    monkeypatch.delenv("SERVOGYM_QUIET", raising=False)
    monkeypatch.setattr(sys, "stderr", Terminal())
    load()(1.0)
    assert sys.stderr.getvalue() == "servogym: compiling plant.main.run (once, about 1 s)\n"
    load()(1.0)
    assert sys.stderr.getvalue().count("\n") == 1


def test_a_notebook_is_told_before_and_after_a_long_compile(load, cache, monkeypatch):
    """Its stderr is not a terminal; ipykernel's `OutStream` is known by its module."""
    stream = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})
    monkeypatch.delenv("SERVOGYM_QUIET", raising=False)
    monkeypatch.setattr(dispatchers, "LONG", 0.0)
    monkeypatch.setattr(sys, "stderr", stream())
    load()(1.0)
    load()(1.0)
    assert sys.stderr.getvalue() == (
        "servogym: compiling plant.main.run (once, about 1 s)\n"
        "servogym: compiled plant.main.run; the next start is at once\n"
    )


@pytest.mark.parametrize(("stream", "quiet"), [(Terminal, "1"), (io.StringIO, "")])
def test_nobody_is_told_who_does_not_look(load, cache, monkeypatch, stream, quiet):
    monkeypatch.setenv("SERVOGYM_QUIET", quiet)
    monkeypatch.setattr(sys, "stderr", stream())
    load()(1.0)
    assert sys.stderr.getvalue() == ""


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_is_compiled_anew(load, cache, suffix):
    value = load()(1.0)
    (path,) = cache.glob(f"*.{suffix}")
    path.write_bytes(path.read_bytes()[:40])
    again = load()
    assert (again(1.0), compiled(again)) == (value, 1)
    third = load()
    assert (third(1.0), compiled(third)) == (value, 0)


def test_a_cache_that_cannot_be_written_is_told_once(load, cache, monkeypatch):
    def refuse(*_):
        raise OSError(30, "Read-only file system")

    monkeypatch.delenv("SERVOGYM_QUIET", raising=False)
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", refuse)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert load()(1.0) == load()(1.0)
    (line,) = sys.stderr.getvalue().splitlines()
    assert "Read-only file system" in line
    assert "SERVOGYM_CACHE_DIR" in line


def test_a_cache_keeps_what_was_used_last(load, cache, monkeypatch):
    first = load()
    first(1.0)
    size = sum(path.stat().st_size for path in cache.iterdir())
    monkeypatch.setattr(code_cache, "LARGEST_CACHE", int(1.5 * size))
    for path in cache.iterdir():
        os.utime(path, (1, 1))
    load(OTHER["tuple"])(1.0)
    assert len(list(cache.glob("*.nbi"))) == len(list(cache.glob("*.nbc"))) == 1
    again = load(OTHER["tuple"])
    again(1.0)
    assert compiled(again) == 0


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / f"servogym-{os.getuid()}"


def test_the_temporary_folder_is_for_its_owner_alone(temporary):
    assert code_cache._temporary_directory() == temporary
    assert temporary.stat().st_mode & 0o777 == 0o700
    assert code_cache._temporary_directory() == temporary


@pytest.mark.parametrize("trap", ["open", "link", "file", "stranger"])
def test_a_temporary_folder_somebody_has_prepared_is_not_used(temporary, monkeypatch, trap):
    if trap == "open":
        temporary.mkdir()
        temporary.chmod(0o777)
    elif trap == "link":
        (temporary.parent / "elsewhere").mkdir(mode=0o700)
        temporary.symlink_to(temporary.parent / "elsewhere")
    elif trap == "file":
        temporary.touch()
    else:
        temporary.mkdir(mode=0o700)
        user = os.getuid()
        names = iter([user, user + 1])  # for the name, and to compare
        monkeypatch.setattr(os, "getuid", lambda: next(names))
    folder = code_cache._temporary_directory()
    assert folder != temporary
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(
    ("mode", "above", "used"),
    [
        (0o700, 0o755, True), (0o755, 0o755, True), (0o777, 0o755, False), (0o757, 0o755, False),
        (0o700, 0o1777, True), (0o700, 0o777, False),  # another folder in its place
    ],
)
def test_a_cache_that_others_can_write_is_not_run(
    temporary, monkeypatch, capsys, mode, above, used
):
    folder = temporary.parent / "above" / "cache"
    folder.mkdir(parents=True)
    folder.chmod(mode)
    folder.parent.chmod(above)
    monkeypatch.setenv("SERVOGYM_CACHE_DIR", str(folder))
    monkeypatch.delenv("SERVOGYM_QUIET", raising=False)
    code_cache.cache_directory.cache_clear()
    code_cache.cannot_keep.cache_clear()
    try:
        assert code_cache.cache_directory() == (folder if used else temporary)
    finally:
        code_cache.cache_directory.cache_clear()
    assert ("chmod 700" in capsys.readouterr().err) is not used


def test_without_a_folder_to_write_the_temporary_one_is_told(tmp_path):
    (tmp_path / "file").touch()
    code = "from plant.main import run; print(run(1.0))"
    folder = write(tmp_path)
    places = {"SERVOGYM_CACHE_DIR": str(tmp_path / "file"), "TMPDIR": str(tmp_path)}
    out, error = python(code, folder, **places, SERVOGYM_QUIET="").communicate(timeout=120)
    assert out == "42.75\n"
    assert error.count("\n") == 1
    assert list((tmp_path / f"servogym-{os.getuid()}").glob("*.nbc"))


def test_an_entry_and_a_block_go_into_another_process_and_use_the_cache(load, tmp_path, cache):
    run = load()
    run(1.0)
    main = sys.modules["plant.main"]
    data = pickle.dumps([run, main.brake.run])
    code = """
        import pickle, sys
        run, part = pickle.loads(bytes.fromhex(input()))
        print(run(1.0), part(1.0), sum(run.stats.cache_misses.values()))
    """
    process = python(code, write(tmp_path / "child"), SERVOGYM_CACHE_DIR=str(cache))
    out, error = process.communicate(data.hex() + "\n", timeout=120)
    assert (out, error) == ("42.75 14.25 0\n", "")


def test_a_forked_process_runs_what_its_parent_compiled(tmp_path):
    code = """
        import os
        from plant.main import run
        run(1.0)
        child = os.fork()
        if child == 0:
            os._exit(0 if run(1.0) == 42.75 and run(1) == 42.75 else 1)
        print(os.waitpid(child, 0)[1])
    """
    process = python(code, write(tmp_path), SERVOGYM_CACHE_DIR=str(tmp_path / "cache"))
    assert process.communicate(timeout=120) == ("0\n", "")


def test_a_block_can_be_called_from_python(load, cache):
    load()(1.0)
    block = sys.modules["plant.brake"].run
    assert block(1.0) == 14.25
    assert block(1) == 14.25


def test_without_jit_they_are_the_functions_themselves(tmp_path):
    code = "import plant.main as m; print(type(m.run), type(m.brake.run), m.run(1.0))"
    process = python(code, write(tmp_path), NUMBA_DISABLE_JIT="1")
    assert process.communicate(timeout=60) == (f"{type(write)} {type(write)} 42.75\n", "")


@pytest.mark.parametrize("order", [(2, 3), (3, 2)])
def test_a_record_that_begins_as_another_has_code_of_its_own(order):
    """Numba 0.68 warns of one record that it takes for another: which came first may not matter."""

    @dispatchers.block
    def first(record):
        return record.a

    @numba.njit  # not kept: it is compiled here
    def read(records):
        return first(records[0])

    for fields in order:
        kind = np.dtype([(name, "f8") for name in "abc"[:fields]], align=True)
        records = np.zeros(1, kind)
        records["a"] = fields
        assert read(records) == fields
