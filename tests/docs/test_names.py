"""What things call themselves: a line that tells them apart."""

import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import gymnasium

from servogym.drive import Drive
from servogym.drive.master import Master
from servogym.envs import gantry, linear_axis
from servogym.envs.masters.port import MachinePort


def test_the_version_is_that_of_the_distribution():
    code = "import servogym; print(servogym.__version__)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == version("servogym")


def test_a_checkout_that_is_not_installed_has_no_version_and_a_zip_is_refused(tmp_path):
    init = Path(__file__).parents[2] / "__init__.py"
    (tmp_path / "servogym").mkdir()
    shutil.copy(init, tmp_path / "servogym")
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        archive.write(init, "servogym/__init__.py")
    for place, said in ((tmp_path, "unknown"), (tmp_path / "all.zip", "unpack or install it")):
        code = f"import sys; sys.path[:0] = [{str(place)!r}]; import servogym; "
        command = [sys.executable, "-S", "-P", "-c", f"{code} print(servogym.__version__)"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert said in done.stdout + done.stderr


def test_a_drive_tells_model_state_mode_and_fault():
    machine = linear_axis()
    machine.step(2)
    drive = machine.drives["x"]
    assert repr(Drive("generic")) == "Drive(generic, NOT_READY_TO_SWITCH_ON, NONE)"
    assert repr(drive) == "Drive(generic, SWITCH_ON_DISABLED, NONE)"
    drive.inject("overvoltage")
    machine.step(20)
    assert repr(drive) == "Drive(generic, FAULT, NONE, fault 3210h DC link over-voltage)"


def test_a_machine_tells_its_drives_and_its_time():
    machine = linear_axis("kollmorgen_akd")
    machine.step(4)
    assert repr(machine) == "Machine(x=kollmorgen_akd; cycle 250 µs, time 0.001 s)"
    assert repr(gantry()).startswith("Gantry(x=generic, y=generic, z=generic; cycle 500 µs")
    assert repr(Master(MachinePort(gantry()), "x", "z")) == "Master(MachinePort: x, z)"


def test_an_environment_tells_its_machine():
    env = gymnasium.make("servogym.envs:servogym/LinearAxis-v0", action="pdo").unwrapped
    assert repr(env).startswith("LinearAxisEnv(Machine(x=generic; cycle 500 µs, time")
    assert repr(env).endswith("action=pdo)")
