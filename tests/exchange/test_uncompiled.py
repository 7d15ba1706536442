"""A task that does not compile is told in a line: file, line, function, what was meant."""

import importlib
import itertools
import sys

import gymnasium
import pytest

from servogym.drive.kernel import jit
from servogym.training import cli

pytestmark = pytest.mark.skipif(jit.DISABLED, reason="nothing is compiled")

TASK = """
from servogym.drive.kernel.jit import block
from servogym.drive.kernel.words import Mode
from servogym.envs import METRE, ServoEnv, action, clip, episode, linear_axis
from servogym.envs import observation, register

@block
def helper(report):
    return HELPER

@block
def act(episode, action, rpdos):
    rpdos[0].target_velocity = round(METRE * action.velocity)
    ACT

@block
def judge(episode, rpdos, tpdos, observation):
    distance = episode.goal - tpdos[0].position_actual_value / METRE
    JUDGE

class WrongEnv(ServoEnv):
    ID, STEPS = "NAME/Wrong-v0", 20
    MODES = (Mode.CYCLIC_SYNC_VELOCITY, Mode.HOMING)
    RPDO, ACTION = ("target_velocity",), action("velocity")
    OBSERVATION, EPISODE = observation("distance", "velocity"), episode(("goal", "f8"))
    act, judge = staticmethod(act), staticmethod(judge)

    def _make(self, model):
        return linear_axis(model)

    def _begin(self, options):
        self.place({"x": 0.2})

register(WrongEnv)
"""
NUMBERS = itertools.count()  # an id is registered once in a process
PLACES = {"HELPER": "0.0", "ACT": "pass", "JUDGE": "pass"}


@pytest.fixture
def task(tmp_path, monkeypatch):
    """A module with a task that is wrong in one place; -> its name, and the start of the line."""
    names = []

    def task(place, text, **more):
        name = f"wrong{next(NUMBERS)}"
        names.append(name)
        source = TASK.replace("NAME", name)
        line = source[: source.index(f" {place}\n")].count("\n") + 1
        for key, usual in PLACES.items():
            source = source.replace(f" {key}\n", f" {({place: text} | more).get(key, usual)}\n")
        (tmp_path / f"{name}.py").write_text(source)
        importlib.invalidate_caches()
        return name, f"{tmp_path / name}.py, line {line}, in {place.lower()}: "

    monkeypatch.syspath_prepend(tmp_path)
    yield task
    for name in names:
        sys.modules.pop(name, None)


USE = {"JUDGE": "observation.distance = helper(tpdos)"}
NO = "it does not compile: "
WRONG = [  # place, text there, elsewhere, what is told; of a field its owner, itself, a near one
    ("JUDGE", "observation.velocty = 1.0", {}, ("observation.velocty", "velocty", "velocity")),
    ("JUDGE", "observation['velocty'] = 0", {}, ("observation['velocty']", "velocty", "velocity")),
    ("JUDGE", "x = episode.gaol", {}, ("episode.gaol", "gaol", "goal")),
    ("ACT", "rpdos[0].speed_ = 1", {}, ("rpdos[0].speed_", "speed_", "")),
    ("ACT", "x = action.velocty", {}, ("action.velocty", "velocty", "velocity")),
    ("HELPER", "report[0].statusward", USE, ("report[0].statusward", "statusward", "statusword")),
    ("HELPER", "clipp(1.0)", USE, "name 'clipp' is not defined: did you mean clip"),
    ("JUDGE", "x = open('log')", {}, f"{NO}Untyped global name 'open'"),
    ("JUDGE", "x = 'a' + distance", {}, f"{NO}No implementation of function"),
    ("JUDGE", "observation.distance = 'far'", {}, f"{NO}Cannot cast"),
    ("JUDGE", "x = clip(1.0, 2.0)", {}, f"{NO}Cannot bind"),
]


def words(says):
    """How the line goes on."""
    if isinstance(says, str):
        return says
    owner, name, meant = says
    hint = f"did you mean {meant}" if meant else "choose one of "
    return f"{owner}: there is no {name!r} here: {hint}"


def begin(env):
    env.reset(seed=1)
    env.step(env.action_space.sample())


def begin_vector(name, mode):
    gymnasium.make_vec(f"{name}:{name}/Wrong-v0", num_envs=2, vectorization_mode=mode).reset(seed=1)


@pytest.mark.parametrize(("place", "text", "more", "says"), WRONG)
def test_what_does_not_compile_is_told_where_it_stands(task, place, text, more, says):
    name, where = task(place, text, **more)
    env = importlib.import_module(name).WrongEnv()
    with pytest.raises(ValueError, match="line") as told:
        begin(env)
    assert str(told.value).startswith(where + words(says))
    assert "\n" not in str(told.value)
    assert told.value.__cause__ is told.value.__context__ is None


@pytest.mark.parametrize("mode", ["sync", "vector_entry_point"])
def test_a_vector_tells_it_as_well(task, mode):
    name, where = task(*WRONG[0][:2])
    with pytest.raises(ValueError, match=r"observation\.velocty: there") as told:
        begin_vector(name, mode)
    assert str(told.value).startswith(where)


def test_a_command_tells_it_as_well(task, capsys):
    name, where = task(*WRONG[0][:2])
    assert cli.main(["eval", f"{name}:Wrong-v0", "--policy", "hold", "--episodes", "1"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert where + words(WRONG[0][3]) in line


def test_a_task_that_is_right_runs(task):
    name, _ = task("JUDGE", "observation.distance = clip(distance)")
    env = importlib.import_module(name).WrongEnv()
    env.reset(seed=1)
    assert env.step(env.action_space.sample())[0].shape == (2,)
