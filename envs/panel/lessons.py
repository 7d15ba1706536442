"""Exercises of the course in a session: a fresh machine, judged cycle by cycle."""

from typing import NamedTuple

from ..course.attempt import Attempt
from ..course.exercise import Exercise
from .journal import Journal
from .session import Session


class Progress(NamedTuple):
    """The progress of a pupil at one instant, as pages show it.

    Args:
        exercise: the present exercise.
        step: number of the present step.
        text: text of the step; empty after the last one.
        wrong: why the exercise has failed; empty if it has not.
        times: when each finished step was done (s since the exercise began).
        hinted: hints given for the step.
        used: number of hints given for all steps.
        asks: whether the step waits for a prediction.
    """

    exercise: Exercise
    step: int
    text: str
    wrong: str
    times: tuple[float, ...]
    hinted: tuple[str, ...]
    used: int
    asks: bool

    @property
    def title(self) -> str:
        """Title of the exercise."""
        return self.exercise.title

    @property
    def steps(self) -> int:
        """Number of steps of the exercise."""
        return len(self.exercise.steps)


class Pupil:
    """An exercise under way on an axis of a session.

    The machine begins in the state that it had when the panel was started; later changes are lost.

    Args:
        session: the session with the machine.
        axis: the axis that is judged.
        exercise: the exercise.

    Raises:
        ValueError: the machine cannot begin as the exercise demands.
    """

    def __init__(self, session: Session, axis: str, exercise: Exercise):
        session.release()
        if session.pupil is not None:
            session.pupil.end()
        session.pupil, self._session, self._ended = None, session, False
        session.restore(session.fresh)
        session.delay = 0.0
        self.exercise, self.axis = exercise, axis
        self.attempt = Attempt(
            exercise, session.machine, axis, lambda text: session.tell("done", text)
        )
        self.journal = session.journal = Journal()

    @property
    def present(self) -> Progress:
        """The present progress."""
        attempt = self.attempt
        step = attempt.present
        return Progress(
            self.exercise, attempt.step, step.text if step else "", attempt.wrong,
            tuple(attempt.times), attempt.hinted, attempt.hints, attempt.asks,
        )

    @property
    def over(self) -> bool:
        """Whether the exercise has ended, done or failed."""
        return self.attempt.done or bool(self.attempt.wrong)

    def look(self) -> None:
        """Judge the cycles that have passed."""
        if not self._ended:
            self.attempt.look()
            if self.over:
                self.end()

    def end(self) -> None:
        """Report the end of the attempt to the session; once."""
        if not self._ended:
            self._ended, self._session.journal = True, None
            self._session.attempted(self)

    def hint(self) -> str:
        """Return the next hint and count it."""
        self.journal.enter("hint")
        return self.attempt.hint()

    def predict(self, option: int) -> bool:
        """Answer the question of the step. Raises ValueError if there is none."""
        self.journal.enter("predict", option)
        return self.attempt.predict(option)

    def lose(self, why: str) -> None:
        """End the exercise; finished steps remain recorded."""
        if not self.over:
            self.journal.enter("lose", why)
            self.attempt.lose(why)
            self.end()


def begin(session: Session, axis: str, exercise: Exercise) -> None:
    """Begin an exercise on an axis of a session. Raises ValueError if the machine cannot."""
    session.pupil = Pupil(session, axis, exercise)


def leave(session: Session) -> None:
    """Leave the exercise; the machine stays as it is."""
    if session.pupil is not None:
        session.pupil.end()
        session.pupil = None
