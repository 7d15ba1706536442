"""SOEM's own C samples against `servogym ethercat`; built from source, so not part of `make test`.

``pytest -m slow tests/interop/test_soem.py`` builds simple_ng with gcc from the sources that pysoem
is made of (its sdist, by pip). Its legacy samples do not compile there; ``SERVOGYM_SOEM`` names a
folder with slaveinfo and simple_ng, built with SOEM's own cmake files.
"""

import os
import shutil
import subprocess
import sys
import tarfile
from importlib.metadata import version
from pathlib import Path

import pytest
from wire import on_the_wire

OPTIONS = ("--drive", "kollmorgen_akd", "--axis", "none", "--slaves", "2")


def sources(folder):
    """The SOEM that pysoem has."""
    if not shutil.which("gcc"):
        pytest.skip("gcc is not there")
    wanted = f"pysoem=={version('pysoem')}"
    done = subprocess.run(
        [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:",
         "--no-build-isolation", "--dest", str(folder), wanted],
        capture_output=True, text=True, check=False,
    )
    archive = next(folder.glob("pysoem-*.tar.gz"), None)
    if archive is None:
        pytest.skip(f"no sources of {wanted}: {done.stderr.strip()[-200:]}")
    with tarfile.open(archive) as packed:
        packed.extractall(folder, filter="data")
    return next(folder.glob("pysoem-*/soem"))


def program(name, folder):
    if built := os.environ.get("SERVOGYM_SOEM"):
        return str(Path(built) / name)
    soem = sources(folder)
    parts = ["soem/*.c", "osal/linux/osal.c", "oshw/linux/*.c", f"test/{name}/{name}.c"]
    files = [str(file) for part in parts for file in soem.glob(part)]
    folders = [f"-I{soem / part}" for part in ("", "soem", "osal", "osal/linux", "oshw/linux")]
    target = folder / name
    command = ["gcc", "-w", "-DEC_VER2", *folders, *files, "-o", str(target), "-lpthread", "-lrt"]
    subprocess.run(command, check=True, timeout=600)
    return str(target)


@pytest.mark.slow
def test_31_simple_ng_of_soem_reaches_op_and_every_working_counter_is_right(tmp_path):
    built = program("simple_ng", tmp_path)
    result = on_the_wire("soem_master", "simple_ng", *OPTIONS, program=built, cycles=500)
    told = "\n".join(result["before"])
    assert "2 slaves found" in told
    assert "mapped 12O+12I bytes" in told
    assert "all slaves are now operational" in told
    assert result["counters"] == [6] * 500


@pytest.mark.slow
def test_12_slaveinfo_of_soem_shows_identity_sizes_and_delays(tmp_path):
    if not os.environ.get("SERVOGYM_SOEM"):
        pytest.skip("SERVOGYM_SOEM names no folder with slaveinfo")
    built = program("slaveinfo", tmp_path)
    first, second = on_the_wire("soem_master", "slaveinfo", *OPTIONS, program=built)
    assert first[1:] == [48, 48, 4, 0, 0x6A, 0x414B44, 2]
    assert second[1:] == [48, 48, 4, 600, 0x6A, 0x414B44, 2]
