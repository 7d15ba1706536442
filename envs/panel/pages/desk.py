"""What one tab of the browser has: its axis, its right to command, its way to the session."""

import asyncio
from collections.abc import Callable
from typing import Any

from nicegui import ui

from ...engine.machine import Machine
from ..bench import ENDED, Bench
from ..clock import Clock

Request = Callable[[Any], Any]  # of the bench, or of the session where a page needs one


class Desk:
    """A tab in front of a session.

    Args:
        clock: that runs the session.
        tab: its own text, the same after a reload.
    """

    def __init__(self, clock: Clock, tab: str):
        self.clock, self.tab = clock, tab
        self.axis = clock.session.axes[0]
        self.jogging = False
        self.told = clock.shown["messages"][-1][0] if clock.shown["messages"] else 0

    @property
    def shown(self) -> dict[str, Any]:
        """All there is to see of now."""
        return self.clock.shown

    @property
    def seen(self) -> dict[str, Any]:
        """The same of the axis of this tab."""
        return self.clock.shown["axes"][self.axis]

    @property
    def bench(self) -> Bench:
        """For what does not change while it runs, such as models and units."""
        return self.clock.session

    @property
    def machine(self) -> Machine:
        """The machine, for pages that need one in this process."""
        return self.clock.session.machine

    @property
    def in_control(self) -> bool:
        """Whether this tab commands."""
        return self.shown["holder"] == self.tab

    async def ask(self, request: Request) -> Any:
        """What a session says; for looking only."""
        return await asyncio.wrap_future(self.clock.ask(request))

    async def command(self, request: Request) -> Any:
        """Let the session do something that takes no time; words, where it is refused."""

        def checked(session: Bench) -> Any:
            session.control.check(self.tab)
            return request(session)

        return await self._told(self.clock.ask(checked))

    async def motion(self, motion: Request, *, at_once: bool = False) -> Any:
        """Let the session carry out a motion, as `Clock.move` does; words, where it fails."""
        if not self.in_control:  # a motion under way is not ended by who may not command
            return await self.command(lambda session: "")

        def checked(session: Bench) -> Any:
            session.control.check(self.tab)
            return motion(session)

        return await self._told(self.clock.move(checked, at_once=at_once))

    async def _told(self, future: Any) -> Any:
        try:
            return await asyncio.wrap_future(future)
        except (ValueError, RuntimeError) as error:
            return str(error)


def over(words: Any) -> bool:
    """Whether a motion was ended by another command: who gave it knows."""
    return words == "ended" or str(words).endswith(ENDED)


def refuse(words: Any) -> None:
    """Show why something was refused; nothing where it was not."""
    if words and not over(words):
        ui.notify(str(words), type="negative", position="bottom-left", multi_line=True)
