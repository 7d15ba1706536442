"""Open doors: tasks, policies and drives of other packages work everywhere, by their names."""

import ast
import re
import sys
from importlib import metadata
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from servogym.drive import Drive
from servogym.drive.model.model import load
from servogym.drive.objects.abort import SdoAbort
from servogym.envs import TASKS, ServoEnv, action, episode, linear_axis, observation, register, task
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training import cli
from servogym.training.policies import make, names

ROOT = Path(__file__).parents[2]
TRAINING = sorted((ROOT / "training").rglob("*.py"))
PAGES = ("own_task", "own_policy")
NAME = "mylab:Nudge-v0"


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A folder with the modules the pages show, as a user has it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setenv("MUJOCO_GL", "egl")
    for page in PAGES:
        text = (ROOT / "docs" / "how-to" / f"{page}.md").read_text(encoding="utf-8")
        found = re.findall(
            r"^```\{code-block\} python\n:caption: (\S+)\n(.*?)^```", text, re.S | re.M
        )
        for name, code in found:
            Path(name).write_text(code, encoding="utf-8")
    yield tmp_path
    gym.registry.pop("mylab/Nudge-v0", None)
    sys.modules.pop("mylab", None)


def figures(page, metric):
    """The row of a metric in the table that judges the policies, the first one: by policy."""
    table = re.search(r"^\|.*(\n\|.*)*", page, re.M)[0]
    heading, _, *rows = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in table.split("\n")
    )
    (row,) = (row for row in rows if row[0] == metric)
    return dict(zip(heading[1:], row[1:], strict=True))


def test_a_task_of_ones_own_has_at_most_40_lines(lab):
    assert len((lab / "mylab.py").read_text(encoding="utf-8").splitlines()) <= 40


def test_a_task_of_ones_own_is_trained_judged_compared_and_watched(lab, capsys):
    pytest.importorskip("stable_baselines3")
    train = ["train", NAME, "--steps", "256", "--envs", "4", "--evaluate-every", "256"]
    assert cli.main([*train, "--out", "out/run"]) == 0
    assert cli.main([*train, "--out", "out/run", "--resume"]) == 0
    policies = "hold,random,out/run,steering.py:Steering"
    assert cli.main(["eval", NAME, "--policy", "out/run", "--episodes", "2"]) == 0
    assert cli.main(["compare", NAME, "--policies", policies, "--episodes", "3"]) == 0
    folder = lab / "out" / "compare-mylab-Nudge-v0-generic"
    assert (folder / "compare_trace.png").is_file()
    page = (folder / "compare.md").read_text(encoding="utf-8")
    success = figures(page, "success")
    assert [*success] == ["hold", "random", "run", "steering.py:Steering"]
    assert success["steering.py:Steering"].startswith("100 % ["), "it steers to the goal"
    assert success["hold"].startswith("0 % ["), "it stays where it is"
    watch = ["watch", NAME, "--policy", "steering.py:Steering", "--record", "out/run.gif"]
    assert cli.main(watch) == 0
    assert "success" in capsys.readouterr().out
    assert (lab / "out" / "run.gif").stat().st_size > 10_000


def test_a_task_of_ones_own_in_vectors_of_gymnasium_and_sb3(lab):
    sys.path.append(str(lab))
    envs = gym.make_vec("mylab:mylab/Nudge-v0", 3)
    observations, _ = envs.reset(seed=1)
    alone = gym.make("mylab:mylab/Nudge-v0")
    assert (alone.reset(seed=3)[0] == observations[2]).all()
    for _ in range(5):
        observations, *_ = envs.step(np.full((3, 1), 0.2, np.float32))
        one, *_ = alone.step(np.full(1, 0.2, np.float32))
    assert (one == observations[2]).all()
    assert alone.unwrapped.named(one).velocity == one[1] > 0.0
    pytest.importorskip("stable_baselines3")
    from servogym.training.learn import sb3

    assert sb3.make(NAME, 2).reset().shape == (2, 2)


@pytest.mark.parametrize("command", ["train", "eval", "compare", "watch"])
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("LinarAxis-v0", "unknown environment 'LinarAxis-v0': did you mean LinearAxis-v0"),
        ("mylab:Nugde-v0", "did you mean mylab:Nudge-v0"),
        ("yourlab:Nudge-v0", "module 'yourlab' cannot be imported (ModuleNotFoundError"),
        ("CartPole-v1", "is not a task of servo drives"),
        ("numpy:X-v0", "numpy registers none"),
    ],
)
def test_an_unknown_environment_is_one_line_with_near_names(lab, command, name, says, refused):
    options = {"eval": ["--policy", "hold"], "compare": ["--policies", "hold"]}
    said = refused([command, name, *options.get(command, [])])
    assert said.startswith(f"servogym {command}: ")
    assert says in said


def whole(**changed):
    """A task with all it needs but what is changed; None: it lacks it."""
    nothing = staticmethod(lambda *arguments: None)
    given = {
        "ID": "mylab/Part-v0", "RPDO": ("target_position",), "ACTION": action("velocity"),
        "OBSERVATION": observation("distance"), "EPISODE": episode(), "act": nothing,
        "judge": nothing, "_make": lambda self, model: linear_axis(model),
        "_begin": lambda self, options: self.place({"x": 0.2}),
    } | changed
    return type("Part", (ServoEnv,), {k: v for k, v in given.items() if v is not None})


def test_a_whole_task_can_be_made():
    assert whole()().reset(seed=1)[0].shape == (1,)


@pytest.mark.parametrize(
    "name",
    ["ID", "RPDO", "ACTION", "OBSERVATION", "EPISODE", "act", "judge", "_make", "_begin"],
)
def test_a_task_that_lacks_something_says_what(name):
    with pytest.raises(ValueError, match=rf"^task Part lacks {name}: give it [^\n]+$"):
        whole(**{name: None})()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ID", 5), ("RPDO", "target_position"), ("RPDO", 5), ("TPDO", 4), ("DRIVES", 3),
        ("ACTION", ("velocity",)), ("ACTION", observation("velocity")),
        ("OBSERVATION", np.dtype("f4")), ("OBSERVATION", action("distance")),
        ("EPISODE", np.dtype("f8")), ("EPISODE", np.dtype([("goal", "f8")])), ("act", 5),
        ("judge", "judge"), ("_make", 5), ("_make", lambda self: None),
        ("_make", lambda self, model: None), ("_make", lambda self, model: linear_axis),
        ("_begin", lambda self: None), ("_begin", lambda self, options, more: None),
    ],
)
def test_what_a_task_has_wrong_is_told(name, value):
    with pytest.raises(ValueError, match=rf"^task Part: {name} [^\n]+$"):
        whole(**{name: value})()


def test_a_policy_of_a_task_that_is_none_is_told():
    task = whole(POLICIES=("ruckig", "trapezod"))()
    with pytest.raises(
        ValueError, match=r"^task Part: POLICIES names .trapezod.: did you mean trapezoid"
    ):
        make("ruckig", task)


def test_a_task_without_an_id_is_not_registered():
    with pytest.raises(ValueError, match="task Part lacks ID"):
        register(whole(ID=None))
    with pytest.raises(ValueError, match="task Part, ID = 'a b': "):
        register(whole(ID="a b"))


def test_figures_without_a_row_are_refused(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(LinearAxisEnv, "figures", lambda self: {"beauty": 1.0})
    arguments = ["eval", "LinearAxis-v0", "--policy", "hold", "--episodes", "1"]
    assert cli.main([*arguments, "--out", str(tmp_path)]) == 2
    assert "task LinearAxisEnv: METRICS lacks beauty" in capsys.readouterr().err


# ------------------------------------------------------------------------ entry points


class Still:
    """A policy of another package."""

    TASKS = ("servogym/LinearAxis-v0",)

    def __init__(self, datasheet, seed):
        self.datasheet = datasheet

    def reset(self, observation, info):
        """Nothing."""

    def act(self, observation):
        return self.datasheet.action()


class Deaf:
    def act(self, observation):
        """Only half of a policy."""


FOLDER = load("generic").folder
HERE = __name__


@pytest.fixture
def declared(monkeypatch):
    """What packages declare, as their metadata would."""
    rows = {
        "servogym.policies": {"still": "Still", "deaf": "Deaf", "gone": "Gone", "number": "NAME"},
        "servogym.drives": {"acme": "FOLDER", "lost": "PAGES", "broken": "Gone"},
    }
    real = metadata.entry_points

    def entry_points(group="", name=None, **chosen):
        own = rows.get(group)
        if own is None:  # of others: what is imported first now may ask for all, or for a name
            asked = {"group": group, "name": name}
            return real(**chosen, **{key: value for key, value in asked.items() if value})
        return [
            metadata.EntryPoint(each, f"{HERE}:{value}", group)
            for each, value in own.items()
            if name in (None, each)
        ]

    monkeypatch.setattr(metadata, "entry_points", entry_points)


def test_a_policy_of_an_entry_point_is_one_by_its_name(declared):
    env = LinearAxisEnv()
    assert "still" in names(env)
    policy = make("still", env)
    assert policy.act(env.reset(seed=1)[0]).tolist() == [0.0]
    for name, says in (
        ("deaf", "class Deaf lacks the method reset"),
        ("gone", "its entry point .*:Gone fails"),
        ("number", "has to be a class or a function"),
        ("stil", "did you mean still"),
    ):
        with pytest.raises(ValueError, match=says):
            make(name, env)
    with pytest.raises(ValueError, match="is for servogym/LinearAxis-v0, not for servogym/Homing"):
        make("still", task("Homing-v0")())


def test_a_drive_model_of_an_entry_point_is_one_by_its_name(declared, capsys):
    assert load("acme") is load("generic")
    assert cli.main(["drives"]) == 0
    said = capsys.readouterr().out
    assert "acme" in said
    assert "broken" in said, "shown as what it is, the others too"
    with pytest.raises(ValueError, match="drive model 'lost': its entry point"):
        load("lost")
    with pytest.raises(ValueError, match=r"drive model 'broken': its entry point .*:Gone fails"):
        load("broken")


def test_near_names_of_drives_and_objects():
    with pytest.raises(ValueError, match="unknown drive model 'kollmorgen': did you mean kollm"):
        load("kollmorgen")
    with pytest.raises(SdoAbort, match="'target_positon': did you mean target_position"):
        Drive().read("target_positon")


# ------------------------------------------------------------------------ who knows whom


def test_training_knows_no_task_by_name():
    """No import from `envs.tasks` but of `fitting`, no class and no id of a task; texts may."""
    ids = {name for one in TASKS for name in (one.ID, one.ID.partition("/")[2])}
    classes = {one.__name__ for one in TASKS}
    assert TRAINING
    for path in TRAINING:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                parts = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
                assert "tasks" not in parts or "fitting" in parts, path
                assert not {alias.name for alias in node.names} & (classes | {"tasks"}), path
            if isinstance(node, ast.Import):
                assert not any(".tasks" in alias.name for alias in node.names), path
            if isinstance(node, ast.Constant):
                assert node.value not in ids, path
        if isinstance(node, ast.Attribute | ast.Name):
            name = node.attr if isinstance(node, ast.Attribute) else node.id
            assert name not in classes
