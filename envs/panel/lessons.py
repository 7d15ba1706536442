"""Exercises of the course in a session: a fresh machine, judged cycle by cycle."""

from typing import NamedTuple

from ..course.attempt import Attempt
from ..course.exercise import Exercise
from .journal import Journal
from .session import Session


class Progress(NamedTuple):
    """How far a pupil is, as pages show it: all of one instant, whatever begins meanwhile.

    Args:
        exercise: that is being done.
        step: number of the present step.
        text: of the step; empty when all is done.
        wrong: why the exercise is lost, empty if it is not.
        times: of the steps that are done (s since the exercise began).
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
        if session.pupil is not None:
            session.pupil.end()
        session.pupil, self._session, self._told = None, session, False
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
        if not self._told:
            self.attempt.look()
            self._tell()

    def _tell(self) -> None:
        if self.over and not self._told:
            self.end()

    def end(self) -> None:
        """Report the end of the attempt once to the keeper of results."""
        if not self._told:
            self._told, self._session.journal = True, None
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
            self._tell()


def begin(session: Session, axis: str, exercise: Exercise) -> None:
    """Begin an exercise on an axis of a session. Raises ValueError if the machine cannot."""
    session.pupil = Pupil(session, axis, exercise)


def leave(session: Session) -> None:
    """Leave the exercise; the machine stays as it is."""
    if session.pupil is not None:
        session.pupil.end()
        session.pupil = None
