"""A release of MuJoCo that was not tested is refused in a line, before anything of it is used."""

import subprocess
import sys

import mujoco
import pytest

from servogym.envs.engine import physics

COMMAND = """
import sys, mujoco
mujoco.__version__ = "{version}"
from servogym.training import cli
sys.exit(cli.main(["machines", "toothed_belt"]))
"""


def test_the_installed_release_is_one_that_was_tested():
    physics.refuse_untested(mujoco.__version__)


@pytest.mark.parametrize("version", ["3.9.0", "4.1.0", "4.00.1", "40.0", "5.0.0rc1", ""])
def test_another_release_is_refused_with_the_next_step(version):
    with pytest.raises(ImportError, match=r"is not 4\.0, .*pip install 'mujoco==4\.0\.\*'"):
        physics.refuse_untested(version)


@pytest.mark.parametrize("version", ["4.0", "4.0.0", "4.0.7", "4.0.0rc1"])
def test_its_patches_are_taken(version):
    physics.refuse_untested(version)


def test_a_command_tells_it_in_a_line():
    done = subprocess.run(
        [sys.executable, "-c", COMMAND.format(version="4.1.0")], capture_output=True, text=True
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2
    assert "MuJoCo 4.1.0 is not 4.0" in line


def test_a_library_without_a_function_is_refused_before_it_is_called():
    with pytest.raises(ImportError, match=r"has no mj_stepTwice: pip install 'mujoco==4\.0\.\*'"):
        physics.refuse_incomplete(["mj_step", "mj_stepTwice"])
