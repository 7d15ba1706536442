"""Episodes on drives of a bus: a policy thinks beside the exchange, which waits for it no longer.

The policy has a thread of its own. An action that has not come within its patience is replaced by
standing still; a few of these in a row stop the drives, as does whatever the policy raises or
returns that is no action.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

import numpy as np

from ..exchange import fields
from ..exchange.envelope import Stopped
from ..exchange.over_port import PortLine
from .servo_env import ServoEnv

LATE = 3  # actions that have not come, one after the other, until the drives are stopped


class Played(NamedTuple):
    """What an episode brought."""

    returned: float  # sum of its rewards
    steps: int
    late: int  # actions that came too late
    info: dict[str, Any]  # of its end


class _Mind:
    """A policy in a thread of its own."""

    def __init__(self, act: Callable[[np.ndarray], Any]):
        self._act = act
        self._seen: SimpleQueue[np.ndarray] = SimpleQueue()
        self._said: SimpleQueue[tuple[Any, BaseException | None]] = SimpleQueue()
        self.thinks = False
        threading.Thread(target=self._think, name="servogym policy", daemon=True).start()

    def _think(self) -> None:
        while True:
            seen = self._seen.get()
            try:
                self._said.put((self._act(seen), None))
            except BaseException as error:  # an exit of its own as well
                self._said.put((None, error))

    def ask(self, seen: np.ndarray, patience: float) -> Any:
        """An action, None where none has come in time. Raises Stopped for what it raised."""
        if not self.thinks:
            self._seen.put(seen)
        try:
            action, error = self._said.get(timeout=patience)
        except Empty:
            self.thinks = True
            return None
        late, self.thinks = self.thinks, False
        if error is not None:
            raise Stopped("", f"the policy raised {type(error).__name__}: {error}") from error
        return None if late else (action,)


@contextmanager
def _guarded(line: PortLine) -> Iterator[None]:
    """Whatever ends a step stops the drives first, and is named."""
    try:
        yield
    except Stopped as stopped:
        raise line.stop(stopped) from stopped.__cause__
    except (Exception, KeyboardInterrupt) as error:
        name = "Ctrl-C" if isinstance(error, KeyboardInterrupt) else f"{error}"
        raise line.stop(Stopped("", name)) from error


def play(
    env: ServoEnv,
    act: Callable[[np.ndarray], Any],
    episodes: int,
    *,
    begin: Callable[[np.ndarray, dict[str, Any]], object] | None = None,
    patience: float | None = None,
    slow: float = 1.0,
    seed: int | None = None,
) -> list[Played]:
    """Play episodes on an environment whose drives are on a bus.

    Args:
        env: made with ``port``.
        act: observation to action.
        episodes: how many.
        begin: is told the first observation and info of each.
        patience: for an action (s); the step time if not given.
        slow: share of each action that is taken, above 0, at most 1.
        seed: of the first episode; the next ones have the next.

    Raises:
        ValueError: the environment is not on a bus.
        Stopped: the guard, the bus, the policy or Ctrl-C ended it; the drives have been stopped.
    """
    line = env.line
    if not isinstance(line, PortLine):
        raise ValueError("this environment has no drives on a bus: make it with port=...")
    mind, played = _Mind(act), []
    hold = np.array([env.HOLD.get(name, 0.0) for name in fields.names(env.ACTION)])
    with _guarded(line):
        for episode in range(episodes):
            seen, info = env.reset(seed=None if seed is None else seed + episode)
            if begin is not None:
                begin(seen, info)
            returned, late, running, ended, steps = 0.0, 0, 0, False, 0
            while not ended and steps < env.STEPS:
                said = mind.ask(seen, patience or env.step_time)
                running = 0 if said else running + 1
                late += said is None
                if running >= LATE:
                    raise Stopped("", f"the policy is late: {LATE} actions have not come")
                action = said[0] if said else hold
                if slow != 1.0:
                    action = slow * np.asarray(action)
                seen, reward, ended, _, info = env.step(action)
                returned, steps = returned + reward, steps + 1
            played.append(Played(returned, steps, late, info))
    return played
