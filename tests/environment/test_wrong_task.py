"""A class of a task that is written wrong is refused in words, before anything runs."""

import math

import gymnasium
import pytest

from servogym.envs import register
from servogym.envs.engine.checks import words
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training.evaluate.metrics import metrics


def written(**attributes):
    return type("WrongEnv", (LinearAxisEnv,), {"ID": "test/Wrong-v0", **attributes})


@pytest.mark.parametrize(
    ("attributes", "says"),
    [
        ({"STEPS": math.nan}, r"task WrongEnv: STEPS = nan must be a whole number 1\.\."),
        ({"STEPS": 0}, "task WrongEnv: STEPS = 0 must be a whole number"),
        ({"STEPS": "200"}, "task WrongEnv: STEPS = '200' must be a whole number"),
        ({"MODES": ("csv",)}, r"task WrongEnv: MODES = \('csv',\): give members of Mode"),
        ({"MODES": (9,)}, r"task WrongEnv: MODES = \(9,\): give members of Mode"),
    ],
)
def test_steps_and_modes_that_are_none(attributes, says):
    with pytest.raises(ValueError, match=says):
        register(written(**attributes))
    assert "test/Wrong-v0" not in gymnasium.registry


@pytest.mark.parametrize("steps", [0, -1, 1.5, "200", True, None])
def test_steps_that_are_none_are_refused_where_a_task_is_made_too(steps):
    with pytest.raises(ValueError, match=r"task WrongEnv: STEPS = |task WrongEnv lacks STEPS"):
        written(STEPS=steps)()


def test_an_unknown_argument_reads_as_pythons_own_error():
    """torchrl 0.14.1 tries `frameskip`, and leaves it out where these words are in the error."""
    for make in (
        lambda: LinearAxisEnv(frameskip=1),
        lambda: gymnasium.make("servogym.envs:servogym/LinearAxis-v0", frameskip=1),
    ):
        with pytest.raises(TypeError) as caught:
            make()
        assert "unexpected keyword argument 'frameskip'" in str(caught.value)
        assert words(caught.value).startswith("LinearAxisEnv has no argument 'frameskip': ")


def test_a_metric_that_is_none():
    with pytest.raises(ValueError, match=r"METRIC = 'setling_time' is unknown: did you mean set"):
        metrics(written(METRIC="setling_time"))
