"""Lessons: the exercises of a course, the steps of one of them, hints and mistakes."""

from nicegui import ui

from ..lessons import Progress, begin, leave
from ..session import Session
from .desk import Desk, refuse
from .widgets import Tag, button, card, div, note


class LessonPage:
    """Page with the exercises of a course."""

    name, title, icon = "lessons", "Lessons", "school"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.lessons = list(desk.bench.lessons)
        self._drawn: Progress | None = None
        with div("columns lesson-columns"):
            with card("Exercises"):
                for number, lesson in enumerate(self.lessons):
                    item = Tag("button", type="button", data_test=f"lesson-{number}")
                    item.classes("lesson").on("click", lambda _, n=number: self._start(n))
                    with item:
                        Tag("b", f"{number + 1}. {lesson.title}")
                        Tag("small", lesson.name).classes("mono")  # the name in the course's pages
                        Tag("span", lesson.about)
            with card("Exercise", "exercise"):
                self.head = note("Choose an exercise.", kind="verdict")
                self.lost = note("", "lesson-lost", "lost").props("role=alert")
                self.steps = ui.element("ol").classes("steps")
                with div("cluster"):
                    self.hint = button("Hint", self._hint, "hint")
                    self.again = button("Begin again", self._again, "again")
                    self.leave = button("Leave", lambda: desk.do(leave), "leave")
                    self.next = button("Next exercise", self._next, "next", "main")

    async def _start(self, number: int) -> None:
        axis, lesson = self.desk.axis, self.lessons[number]
        refuse(await self.desk.motion(lambda session: begin(session, axis, lesson)))

    async def _again(self) -> None:
        pupil = self.desk.bench.pupil
        if pupil is not None and pupil.exercise in self.lessons:
            await self._start(self.lessons.index(pupil.exercise))

    async def _next(self) -> None:
        if (number := self._after(self.desk.shown["lesson"])) is not None:
            await self._start(number)

    def _after(self, at: Progress | None) -> int | None:
        """Number of the exercise that follows a finished one."""
        if at is None or at.text or at.wrong or at.exercise not in self.lessons:
            return None
        number = self.lessons.index(at.exercise) + 1
        return number if number < len(self.lessons) else None

    async def _hint(self) -> None:
        def hint(session: Session) -> None:
            if session.pupil is not None:
                session.pupil.hint()

        await self.desk.do(hint)

    async def _predict(self, option: int) -> None:
        def predict(session: Session) -> None:
            if session.pupil is not None and session.pupil.attempt.asks:
                session.pupil.predict(option)

        await self.desk.do(predict)

    def show(self) -> None:
        """Show the present step."""
        at = self.desk.shown["lesson"]
        if at == self._drawn and at is not None:
            return
        for made in (self.hint, self.again, self.leave, self.lost):
            made.set_visibility(at is not None)
        self.next.set_visibility(self._after(at) is not None)
        if at is None and self._drawn is None:
            return
        self._drawn = at
        self.steps.clear()
        if at is None:
            self.head.set_text("Choose an exercise.")
            return
        steps = at.exercise.steps
        self.head.set_text(at.title + (" · done" if at.step >= len(steps) else ""))
        self.lost.set_visibility(bool(at.wrong))
        self.lost.set_text(f"{at.wrong} Begin again with a fresh machine.")
        more = at.step < len(steps) and len(at.hinted) < len(steps[at.step].hints)
        self.hint.set_visibility(more and not at.wrong)
        with self.steps:
            for number, step in enumerate(steps[: at.step + 1]):
                done = number < at.step
                with Tag("li", data_test=f"step-{number}").classes("done" if done else "due"):
                    Tag("span", step.text)
                    if done:
                        Tag("small", f"done after {at.times[number]:.1f} s")
                        if step.predict is not None:
                            Tag("small", step.predict.why)
                        continue
                    for hint in at.hinted:
                        Tag("small", hint)
                    if step.predict is not None:
                        Tag("small", f"First predict: {step.predict.question}")
                        for option, text in enumerate(step.predict.options if at.asks else ()):
                            button(text, lambda n=option: self._predict(n), f"option-{option}")
