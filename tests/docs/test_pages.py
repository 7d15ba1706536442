"""What README and documentation show works: Python, commands, links, tables."""

import contextlib
import importlib
import io
import os
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from servogym.drive.kernel.words import MODE_ABBREVIATION
from servogym.drive.model.drive_toml import QUIRKS
from servogym.drive.model.model import load, model_names
from servogym.training import cli

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [
        README,
        ROOT / "CONTRIBUTING.md",
        *sorted((ROOT / "docs").glob("**/*.md")),
    ]
    if not re.match(r"\d\d_", path.name) and "_build" not in path.parts
}


def blocks(language):
    return [
        pytest.param(block, id=f"{name}-{n}")
        for name, text in PAGES.items()
        for n, block in enumerate(re.findall(rf"^```{language}\n(.*?)^```", text, re.S | re.M))
    ]


COMMANDS = {
    command
    for block in blocks("sh")
    for line in block.values[0].replace("\\\n", " ").splitlines()
    if (command := line.partition("#")[0].strip().removesuffix(" &"))
}


@pytest.mark.parametrize("code", blocks("python"))
def test_a_python_block_prints_what_its_comments_say(code, tmp_path, monkeypatch):
    promised = re.findall(r"^print\(.*\)  # (.*)$", code, re.MULTILINE)
    assert promised
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "page", "exec"), {})
    assert printed.getvalue().splitlines() == promised


def test_the_first_two_commands_of_the_readme_are_make_demo_and_make_test():
    assert re.findall(r"^make \w+", PAGES["README.md"], re.M)[:2] == ["make demo", "make test"]


def test_what_contributing_calls_public_is_listed_by_its_module():
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = contributing.partition("## Compatibility")[2].partition("\n## ")[0]
    modules = re.findall(r"`(servogym\.[\w.]+)`", section)
    assert "servogym.testing" in modules
    for name in modules:
        module = importlib.import_module(name)
        assert module.__all__, name
        assert all(hasattr(module, public) for public in module.__all__), name


def test_every_command_exists(capsys):
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    parser, wrong = cli.parser(), []
    for command in COMMANDS:
        words = [word for word in shlex.split(command) if not re.fullmatch(r"[A-Z_]+=\S*", word)]
        program, *arguments = words
        if program == "servogym":
            try:
                parser.parse_args(arguments)
            except SystemExit:
                wrong.append((command, capsys.readouterr().err))
        elif program == "make":
            wrong += [command] * (arguments[0] not in targets)
        else:
            wrong += [command] * (program not in ("python", "pip"))
    assert COMMANDS
    assert wrong == []


@pytest.mark.slow
def test_the_commands_of_the_readme_run_as_they_are_printed(tmp_path):
    """In their order, in one folder; what serves until Ctrl-C is interrupted, and says so."""
    text = re.sub(r"--steps 200000", "--steps 20000", PAGES["README.md"])
    commands = [
        line.partition("   #")[0]
        for block in re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S)
        for line in block.splitlines()
        if not line.startswith("make ")
    ]
    assert len(commands) > 9
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    scripts = str(Path(sys.executable).parent)
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST", "NICEGUI"))}
    env |= {"PATH": f"{scripts}:{os.environ['PATH']}", "MPLBACKEND": "agg"}
    for command in commands:
        serves = command.split()[1] in ("node", "ethercat", "panel")
        with subprocess.Popen(
            shlex.split(command), cwd=tmp_path, env=env, stderr=subprocess.PIPE, text=True
        ) as process:
            try:
                _, said = process.communicate(timeout=20 if serves else 400)
            except subprocess.TimeoutExpired:
                assert serves, command
                process.send_signal(signal.SIGINT)
                _, said = process.communicate(timeout=20)
            else:
                assert not serves, (command, said)
        assert process.returncode in ((0, 130) if serves else (0,)), (command, said)
        assert "Traceback" not in said, (command, said)


def test_links_lead_to_files():
    links = [
        (name, target) for name, text in PAGES.items()
        for target in re.findall(r"\]\(([^)#\s]+)", text)
        if not target.startswith(("http://", "https://"))
    ]
    assert links
    assert [x for x in links if not ((ROOT / x[0]).parent / x[1]).exists()] == []


def test_the_table_of_drives_is_what_the_models_say():
    text = PAGES["docs/reference/drives.md"]
    rows = re.findall(r"^\| `(\w+)`[^|]*\|([^|]*)\|([^|]*)\|([^|]*)\|$", text, re.MULTILINE)
    assert sorted(name for name, *_ in rows) == model_names()
    for name, modes, methods, cycles in rows:
        model = load(name)
        assert modes.split() == [MODE_ABBREVIATION[mode] for mode in model.modes]
        assert _numbers(methods) == sorted(model.homing_methods)
        microseconds = [f"{time * 1e6:g}" for time in model.cycle_time.values()]
        assert cycles.strip() == ", ".join(microseconds) + " µs"


def test_the_readme_names_every_drive_model():
    for name in model_names():
        assert f"`{name}`" in PAGES["README.md"]


def test_the_parts_of_the_house_exist():
    for folder in re.findall(r"^\| `(\w+)/` \|", PAGES["README.md"], re.MULTILINE):
        assert (ROOT / folder).is_dir()


def test_every_key_and_column_of_a_model_is_explained():
    text = PAGES["docs/reference/drive_files.md"]
    explained = set(re.findall(r"^\| `(\w+)`", text, re.M))
    for name in model_names():
        folder = load(name).folder
        for file in folder.glob("*.csv"):
            columns = file.read_text(encoding="utf-8").partition("\n")[0].split(",")
            assert set(columns) <= explained, file
        for file in folder.glob("*.toml"):
            keys = tomllib.loads(file.read_text(encoding="utf-8"))
            assert set(keys) <= explained, file
            tables = {key for value in keys.values() if isinstance(value, dict) for key in value}
            if file.name == "ethercat.toml":
                named = {key for key in tables if not key.startswith("0x")}
                assert not [key for key in named if f"`{key}`" not in text], file


def test_the_site_builds_without_a_warning(tmp_path, pytestconfig):
    """Pages are read again where they or the modules they show have changed."""
    pytest.importorskip("sphinx")
    read = pytestconfig.cache.mkdir("doctrees") if hasattr(pytestconfig, "cache") else tmp_path
    environment = {**os.environ, "SERVOGYM_DOCS_PICTURES": "0"}
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", "docs", str(tmp_path)]
    command += ["-D", "html_theme=basic"]  # furo draws the tree of pages anew on each
    command += ["-d", str(read)]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if result.returncode:  # warnings of pages that were read are not told again
        shutil.rmtree(read)
    assert result.returncode == 0, result.stderr
    assert "OPERATION_ENABLED" in (tmp_path / "tutorial" / "01_enable_a_drive.html").read_text()
    files = (tmp_path / "reference" / "drive_files.html").read_text()
    assert all(f">{name}<" in files for name in QUIRKS)
    assert "target_position" in (tmp_path / "reference" / "api_tasks.html").read_text()


@pytest.mark.slow
def test_a_lesson_leaves_its_page_and_its_picture_in_the_tutorial_and_nothing_else(tmp_path):
    pytest.importorskip("sphinx")
    lessons = runpy.run_path(str(ROOT / "docs" / "lessons.py"))
    lessons["write"](tmp_path, pictures=True)
    names = [lesson.stem for lesson in (ROOT / "examples").glob("[0-9]*.py")]
    expected = {f"{name}{ending}" for name in names for ending in (".md", ".png")}
    assert {path.name for path in tmp_path.iterdir()} == expected


def _numbers(text: str) -> list[int]:
    """``"1–3, −2"`` -> ``[-2, 1, 2, 3]``."""
    numbers: list[int] = []
    if not text.strip():
        return numbers
    for part in text.replace("−", "-").split(","):
        first, _, last = part.strip().partition("–")
        numbers += range(int(first), int(last or first) + 1)
    return sorted(numbers)
