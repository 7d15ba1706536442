"""Exercises of the course in a session: a fresh machine, judged cycle by cycle."""

from typing import NamedTuple

from ..course.attempt import Attempt
from ..course.exercise import Exercise
from .session import Session


class Progress(NamedTuple):
    """How far a pupil is, as pages show it.

    Args:
        title: of the exercise.
        step: number of the present step.
        text: of the step; empty when all is done.
        wrong: why the exercise is lost, empty if it is not.
        hints: number of hints given for the step.
        asks: whether the step waits for a prediction.
    """

    title: str
    step: int
    text: str
    wrong: str
    hints: int
    asks: bool


class Pupil:
    """An exercise that is being done on an axis of a session.

    The machine begins as it was when the panel was started: what was changed since is lost.

    Args:
        session: whose drive is judged.
        axis: which of them.
        exercise: to be done.

    Raises:
        ValueError: the machine cannot begin as the exercise says.
    """

    def __init__(self, session: Session, axis: str, exercise: Exercise):
        session.release()
        session.machine.restore(session.fresh)
        self.exercise = exercise
        self.attempt = Attempt(
            exercise, session.machine, axis, lambda text: session.tell("done", text)
        )

    @property
    def present(self) -> Progress:
        """How far it is."""
        attempt = self.attempt
        step = attempt.present
        return Progress(
            self.exercise.title, attempt.step, step.text if step else "", attempt.wrong,
            len(attempt.hinted), attempt.asks,
        )  # fmt: skip

    def look(self) -> None:
        """Judge the cycle that has passed."""
        self.attempt.look()
