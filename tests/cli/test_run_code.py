"""Commands that serve a drive whose folder brings a program: not without ``--run-code``."""

import sys

import pytest

from servogym.envs.serve.laboratory import Laboratory
from servogym.training import cli

OBJECTS = """\
index,subindex,name,object_type,data_type,access,pdo,unit,min,max,default,storable,section,note,\
field,when,hook
0x5000,0x00,strength,VAR,UNSIGNED8,rw,,,0,10,1,,mine,,,,strength
"""
HOOKS = """
from pathlib import Path
from servogym.drive import Abort, Hook

Path(__file__).with_name("it ran").touch()

def write(od, row, value):
    od.drive.axis.od.max_torque = 100 * value
    return Abort.NONE

HOOKS = {"strength": Hook(write, lambda od, row: int(od.drive.axis.od.max_torque) // 100)}
"""
MACHINE = """
[bus.can]
kind = "can"
interface = "virtual"
channel = "run-code"
[machine.feeder]
bus = "can"
axis = "linear"
drive = "own"
node_id = 5
"""


@pytest.fixture
def own(tmp_path):
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "drive.toml").write_text('based_on = "generic"\n')
    (folder / "objects.csv").write_text(OBJECTS)
    (folder / "hooks.py").write_text(HOOKS)
    (tmp_path / "machine.toml").write_text(MACHINE)
    return folder


@pytest.fixture
def served(monkeypatch):
    """Servers that end at once; -> the drives that they had."""
    drives = []
    monkeypatch.setattr(Laboratory, "run", lambda it, *_: drives.extend(it.drives.values()))
    return drives


def commands(own):
    """With the drive; of `serve` in the machine file."""
    return {
        "node": ["node", "--drive", str(own), "-i", "virtual", "-c", "run-code"],
        "ethercat": ["ethercat", "--udp", "127.77.0.1", "--drive", str(own)],
        "serve": ["serve", str(own.parent / "machine.toml"), "--check"],
        "drives": ["drives", str(own)],
    }


@pytest.mark.parametrize("command", ["node", "ethercat", "serve", "drives"])
def test_a_drive_folder_runs_code_only_with_the_option(own, served, refused, command):
    words = commands(own)[command]
    if command == "ethercat":
        (own / "drive.toml").write_text('based_on = "kollmorgen_akd"\n')
    error = refused(words)
    assert error.startswith(f"servogym {command}: ")
    assert f"{own / 'hooks.py'} is a program: read it, and consent with --run-code" in error
    assert not (own / "it ran").exists()
    assert cli.main([*words, "--run-code"]) == 0
    assert (own / "it ran").exists()
    for drive in served:
        drive.write("strength", 7)
        assert drive.read("max_torque") == 700
    assert len(served) == (command in ("node", "ethercat"))


def test_of_a_folder_that_is_not_there_the_option_says_so(tmp_path, capsys):
    assert cli.main(["node", "--drive", str(tmp_path / "none"), "--run-code"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_other_processes_have_no_consent_of_this_one(own, capsys):
    words = ["eval", "LinearAxis-v0", "--policy", "hold", "--drive", str(own), "--workers", "2"]
    assert cli.main([*words, "--run-code"]) == 2
    assert "leave out --workers" in capsys.readouterr().err


COMPARISON = '{"env": "NAME", "command": "servogym compare NAME --policies hold", "policies": {}}'
MARKS = "import pathlib\npathlib.Path('it ran').touch()\n"
NAMES = ("evil:Evil-v0", "evil:x", "évil:Evil-v0", "evil.part:servogym/LinearAxis-v0")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("file", "content", "command"),
    [
        (
            "machine.toml",
            MACHINE.replace('axis = "linear"\ndrive = "own"', 'task = "NAME"'),
            "serve machine.toml --check",
        ),
        ("got/LinearAxis-v0/compare.json", COMPARISON, "results got -o page.md"),
        (
            "got/LinearAxis-v0/compare.json",
            COMPARISON.replace("NAME", "LinearAxis-v0", 1),
            "results got --again -o page.md",
        ),
        (
            "got/LinearAxis-v0/trainings.json",
            '{"commands": ["servogym train NAME --seed {seed}"], "steps": {"0": 1}}',
            "results got --train new",
        ),
        ("compare.json", COMPARISON, "benchmark headroom compare.json"),
        (
            "suite.toml",
            'version = "1"\ndrive = "generic"\nseed = 0\nepisodes = 1\nconditions = []\n'
            '[tasks."NAME"]\n',
            "benchmark learned --suite suite.toml --policy hold",
        ),
    ],
)
def test_a_module_that_a_file_names_is_not_imported(
    file, content, command, name, tmp_path, monkeypatch, refused
):
    """As a person who has unpacked what somebody sent, in the folder where it lies."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for package in ("evil", "évil"):
        (tmp_path / package).mkdir()
        for module, file_name in ((package, "__init__.py"), (f"{package}.part", "part.py")):
            sys.modules.pop(module, None)
            (tmp_path / package / file_name).write_text(MARKS)
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content.replace("NAME", name), encoding="utf-8")
    error = refused(command.split())
    assert "say --run-code" in error
    assert name in error
    assert not (tmp_path / "it ran").exists()
    cli.main([*command.split(), "--run-code"])  # mostly of a task that there is not
    assert (tmp_path / "it ran").exists() or "--train" in command
