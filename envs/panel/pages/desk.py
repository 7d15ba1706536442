"""A tab of the browser: its axis, its right to command, and its access to the session."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any

from nicegui import ui

from ....drive.master import ServoError
from ....drive.objects.abort import SdoAbort
from ..bench import ENDED, Bench, words
from ..clock import Clock

Request = Callable[[Any], Any]  # of the bench, or of the session where a page needs one
REFUSED = (ServoError, SdoAbort, ValueError, RuntimeError, OSError, ImportError)
HEAVY = asyncio.Semaphore(1)  # measurements on copies run one at a time, so that time can go on


async def beside(work: Callable[..., Any], *arguments: Any) -> Any:
    """Run long work on a copy in a thread of its own, one at a time for all sessions."""
    async with HEAVY:
        return await asyncio.to_thread(work, *arguments)


class Desk:
    """A tab that shows and commands a session.

    Args:
        clock: runs the session.
        tab: identifier of the tab, which survives a reload.
    """

    def __init__(self, clock: Clock, tab: str):
        self.clock, self.tab = clock, tab
        self.axis = clock.session.axes[0]
        self.jogging = False
        self.last_message = clock.shown["messages"][-1][0] if clock.shown["messages"] else 0

    @property
    def shown(self) -> dict[str, Any]:
        """The present state of the session."""
        return self.clock.shown

    @property
    def status(self) -> dict[str, Any]:
        """The present state of the axis of this tab."""
        return self.clock.shown["axes"][self.axis]

    @property
    def bench(self) -> Bench:
        """The bench, for constants such as models and units."""
        return self.clock.session

    @property
    def in_control(self) -> bool:
        """Whether this tab commands."""
        return self.shown["holder"] == self.tab

    def beat(self) -> None:
        """Note that this tab is alive."""
        self.bench.control.beat(self.tab, time.monotonic())

    # ------------------------------------------------- requests, with their answer

    async def ask(self, request: Request) -> Any:
        """Return the answer of the session to a request that only reads."""
        return await asyncio.wrap_future(self.clock.ask(request))

    async def command(self, request: Request) -> Any:
        """Have the session do something that takes no time; -> the reason of a refusal."""
        return await self.tried(self.clock.ask(self._checked(request)))

    async def motion(self, motion: Request, *, at_once: bool = False) -> Any:
        """Have the session carry out a motion, as `Clock.move` does; -> the reason of a failure."""
        if barred := await self.barred():  # a tab that may not command ends no motion
            return barred
        return await self.tried(self.clock.move(self._checked(motion), at_once=at_once))

    async def stop(self, stop: Request) -> Any:
        """Have the session carry out a stop at once; every tab may."""
        return await self.tried(self.clock.stop_motion(self._signed(stop)))

    async def barred(self) -> Any:
        """The reason why this tab may not command; empty if it may.

        The session is asked if the last picture, which may be old, shows another tab in control.
        """
        return "" if self.in_control else await self.command(lambda session: "")

    async def tried(self, work: Awaitable[Any] | Future[Any]) -> Any:
        """Return the result of some work, or a `Refusal`: the errors of all pages end here."""
        try:
            return await (asyncio.wrap_future(work) if isinstance(work, Future) else work)
        except REFUSED as error:
            return Refusal(in_words(error))

    # ------------------------------------------- requests whose refusal is shown here

    async def do(self, request: Request) -> None:
        """As `command`; a refusal is shown."""
        refuse(await self.command(request))

    async def go(self, what: str, *arguments: Any, at_once: bool = False) -> None:
        """As `motion`, by the name of a method of the session, for the axis of this tab."""
        axis = self.axis
        refuse(await self.motion(lambda s: getattr(s, what)(axis, *arguments), at_once=at_once))

    async def halt(self, what: str, *axis: str) -> None:
        """As `stop`, by the name of a method of the session, for one axis or for all."""
        refuse(await self.stop(lambda session: getattr(session, what)(*axis)))

    # ---------------------------------------------------------------------------------

    def _checked(self, request: Request) -> Request:
        """Wrap a request so that it is refused unless this tab has control."""
        self.beat()
        signed = self._signed(request)

        def checked(session: Bench) -> Any:
            session.control.check(self.tab)
            return signed(session)

        return checked

    def _signed(self, request: Request) -> Request:
        """Wrap a request so that the log shows the name of this window."""

        def signed(session: Bench) -> Any:
            control = session.control
            control.window = control.name(self.tab)
            try:
                return request(session)
            finally:
                control.window = ""

        return signed


class Refusal(str):
    """The reason for a refusal."""


def in_words(error: BaseException) -> str:
    """Format an error for the user."""
    if isinstance(error, ServoError):
        return "; ".join(filter(None, words(error)))
    return " ".join(str(error).split()) or type(error).__name__


def over(words: Any) -> bool:
    """Whether a motion was ended by another command, which needs no message."""
    return words == "ended" or str(words).endswith(ENDED)


def refuse(words: Any) -> None:
    """Show the reason for a refusal; nothing if the text is empty."""
    if words and not over(words):
        ui.notify(str(words), type="negative", position="bottom-left", multi_line=True)
