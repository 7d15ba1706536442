"""What mypy and editors know of the installed package, as a user meets it."""

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]

SCRIPT = """
import servogym
from servogym.drive import Drive
from servogym.drive.kernel.jit import block
from servogym.drive.kernel.record import Axis


@block
def my_block(axis: Axis) -> float:
    reveal_type(axis.od.target_position)
    reveal_type(axis.velocity_demand)
    return axis.velocity_demand + axis.od.no_such_object


drive = Drive("generic", node_id="one")
reveal_type(servogym.__version__)
reveal_type(drive)
reveal_type(drive.state.name)
reveal_type(drive.axis.od.following_error_window)
"""
EXPECTED = (
    'Revealed type is "int"',
    'Revealed type is "float"',
    '"Objects" has no attribute "no_such_object"',
    'Argument "node_id" to "Drive" has incompatible type "str"',
    'Revealed type is "str"',
    'Revealed type is "servogym.drive.drive.Drive"',
    'Revealed type is "str"',
    'Revealed type is "int"',
)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Python of an environment with the package as its wheel installs it, and its site-packages."""
    folder = tmp_path_factory.mktemp("wheel")
    code = f"import setuptools.build_meta as b; b.build_wheel({str(folder)!r})"
    copy = folder / "source"
    copy.mkdir()
    for name in ("__init__.py", "py.typed", "drive", "envs", "assets", "training",
                 "pyproject.toml", "README.md", "LICENSE"):
        (copy / name).symlink_to(ROOT / name)
    subprocess.run([sys.executable, "-c", code], cwd=copy, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "venv")
    python = folder / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(subprocess.check_output([python, "-c", code], text=True).strip())
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    (site / "more.pth").write_text(str(Path(np.__file__).parents[1]))  # numpy, and no servogym
    return python, site


def test_the_package_says_that_it_has_types(installed):
    assert (installed[1] / "servogym" / "py.typed").is_file()


def test_a_users_script_is_checked_and_the_record_completes(installed, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file=", "--cache-dir=.cache",
         f"--python-executable={installed[0]}", script.name],
        cwd=tmp_path, capture_output=True, text=True,
        env={key: value for key, value in os.environ.items() if key != "MYPYPATH"},
    )
    said = [line for line in run.stdout.splitlines() if line.startswith(script.name)]
    assert len(said) == len(EXPECTED), run.stdout + run.stderr
    for line, expected in zip(said, EXPECTED, strict=True):
        assert expected in line
