"""The command line: what each command prints, and how it ends."""

import os
import re
import shlex
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from servogym import training
from servogym.drive.model.model import load
from servogym.training import cli
from servogym.training.bench import drive as bench
from servogym.training.pictures import demo

ROOT = Path(__file__).parents[2]


def servogym(*arguments):
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "servogym.training.cli", *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=300,
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["demo", "--drive", "nothing"], "unknown drive model 'nothing': choose one of"),
        (["demo", "--payload", "nan"], "--payload: 'nan' is not a finite number"),
        (["demo", "--payload", "-1"], "--payload: -1 is out of range 0..100"),
        (["bench", "--repeat", "0"], "--repeat: 0 is out of range"),
        (["bench", "--drive", "nothing"], "unknown drive model 'nothing': choose one of"),
        (["drives", "nothing"], "unknown drive model 'nothing': choose one of"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(refused, arguments, says):
    error = refused(arguments)
    assert says in error
    assert error.startswith(f"servogym {arguments[0]}: ")


@pytest.mark.parametrize("arguments", [[], ["nothing"], ["demo", "--payload", "heavy"]])
def test_a_wrong_command_line_shows_the_usage_and_status_2(capsys, arguments):
    with pytest.raises(SystemExit) as exit_info:
        cli.main(arguments)
    assert exit_info.value.code == 2
    assert "usage: servogym" in capsys.readouterr().err


@pytest.mark.parametrize("command", [["train", "LinearAxis-v0"], ["bench", "--train"]])
def test_without_sb3_the_command_that_installs_it_is_told(refused, monkeypatch, command):
    for name in list(sys.modules):
        if name.startswith("servogym.training.") and not name.endswith("cli"):
            monkeypatch.delitem(sys.modules, name)
            monkeypatch.delattr(training, name.rpartition(".")[2], raising=False)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    assert "pip install 'servogym[train]'" in refused(command)


def test_a_picture_that_cannot_be_written_is_one_line(capsys, tmp_path):
    file = tmp_path / "a file"
    file.touch()
    assert cli.main(["demo", "--out", str(file / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_interrupting_is_status_130_without_a_traceback(capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "run", interrupt)
    assert cli.main(["demo"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_version_is_the_installed_one():
    from importlib.metadata import version

    result = servogym("--version")
    assert (result.returncode, result.stdout) == (0, f"servogym {version('servogym')}\n")


def test_drives_lists_the_models(capsys):
    assert cli.main(["drives"]) == 0
    assert "generic" in capsys.readouterr().out


def test_drives_tells_about_one(capsys):
    assert cli.main(["drives", "generic"]) == 0
    out = capsys.readouterr().out
    for fact in ("csp", "17", "500 µs", "8611h", "quirks"):
        assert fact in out


def test_drives_tells_what_a_folder_changes_of_the_model_it_is_based_on(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "drive.toml").write_text(
        'based_on = "generic"\nwithout = ["6081h"]\n[defaults]\nfollowing_error_window = 5000\n'
    )
    columns, _ = (load("generic").folder / "objects.csv").read_text().split("\n", 1)
    (tmp_path / "objects.csv").write_text(
        f"{columns}\n0x5000,0,my_parameter,VAR,INTEGER32,rw,,mm,-5,5,3,yes,mine,,,,\n"
        "0x6065,0,,,,,,,,70000,,,,,,,\n"
    )
    assert cli.main(["drives", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    rows = {key.strip(): value.strip() for key, value in re.findall("│([^│]*)│([^│]*)│", out)}
    assert rows["based on"] == "generic"
    assert rows["objects added"] == "5000h:00h my_parameter -5..5"
    assert rows["objects left out"] == "6081h"
    was = load("generic").objects[0x6065, 0]
    assert f"0..70000, was 0..{was.maximum:.0f}" in out
    assert f"5000, was {was.default}" in out


def test_the_demo_runs_as_a_command_and_draws_its_picture(tmp_path):
    result = servogym("demo", "--out", str(tmp_path / "new" / "out"))
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    for phase in ("enable", "home", "pp", "csp", "quick stop"):
        assert phase in result.stdout
    assert (tmp_path / "new" / "out" / "scope.png").read_bytes()[:4] == b"\x89PNG"


@pytest.fixture(scope="module")
def run():
    """The demo after its run, with its trace."""
    run = demo.Demo("generic", 5.0)
    run.run()
    return run


def test_the_demo_passes_through_the_states_and_modes(run):
    words = run.trace.arrays()["statusword"]
    states = [int(word) & 0x6F for word in words[np.flatnonzero(np.diff(words, prepend=0))]]
    walk = [
        state for state, before in zip(states, [None, *states], strict=False) if state != before
    ]
    switch_on_disabled = {0x40, 0x60}  # the quick stop bit counts in other states only
    walk = [0x40 if state in switch_on_disabled else state for state in walk]
    assert walk[-6:] == [0x40, 0x21, 0x23, 0x27, 0x07, 0x40]
    modes = run.trace.arrays()["modes_of_operation_display"]
    changes = modes[np.flatnonzero(np.diff(modes, prepend=-1))].tolist()
    assert changes == [0, 6, 1, 8, 3]


def test_csp_follows_within_a_hundredth_of_the_velocity_lag(run):
    phase = next(phase for phase in run.phases if phase.name.startswith("csp"))
    data = {name: values[phase.start : phase.end] for name, values in run.trace.arrays().items()}
    error = np.abs(data["following_error_actual_value"]).max()
    lag = np.abs(data["velocity_demand_value"]).max() / run.drive.axis.position_gain
    assert error < 0.01 * lag


def test_the_quick_stop_brakes_on_its_ramp(run):
    data = run.trace.arrays()
    braking = data["statusword"] & 0x6F == 0x07
    velocity = data["velocity_demand_value"][braking]
    time = data["time"][braking]
    slope = np.polyfit(time[2:20], velocity[2:20], 1)[0]
    assert abs(slope) == pytest.approx(run.drive.read(0x6085, 0), rel=1e-3)


def test_two_demos_are_bit_identical(run):
    again = demo.Demo("generic", 5.0)
    again.run()
    first, second = run.trace.arrays(), again.trace.arrays()
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])


def test_the_bench_compares_the_same_motion():
    result = bench.measure("generic", 3, False)  # raises if the replay ends elsewhere
    assert result["mj_step_ns"] > 0
    low, high = result["ratio_quartiles"]
    assert low <= result["ratio"] <= high


def test_who_asks_for_a_version_or_the_commands_loads_no_drive():
    code = (
        "import sys; from servogym.training import cli\n"
        "try: cli.main([sys.argv[1]])\n"
        "finally: print('numpy' in sys.modules, file=sys.stderr)"
    )
    for option in ("--version", "--help"):
        done = subprocess.run([sys.executable, "-c", code, option], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "False\n")
    assert all(name in done.stdout for name in cli.COMMANDS)


def test_every_command_does_something():
    for name in cli.COMMANDS:
        assert callable(cli.parser(name).commands[name].get_default("run")), name


def test_the_help_of_every_command_says_what_it_is_for_and_shows_an_example_that_parses():
    for name, row in cli.COMMANDS.items():
        parser = cli.parser(name)
        text = parser.commands[name].format_help()
        assert row.purpose[1:] in " ".join(text.split()), name
        assert f"\n  servogym {row.example}\n" in text, name
        assert parser.parse_args(shlex.split(row.example)).command == name


def test_what_an_example_opens_is_made_by_another_one_or_by_the_page_it_names():
    """That of `ethercat` opened a network interface that nothing makes."""
    words = {name: shlex.split(row.example) for name, row in cli.COMMANDS.items()}
    made = {
        word for row in words.values() for option, word in pairwise(row)
        if option in ("--log", "-o", "--out", "--gallery", "--results")
    }
    for name, row in words.items():
        if name in ("deploy", "observe"):  # they command a drive on a desk
            continue
        assert "-i" not in row or "udp_multicast" in row, name
        for word in row:
            if re.fullmatch(r"\w+\.(log|pcapng|toml|json|py)|out/\w+", word) and word not in made:
                pages = re.findall(r"docs/[\w/-]+\.md", cli.COMMANDS[name].more)
                assert any(word in (ROOT / page).read_text(encoding="utf-8") for page in pages), row


def test_a_page_that_opens_a_virtual_ethernet_port_makes_it():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.py")]
    opened = {page for page in pages if "veth1" in page.read_text(encoding="utf-8")}
    assert opened
    assert all("ip link add veth1" in page.read_text(encoding="utf-8") for page in opened), opened


def shell(script, **environment):
    """What a line of a shell prints, with `servogym` in it, and its exit statuses."""
    run = f"{sys.executable} -W error -m servogym.training.cli"
    return subprocess.run(
        ["bash", "-c", script.replace("servogym", run)], capture_output=True, text=True,
        env=os.environ | environment, timeout=300,
    )


def test_a_pipe_that_is_closed_early_is_no_error():
    done = shell("servogym drives generic | head -1")
    assert "Generic CiA 402 servo drive" in done.stdout
    assert done.stderr == ""


def test_a_terminal_without_greek_letters_is_no_error():
    done = shell("servogym drives", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "position cycle" in done.stdout


def test_a_working_directory_that_is_gone_is_told(tmp_path):
    done = shell(f"mkdir {tmp_path}/gone; cd {tmp_path}/gone; rmdir ../gone; servogym drives")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "servogym: the working directory no longer exists\n"
