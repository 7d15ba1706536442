"""Ctrl-C while the command is loaded, whatever is being imported: a word and 130, no traceback."""

import subprocess
import sys

import pytest

# sends itself SIGINT when a module is looked for, as if it came there
PROGRAM = """
import os, signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it

class There:
    def find_spec(self, name, *_):
        if name == {module!r} and sys.meta_path.pop(0) is self:
            os.kill(os.getpid(), 2)

sys.meta_path.insert(0, There())
sys.argv = ["servogym", "drives"]
from servogym.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    "module",
    ["servogym.training", "servogym.training.cli", "argparse", "rich", "rich.console",
     "servogym.training.cli.drives", "numpy", "servogym.drive.model"],
)
def test_ctrl_c_while_a_module_is_loaded(module):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(module=module)], capture_output=True, text=True,
        check=False,
    )
    assert done.stderr == "interrupted\n"
    assert done.returncode == 130


# a library in C that is loaded then tells an error of its own
LOADED = """
import ctypes, os, signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)

class There:
    def find_spec(self, name, *_):
        if name == "mujoco" and sys.meta_path.pop(0) is self:
            try:
                os.kill(os.getpid(), 2)
            except KeyboardInterrupt:
                pass
            raise {error}("initialization failed")

sys.meta_path.insert(0, There())
sys.argv = ["servogym", {words}]
from servogym.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("error", ["ImportError", "SystemError", "ctypes.ArgumentError"])
@pytest.mark.parametrize("words", ["'demo'", "'bode', 'rigid'"])
def test_ctrl_c_that_a_library_turns_into_an_error_of_its_own(error, words):
    done = subprocess.run(
        [sys.executable, "-c", LOADED.format(error=error, words=words)], capture_output=True,
        text=True, check=False,
    )
    assert done.stderr == "interrupted\n"
    assert done.returncode == 130
