"""The frame around the pages: control, state of the drive, time, and navigation."""

import inspect
import json
from collections.abc import Sequence
from typing import Any

from nicegui import app, ui

from ....drive.diagrams import MODE_ABBREVIATION, State
from ..classroom import TEACHER, Classroom, Place
from ..clock import Clock
from ..guard import LEAVE, PERSON
from ..log import Event
from .desk import Desk, in_words, refuse
from .experiments import ExperimentsPage
from .lesson import LessonPage
from .log import LogPage
from .loops import LoopsPage
from .machine import MachinePage
from .motion import MotionPage
from .objects import ObjectsPage
from .scope import ScopePage
from .state import StatePage
from .wall import KINDS, show_wall
from .widgets import (
    DARK_OR_LIGHT,
    Readout,
    Tag,
    button,
    card,
    div,
    formatted,
    lit,
    live,
    note,
    pending,
    styled,
    toggle,
    two_sided,
)

MODES = {int(mode): name for mode, name in MODE_ABBREVIATION.items()} | {0: "no mode"}
SPEEDS = (0.1, 0.25, 0.5, 1, 2, 5, 10)
SHOW = """const texts = %s;
for (const id in texts) {
  const element = document.getElementById(id);
  if (element?.firstChild) element.firstChild.nodeValue = texts[id];
}
return 1"""
# Esc closes an open menu or dialog; without one, it is the quick stop
LISTEN = """document.documentElement.lang = "en";
window.addEventListener("blur", () => emitEvent("left"));
window.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.repeat || event.isComposing) return;
  if (document.querySelector(".q-menu, .q-dialog__inner")) return;
  emitEvent("escape");
}, true)"""
TAKE_CONTROL = "Take control"
PAUSE, GO_ON = "pause", "play_arrow"  # icons
SLOWEST = 20.0  # s that a browser may take for a picture
GONE = 2.0  # s, while an axis is jogged
PAGES: Sequence[type[Any]] = (
    StatePage, MotionPage, ScopePage, MachinePage, LoopsPage, ExperimentsPage, ObjectsPage,
    LessonPage, LogPage,
)


class Shell:
    """One tab of the browser.

    Args:
        clock: runs the session.
        tab: identifier of the tab.
        kept: values that survive a reload.
        pictures: maximum number of pictures per second.
        pages: the pages, in the order of the rail.
        place: the place in a classroom whose machine is shown.
        watches: whether the tab only watches unless it takes control.
    """

    def __init__(
        self, clock: Clock, tab: str, kept: dict[str, Any], pictures: float,
        pages: Sequence[type[Any]], place: Place | None = None, watches: bool = False,
    ):
        self.clock, self.kept, self.place, self.watches = clock, kept, place, watches
        self.desk = Desk(clock, tab)
        axis = kept.get("axis")
        self.desk.axis = axis if axis in clock.session.axes else self.desk.axis
        self.dark = styled(kept.get("dark", False))
        self._header()
        self._kinds = {page.name: page for page in pages}
        self.pages: dict[str, Any] = {}
        with div("frame"):
            self._rail(pages)
            with div("content"):
                self.frames = {name: div("page", f"page-{name}") for name in self._kinds}
        self.go(kept.get("page", pages[0].name))
        ui.keyboard(self._key, ignore=["input", "select", "textarea"], repeating=False)
        ui.keyboard(self._always, ignore=[], repeating=False)
        ui.on("left", self._rest)
        ui.on("escape", self._quick_stop)
        ui.on_exception(self._broken)
        ui.run_javascript(LISTEN)
        ui.timer(1 / pictures, self.show)

    def _header(self) -> None:
        session = self.clock.session
        with ui.element("header").classes("top"):
            with div("brand"):
                Tag("h1", "servogym")
                models = {session.model(axis).name for axis in session.axes}
                title = f"{session.title} · {', '.join(sorted(models))}"
                if self.place is not None:
                    title = f"{self.place.name} · own code {self.place.code}"
                Tag("span", title, title=title)
            if len(session.axes) > 1:
                toggle(list(session.axes), self.desk.axis,
                       lambda event: self._axis(event.value), "axis", "dense")
            self.state = note("", "state", "state-chip")
            self.mode = note("", "mode-shown", "chip")
            self.position = Readout("Position", test="header-position")
            self.doing = note("", "doing", "doing")
            ui.space()
            self._time()
            self.seat = two_sided(TAKE_CONTROL, self._seat, "control", "seat")
            button("", self._theme, "theme", "icon", DARK_OR_LIGHT)
            if self.place is not None and not self.watches:
                button("", lambda: ui.navigate.to(LEAVE), "leave-class", "icon",
                       "icon=logout aria-label='Leave the classroom' title='Leave the classroom'")
            button("QUICK STOP", self._quick_stop, "quick-stop", "stop", "title='Esc'")
        with div("watching-banner", "watching") as self.banner:
            self.banner_text = ui.label("")
        with div("agent-banner", "agent") as self.agent:
            self.agent_text = ui.label("")
            button("Take back", lambda: self.desk.do(lambda s: s.release()), "take-back", "main")
        with div("lesson-banner", "lesson-now") as self.task:
            self.task_text = ui.label("")

    def _time(self) -> None:
        with div("time cluster"):
            self.pause = two_sided("", self._pause, "pause", "icon",
                                   f"icon={PAUSE} aria-label=Pause")
            step = button("", self._single, "single", "icon",
                          "icon=skip_next aria-label='One cycle' title='One position cycle'")
            self.speed = ui.select(
                {speed: f"{speed:g}×" for speed in SPEEDS}, value=self.clock.speed,
                on_change=self._speed,
            )
            self.speed.props("dense outlined options-dense data-test=speed aria-label=Speed")
            self.speed.classes("speed")
            if why := self.desk.bench.absent.get("time"):
                for made in (self.pause, step, self.speed):
                    made.props(f'disable title="{why}"')
            self.measured = note("", "measured", "quiet mono")

    def _rail(self, pages: Sequence[type[Any]]) -> None:
        self.links = {}
        with ui.element("nav").classes("rail").props("aria-label=Pages"):
            for number, page in enumerate(pages, 1):
                link = Tag(
                    "button", type="button", title=f"key {number}", data_test=f"go-{page.name}"
                )
                link.classes("link").on("click", lambda _, name=page.name: self.go(name))
                if page.name in self.desk.bench.absent:
                    link.classes("absent")
                with link:
                    ui.icon(page.icon)
                    Tag("span", page.title)
                self.links[page.name] = link

    def go(self, name: str) -> None:
        """Show a page; it is created when it is first opened."""
        if name not in self._kinds:
            name = next(iter(self._kinds))
        self.present = self.kept["page"] = name
        if name not in self.pages:
            with self.frames[name]:
                why = self.desk.bench.absent.get(name)
                kind = self._kinds[name]
                self.pages[name] = _Absent(kind.title, why) if why else kind(self.desk)
        for other, frame in self.frames.items():
            lit(frame, "open", other == name)
            lit(self.links[other], "now", other == name)
        getattr(self.pages[name], "opened", lambda: None)()

    async def _axis(self, axis: str) -> None:
        await self._rest()
        self.desk.axis = self.kept["axis"] = axis
        self.pages.clear()
        for frame in self.frames.values():
            frame.clear()
        self.go(self.present)

    def _theme(self) -> None:
        self.kept["dark"] = not self.dark.value
        self.dark.set_value(self.kept["dark"])

    def _pause(self, shown: str) -> None:
        if self._may_stop_time():
            self.clock.pause(shown == PAUSE)

    def _single(self) -> None:
        if self._may_stop_time():
            self.clock.single()

    def _speed(self) -> None:
        if self.speed.value != self.clock.speed and self._may_stop_time():
            self.clock.set_speed(self.speed.value)

    def _may_stop_time(self) -> bool:
        refuse(why := self.desk.bench.absent.get("time", ""))
        return not why and self._may()

    def _may(self) -> bool:
        if self.desk.in_control:
            return True
        ui.notify("another window has control: press Take control first", type="warning",
                  position="bottom-left")
        return False

    async def _seat(self, shown: str) -> None:
        tab = self.desk.tab
        if shown == TAKE_CONTROL:
            await self.desk.ask(lambda session: session.control.take(tab))
        else:
            await self.desk.stop(lambda session: leave(session, tab))

    async def _quick_stop(self) -> None:
        await self.desk.halt("quick_stop")

    async def _broken(self, error: Exception) -> None:
        """Report an internal error of a page in the log."""
        said = f"{type(error).__name__}: {in_words(error)}"
        await self.desk.ask(lambda session: session.tell("alarm", f"an error of the panel: {said}"))

    async def _always(self, event: Any) -> None:
        """Keys that work in a field, too: the end of jogging."""
        if (event.key.arrow_left or event.key.arrow_right) and event.action.keyup:
            await self._rest()

    async def _rest(self) -> None:
        """End jogging: the release of a key over another window is never reported."""
        if motion := self.pages.get("motion"):
            await motion.rest()

    async def _key(self, event: Any) -> None:
        held = event.modifiers
        if not event.action.keydown or held.ctrl or held.alt or held.meta:
            return
        motion = self.pages.get("motion") if self.present == "motion" else None
        sign = 1 if event.key.arrow_right else -1 if event.key.arrow_left else 0
        if motion and sign:
            await motion.run(sign)
        names = list(self._kinds)
        if event.key.number is not None and 1 <= event.key.number <= len(names):
            self.go(names[event.key.number - 1])
        elif str(event.key) == "p":
            self._pause(GO_ON if self.clock.paused else PAUSE)
        elif str(event.key) == ".":
            self._single()

    # ----------------------------------------------------------------- present

    async def show(self) -> None:
        """Show the present state."""
        self._show_drive()
        self._show_banners()
        self._show_time()
        self._messages(self.desk.shown["messages"])
        result = self.pages[self.present].show()
        if inspect.isawaitable(result):
            await result
        texts = json.dumps(pending(ui.context.client.id))
        try:  # a slow browser gets fewer pictures, not older ones
            await ui.run_javascript(SHOW % texts, timeout=GONE if self.desk.jogging else SLOWEST)
            self.desk.beat()
        except TimeoutError:
            await self._rest()  # the key may have been released meanwhile

    def _show_drive(self) -> None:
        """Show the state of the axis of this tab in the header."""
        seen = self.desk.status
        state = State(seen["state"]) if seen["state"] >= 0 else None
        name = state.name.replace("_", " ").lower() if state is not None else "state not known"
        kind = KINDS.get(state, "calm") if state is not None else "calm"
        if not seen.get("answers", True):
            name, kind = "no answer", "bad"
        self.state.set_text(name)
        for each in ("good", "bad", "calm"):
            lit(self.state, each, each == kind)
        self.mode.set_text(MODES.get(seen["mode"], f"mode {seen['mode']}"))
        unit, _ = self.desk.bench.unit(self.desk.axis)
        self.position.show(formatted(seen["position"], 0 if unit == "units" else 3), unit)
        self.doing.set_text(seen["fault"] or self.desk.shown["doing"])

    def _show_banners(self) -> None:
        """Show who commands: a window or an agent; and the present step of an exercise."""
        shown, holds = self.desk.shown, self.desk.in_control
        self.seat.set_text("In control" if holds else TAKE_CONTROL)
        lit(self.seat, "held", holds)
        self.banner.set_visibility(not holds)
        self.banner_text.set_text(
            "Another window has control; this one watches." if shown["holder"]
            else "Nobody has control; this window watches."
        )
        self.agent.set_visibility(bool(shown["agent"]))
        self.agent_text.set_text(f"{shown['agent']} has the machine.")
        lesson = shown["lesson"]
        self.task.set_visibility(lesson is not None)
        if lesson is not None:
            now = f"{lesson.step + 1}. {lesson.text}" if lesson.text else "done"
            if lesson.asks:
                now += " First answer the question on the page Lessons."
            if lesson.wrong:
                now = f"{lesson.wrong} Begin again on the page Lessons."
            self.task_text.set_text(f"{lesson.title} · {now}")

    def _show_time(self) -> None:
        """Show the speed of time."""
        clock = self.clock
        self.pause.props(f"icon={GO_ON if clock.paused else PAUSE}")
        self.speed.set_value(clock.speed)
        pulse = "paused" if clock.paused else f"{formatted(clock.achieved, 2)}× real time"
        live(self.measured, self.desk.bench.pulse() or pulse)

    def _messages(self, events: list[Event]) -> None:
        for event in events:
            if event.number > self.desk.last_message:
                self.desk.last_message = event.number
                if event.kind == "info" and not event.window:
                    ui.notify(event.text, position="bottom-left")
                elif event.kind in ("alarm", "fault"):
                    refuse("; ".join(filter(None, (event.text, event.remedy))))

    # ------------------------------------------------- tabs that open and close

    async def arrive(self) -> None:
        """Take control if nobody has it."""
        tab = self.desk.tab

        def sit(session: Any) -> None:
            if session.control.holder is None and session.seats_first and not self.watches:
                session.control.take(tab)

        await self.desk.ask(sit)
        self.desk.beat()

    def lose(self) -> None:
        """Stop jogging because the browser has disconnected."""
        if self.desk.jogging:
            self.desk.jogging = False
            axis = self.desk.axis
            self.clock.move(lambda session: session.jog(axis, 0.0), at_once=True)

    def leave(self) -> None:
        """Release control because the tab was closed."""
        self.lose()
        tab = self.desk.tab
        open_still = any(
            client.tab_id == tab for client in type(ui.context.client).instances.values()
        )
        if not open_still:
            self.clock.ask(lambda session: leave_if_gone(self.clock, session, tab))


def leave(session: Any, tab: str) -> None:
    """Release control; motions started by this window are stopped."""
    if session.control.holds(tab):
        session.control.leave(tab)
        session.abandon("nobody has control any more")


def leave_if_gone(clock: Clock, session: Any, tab: str) -> None:
    """Release control and stop the motions of a window whose browser has closed."""
    if session.control.holds(tab):
        clock.stop_motion(lambda session: leave(session, tab))


class _Absent:
    """Placeholder for a page that is not available here, with the reason."""

    def __init__(self, title: str, why: str):
        with card(title, "absent"):
            note(why, kind="prose")

    def show(self) -> None:
        """Nothing changes."""


async def build(
    clock: Clock, pictures: float, pages: Sequence[type[Any]] = PAGES,
    place: Place | None = None, watches: bool = False,
) -> None:
    """Build the pages of a tab that has just been opened; arguments as of `Shell`."""
    client = ui.context.client
    await client.connected()
    tab = str(client.tab_id)
    if watches:
        clock.session.control.named[tab] = TEACHER
    shell = Shell(clock, tab, app.storage.tab, pictures, pages, place, watches)
    await shell.arrive()
    client.on_disconnect(shell.lose)
    client.on_delete(shell.leave)
    client.on_delete(lambda: pending(client.id))


async def show_class(room: Classroom, teacher: Any, address: str) -> None:
    """Build the pages of a tab of a classroom: a pupil's machine, the wall, or a look at a place.

    Args:
        room: the classroom.
        teacher: the object that stands for the teacher in the scope of a request.
        address: address that pupils open.
    """
    request = ui.context.client.request
    place, path = request.scope[PERSON], request.scope["path"].strip("/")
    number = path.removeprefix("place/")
    if place is not teacher:
        ui.page_title(f"{place.name} · servogym")
        await build(place.clock, room.pictures, place=place)
    elif number.isdecimal() and int(number) in room.places:
        place = room.places[int(number)]
        ui.page_title(f"{place.name} · servogym classroom")
        await build(place.clock, room.pictures, place=place, watches=True)
    else:
        await show_wall(room, address)
