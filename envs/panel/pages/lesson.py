"""Lessons: a task, its present step, and what is done already."""

from collections.abc import Sequence

from nicegui import ui

from ..lessons import Lesson, Pupil
from ..session import Session
from .desk import Desk, refuse
from .widgets import Tag, button, card


class LessonPage:
    """A class room's page."""

    name, title, icon = "lessons", "Lessons", "school"

    def __init__(self, desk: Desk, lessons: Sequence[Lesson] | None = None):
        self.desk = desk
        self.lessons = list(lessons if lessons is not None else desk.clock.session.lessons)
        self._drawn: tuple[str, int, str] | None = None
        self._hinted = -1
        with ui.element("div").classes("columns lesson-columns"):
            with card("Exercises"):
                for number, lesson in enumerate(self.lessons):
                    item = Tag("button", type="button", data_test=f"lesson-{number}")
                    item.classes("lesson").on("click", lambda _, n=number: self._start(n))
                    with item:
                        Tag("b", f"{number + 1}. {lesson.title}")
                        Tag("span", lesson.about)
            with card("Exercise", "exercise"):
                self.head = ui.label("Choose an exercise.").classes("verdict")
                self.steps = ui.element("ol").classes("steps")
                with ui.element("div").classes("cluster"):
                    self.hint = button("Hint", self._hint, "hint")
                    self.again = button("Begin again", self._again, "again")
                    self.leave = button("Leave", self._leave, "leave")

    async def _start(self, number: int) -> None:
        axis, lesson = self.desk.axis, self.lessons[number]

        def begin(session: Session) -> None:
            session.pupil = None
            session.pupil = Pupil(session, axis, lesson)

        self._hinted = -1
        refuse(await self.desk.motion(begin))

    async def _again(self) -> None:
        pupil = self.desk.clock.session.pupil
        if pupil is not None and pupil.lesson in self.lessons:
            await self._start(self.lessons.index(pupil.lesson))

    async def _leave(self) -> None:
        def leave(session: Session) -> None:
            session.pupil = None

        refuse(await self.desk.command(leave))

    def _hint(self) -> None:
        lesson = self.desk.shown["lesson"]
        self._hinted = lesson[1] if lesson else -1
        self._drawn = None

    def show(self) -> None:
        """The present step."""
        at = self.desk.shown["lesson"]
        if at == self._drawn and at is not None:
            return
        if at is None and self._drawn is None:
            for made in (self.hint, self.again, self.leave):
                made.set_visibility(False)
            return
        self._drawn = at
        self.steps.clear()
        for made in (self.hint, self.again, self.leave):
            made.set_visibility(at is not None)
        pupil = self.desk.clock.session.pupil
        if at is None or pupil is None:
            self.head.set_text("Choose an exercise.")
            return
        steps = pupil.lesson.steps
        self.head.set_text(at[0] + (" · done" if at[1] >= len(steps) else ""))
        self.hint.set_visibility(at[1] < len(steps) and bool(steps[at[1]].hint))
        with self.steps:
            for number, step in enumerate(steps[: at[1] + 1]):
                done = number < at[1]
                with Tag("li", data_test=f"step-{number}").classes("done" if done else "due"):
                    Tag("span", step.text)
                    if done:
                        Tag("small", f"done after {pupil.times[number]:.1f} s")
                    elif self._hinted == number:
                        Tag("small", step.hint)
