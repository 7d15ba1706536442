"""The two functions of a task, which see one world, over the rows of a batch: on cores and a GPU.

A row whose world is 0 belongs to an episode that waits, and is left out. Before `judge` an episode
has the cost every task has, the share of the step at an internal limit, and ends where a drive is
in a fault; the task may say otherwise.
"""

import functools
from collections.abc import Callable
from typing import Any

from ...drive.kernel.jit import block, entry
from .faces import faulted, limited


def _compiled(function: Any) -> Any:
    """The function of a task, compiled also where its author has left ``@block`` out."""
    return function if hasattr(function, "py_func") else block(function)


@functools.cache
def acting(act: Callable[..., None]) -> Any:
    """A task's ``act(episode, action, rpdos)`` over ``(worlds, episodes, actions, rpdos)``."""
    act = _compiled(act)

    @entry
    def act_on_each(worlds, episodes, actions, rpdos):
        for w in range(len(worlds)):
            if worlds[w] != 0:
                episode = episodes[w]
                episode._world = worlds[w]
                act(episode, actions[w], rpdos[w])
                episode._world = 0

    return act_on_each


@functools.cache
def judging(judge: Callable[..., None]) -> Any:
    """A task's ``judge(episode, rpdos, tpdos, observation)`` over arrays of these and worlds."""
    judge = _compiled(judge)

    @entry
    def judge_each(worlds, episodes, rpdos, tpdos, observations):
        for w in range(len(worlds)):
            if worlds[w] != 0:
                episode = episodes[w]
                episode._world = worlds[w]
                episode.cost = limited(episode)
                episode._terminated = faulted(tpdos[w])
                judge(episode, rpdos[w], tpdos[w], observations[w])
                episode._world = 0

    return judge_each
