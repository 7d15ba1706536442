"""The memory of the scope: every sample of some channels, and a trigger that evaluates each one.

The ring buffer holds the last samples at the full rate. A page gets a window of them with a limited
number of points: the smallest and the largest value of each stretch, so that no peak is lost.
"""

from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from ...drive.trace import Edge, Trigger, Watch
from .log import table

MOST_CHANNELS = 8
DEPTH = 120_000  # samples: two minutes at 1 kHz, 7.7 MB with all channels
SET_UP = {"channels", "run", "span", "before", "trigger"}
POINTS = 900  # in a picture


class Run(IntEnum):
    """The behaviour of the scope after its trigger event, when the window is full."""

    ROLL = 0  # there is no trigger, the newest sample is at the right
    NORMAL = 1  # show it, wait for the next one
    SINGLE = 2  # show it and stop


class Window(NamedTuple):
    """The content of a picture."""

    number: int  # of the sample behind the last one shown
    time: np.ndarray  # s, of each point, 0 at the trigger event or at the newest sample
    values: np.ndarray  # (channels, points)
    state: str  # rolling, waiting, filling, triggered, stopped


class Recorder:
    """Samples channels.

    Args:
        reader: returns the function that reads a channel. Raises ValueError for an unknown one.
        unit_of: returns the unit of a channel.
        period: time between two samples (s).
        channels: names of 1..8 channels.
        depth: number of samples that are kept.

    Raises:
        ValueError: an unknown channel, none, or too many.
    """

    def __init__(
        self, reader: Callable[[str], Callable[[], float]], unit_of: Callable[[str], str],
        period: float, channels: Sequence[str], depth: int = DEPTH,
    ) -> None:
        self._reader, self._unit_of, self.period, self.depth = reader, unit_of, period, depth
        self.run = Run.ROLL
        self.trigger: Trigger | None = None
        self.span, self.before = 2.0, 0.25  # s; the share of it before the event
        self.frozen = False
        self.choose(channels)

    def choose(self, channels: Sequence[str]) -> None:
        """Change channels and clear the memory. Raises ValueError without changing anything."""
        names = tuple(dict.fromkeys(channels))
        if not 1 <= len(names) <= MOST_CHANNELS:
            raise ValueError(f"{len(names)} channels: choose 1..{MOST_CHANNELS}")
        self._readers = [self._reader(name) for name in names]
        self.channels = names
        self.units = {name: self._unit_of(name) for name in names}
        # filled, so that all of the memory is allocated now and does not grow for minutes
        self._ring = np.full((len(names), self.depth), np.nan)
        self._times = np.full(self.depth, np.nan)
        self.clear()

    def clear(self) -> None:
        """Forget the samples."""
        self.count = 0
        self.arm()

    def arm(self) -> None:
        """Arm the trigger."""
        self._watch = Watch(self.trigger) if self.trigger else None
        self._watched = self._reader(self.trigger.channel) if self.trigger else None
        self._event: int | None = None  # sample of the event that is being filled
        self._armed = self.count
        self._shown: tuple[int, int, int] | None = None  # begin, event, end of the captured window
        self._captured: tuple[np.ndarray, np.ndarray] | None = None
        self.captures = 0
        self.frozen = False

    def set_trigger(
        self, run: Run, channel: str = "", edge: Edge = Edge.RISING, level: float = 0.0
    ) -> None:
        """Set the trigger, or roll. Raises ValueError for an unknown channel or level."""
        if run is not Run.ROLL:
            self._reader(channel)
            if not abs(level) < 1e12:
                raise ValueError(f"level {level} is out of range -1e12..1e12")
        self.run = run
        self.trigger = Trigger(channel, edge, level) if run is not Run.ROLL else None
        self.arm()

    def set_window(self, span: float, before: float) -> None:
        """Set the length of a picture (s) and the share of it before the trigger event.

        Raises ValueError: longer than the memory, shorter than ten samples, or no valid share.
        """
        longest = self.depth * self.period
        if not 10 * self.period <= span <= longest:
            raise ValueError(f"window {span:g} s is out of range {10 * self.period:g}..{longest:g}")
        if not 0.0 <= before <= 0.95:
            raise ValueError(f"pre-trigger {before * 100:g} % is out of range 0..95")
        self.span, self.before = span, before
        if self.trigger:
            self.arm()

    @property
    def needed(self) -> tuple[str, ...]:
        """The channels, and that of the trigger."""
        watched = (self.trigger.channel,) if self.trigger else ()
        return tuple(dict.fromkeys((*self.channels, *watched)))

    # ------------------------------------------------------------------ samples

    def sample(self, time: float) -> None:
        """Take one sample at `time` (s)."""
        at = self.count % self.depth
        self._times[at] = time
        for row, read in enumerate(self._readers):
            self._ring[row, at] = read()
        number, self.count = self.count, self.count + 1
        if self._watch is None or self._watched is None or self.frozen:
            return
        event = self._watch.event(self._watched())
        if self._event is None:
            enough = number - self._armed >= self._samples_before
            if event and enough and not (self.run is Run.SINGLE and self.captures):
                self._event = number
        elif number - self._event >= self._samples - self._samples_before - 1:
            self._capture()

    @property
    def _samples(self) -> int:
        return max(min(round(self.span / self.period), self.depth), 2)

    @property
    def _samples_before(self) -> int:
        return min(round(self.span * self.before / self.period), self._samples - 1)

    def _capture(self) -> None:
        assert self._event is not None
        begin = self._event - self._samples_before
        places = np.arange(begin, begin + self._samples) % self.depth
        self._captured = self._times[places], self._ring[:, places]
        self._shown = begin, self._event, begin + self._samples
        self._event, self._armed = None, self.count
        self.captures += 1
        if self.run is Run.SINGLE:
            self.frozen = True

    def freeze(self, frozen: bool) -> None:
        """Freeze the picture while samples continue, or release it."""
        if frozen and self._captured is None:
            self._captured = times, _ = self._latest()
            self._shown = self.count - len(times), self.count - 1, self.count
        if not frozen:
            self.arm()
        self.frozen = frozen

    # ----------------------------------------------------------------- pictures

    @property
    def state(self) -> str:
        """The state of the scope in one word."""
        if self.frozen:
            return "stopped"
        if self.trigger is None:
            return "rolling"
        if self._event is not None:
            return "filling"
        return "triggered" if self.captures else "waiting"

    def view(self, points: int = POINTS) -> Window:
        """The present picture, with at most `points` of each channel."""
        if self._captured is not None and self._shown is not None:
            begin, event, end = self._shown
            times, values = self._captured
            return self._window(times, values, times[event - begin], begin, end, points)
        times, values = self._latest()
        if len(times) < 2:
            return Window(self.count, np.zeros(0), np.zeros((len(self.channels), 0)), self.state)
        begin = self.count - len(times)
        return self._window(times, values, times[-1], begin, self.count, points)

    def _latest(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and values of the last samples, as many as a picture shows."""
        number = min(self._samples, self.count, self.depth)
        places = np.arange(self.count - number, self.count) % self.depth
        return self._times[places], self._ring[:, places]

    def _window(
        self, times: np.ndarray, values: np.ndarray, zero: float, begin: int, end: int, points: int
    ) -> Window:
        stretch = -(-self._samples // max(points // 2, 1))
        if stretch > 2:  # stretches count from the very first sample, so that pictures stand still
            cut = -begin % stretch
            usable = (values.shape[1] - cut) // stretch * stretch
            if usable:
                whole = values[:, cut : cut + usable].reshape(len(values), -1, stretch)
                low, high = whole.min(axis=2), whole.max(axis=2)
                values = np.stack((low, high), axis=2).reshape(len(values), -1)
                firsts = times[cut : cut + usable : stretch]
                halfs = times[cut + stretch // 2 : cut + usable : stretch]
                times = np.stack((firsts, halfs), axis=1).ravel()
        return Window(end, times - zero, values, self.state)

    def set_up(self) -> dict[str, Any]:
        """Channels, trigger and window, as `use` takes them."""
        event = self.trigger
        trigger = event and {
            "channel": event.channel, "edge": int(event.edge), "level": event.level
        }
        return {"channels": list(self.channels), "run": int(self.run), "span": self.span,
                "before": self.before, "trigger": trigger}

    def use(self, set_up: Mapping[str, Any]) -> None:
        """Apply a set-up. Raises ValueError for an invalid one without changing anything."""
        before = self.set_up()
        try:
            self._use(set_up)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            self._use(before)
            if isinstance(error, ValueError):
                raise
            raise ValueError(f"this is not a set-up of the scope: {error!r}") from None

    def _use(self, set_up: Mapping[str, Any]) -> None:
        if unknown := {*set_up} - SET_UP:
            raise ValueError(f"a set-up has no {', '.join(sorted(unknown))}")
        trigger = set_up["trigger"] or {"channel": "", "edge": 0, "level": 0.0}
        self.choose([str(name) for name in set_up["channels"]])
        self.set_window(float(set_up["span"]), float(set_up["before"]))
        self.set_trigger(Run(set_up["run"]), str(trigger["channel"]), Edge(trigger["edge"]),
                         float(trigger["level"]))

    def csv(self, shown: Mapping[str, tuple[float, str]] | None = None) -> str:
        """All samples of the picture as a table.

        Args:
            shown: by channel, a factor for its values and the resulting unit.
        """
        times, values = self._latest() if self._captured is None else self._captured
        kept = {name: (1.0, unit) for name, unit in self.units.items()} | dict(shown or {})
        factors = np.array([[kept[name][0]] for name in self.channels])
        units = (f"{name} ({kept[name][1]})" if kept[name][1] else name for name in self.channels)
        samples = zip(times.tolist(), (values * factors).T.tolist(), strict=True)
        return table([
            ["time (s)", *units],
            *([f"{time:.6f}", *(f"{value:.9g}" for value in column)] for time, column in samples),
        ])
