"""A classroom: a place with its own machine for each pupil, and a teacher who sees them all.

Places share only the process: each has its own session, clock with thread, token and results. A
pupil who gives the code of the class and a new name gets a place. A pupil who returns in another
browser gives the code of the place as well. That code is not needed as long as no browser has
opened the place, because the form may have been sent twice or its answer may have been lost.

Pupils enter and leave one at a time (`_door`). `places` is replaced and never changed, so that
another thread that iterates over it sees the places of one instant.
"""

import hashlib
import hmac
import json
import os
import re
import secrets
import threading
import unicodedata
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from ..course.exercise import Exercise
from . import journal, lessons
from .clock import Clock
from .log import plain, table
from .session import Session

MOST = 24
CYCLES = 8  # position cycles an exchange: 4 ms at a position cycle of 0.5 ms
NAP = 0.016  # s: many threads cost less if they wake rarely
LONGEST = 32  # characters of a name
LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"  # none is easily mistaken for another one
LOOK_ALIKE = {"LATIN", "CYRILLIC", "GREEK"}  # alphabets with letters that read the same
TEACHER = "the teacher"
FORM = "servogym class 1"


class Result(NamedTuple):
    """The result of a pupil's attempt at an exercise."""

    pupil: str
    exercise: str
    ended: str  # date and time, ISO 8601
    done: bool
    steps_done: int
    steps: int
    wrong: str
    hints: int
    predictions_right: int
    predictions: int
    time: float  # s of the machine until its end
    run: str  # file that can be replayed, empty without --results


class Place:
    """A pupil's machine, and what the pupil has done with it.

    Args:
        number: number of the place, from 1.
        name: name of the pupil.
        session: its own session.
        pictures: pictures per second.
    """

    def __init__(self, number: int, name: str, session: Session, pictures: float):
        self.number, self.name = number, name
        self.code = code(6)
        self.token = secrets.token_urlsafe(24)
        self.opened = False  # whether a browser has shown the token
        self.results: list[Result] = []
        self.clock = Clock(session, pictures, NAP)

    @property
    def done(self) -> set[str]:
        """The names of the finished exercises."""
        return {result.exercise for result in self.results if result.done}


class Classroom:
    """The places, their pupils, and the pupils' results.

    Args:
        make: returns a session with a fresh machine, for some position cycles per exchange.
        kind: kind of the machine, key of `plants.catalogue.AXES`.
        drive: drive model.
        exercises: exercises that the teacher can give.
        most: number of places.
        pictures: pictures per second.
        results: folder for ``results.csv`` and the runs; None keeps them in memory.
        word: code of the class; drawn at random by default.

    Raises:
        ValueError: number of places out of range, or a code that is too short or too long.
    """

    def __init__(
        self, make: Callable[[int], Session], kind: str, drive: str,
        exercises: Iterable[Exercise] = (), most: int = MOST, pictures: float = 5.0,
        results: Path | None = None, word: str = "",
    ):
        if not 1 <= most <= 100:
            raise ValueError(f"--pupils = {most} is out of range 1..100")
        if word and not 6 <= len(word) <= LONGEST:
            raise ValueError(f"--code has {len(word)} characters: give 6..{LONGEST}")
        self._make, self.kind, self.drive, self.most = make, kind, drive, most
        self.exercises, self.pictures = tuple(exercises), pictures
        self.word = word or f"{code(4)}-{code(4)}"
        self.open = True  # whether new pupils may enter
        self.task: Exercise | None = None  # of all pupils, also of those who enter later
        self.places: dict[int, Place] = {}
        self._door, self._lock = threading.Lock(), threading.RLock()  # for pupils, for results
        self._files: Path | None = results
        if results is not None:
            (results / "runs").mkdir(parents=True, exist_ok=True)

    # --------------------------------------------------------- pupils who enter

    def person(self, token: str) -> Place | None:
        """Return the place to which a token belongs, and open it."""
        found = None
        for place in self.places.values():  # all of them, so that the time reveals nothing
            if hmac.compare_digest(place.token.encode(), token.encode()):
                found = place
        if found is not None:
            found.opened = True
        return found

    def named(self, name: str) -> Place | None:
        """The place of a pupil."""
        same = (p for p in self.places.values() if _plain(p.name) == _plain(name))
        return next(same, None)

    def may_enter(self, name: str, word: str, own: str) -> str:
        """The reason why somebody may not enter; empty if they may.

        Args:
            name: name of the pupil.
            word: code of the class.
            own: code of the place, if the pupil has one.
        """
        if not hmac.compare_digest(_simple(word).encode(), _simple(self.word).encode()):
            return "This is not the code of the class: ask your teacher for it."
        if not 1 <= len(name) <= LONGEST or not name.isprintable():
            return f"Give a name of 1 to {LONGEST} characters."
        if len(alphabets := {unicodedata.name(each, "").partition(" ")[0]
                             for each in name if each.isalpha()} & LOOK_ALIKE) > 1:
            return f"Write the name in one alphabet; it has {' and '.join(sorted(alphabets))}."
        place = self.named(name)
        if place is not None:
            mine = hmac.compare_digest(_simple(own).encode(), place.code.encode())
            if mine or not place.opened:
                return ""
            return (
                f"{place.name} is here already. If that is you, give your own code as well: it "
                "stands in the header of your page, and the teacher sees it. If not, add a letter "
                "to your name."
            )
        if not self.open:
            return "The class is closed to new pupils."
        if len(self.places) >= self.most:
            return f"All {self.most} places are taken."
        return ""

    def enter(self, name: str, word: str, own: str = "") -> str:
        """Return the token of a pupil's place, which is made if there is none yet.

        A place that no browser has opened yet gets a new token, because the earlier one may be on
        its way to somebody else. Arguments as of `may_enter`.

        Raises:
            ValueError: the pupil may not enter.
        """
        with self._door:
            if wrong := self.may_enter(name, word, own):
                raise ValueError(wrong)
            place = self.named(name)
            if place is None:
                number = min({*range(1, self.most + 1)} - self.places.keys())
                place = Place(number, name, self._session(), self.pictures)
                self._seat(place)
            elif not place.opened:
                place.token = secrets.token_urlsafe(24)
            self._keep()
            return place.token

    def _session(self) -> Session:
        session = self._make(CYCLES)
        session.lessons = self.exercises
        session.control.named[TEACHER] = TEACHER
        return session

    def _seat(self, place: Place) -> None:
        """Open a place."""
        session: Any = place.clock.session
        session.attempted = lambda pupil: self._attempted(place, pupil)
        if self.task is not None:
            lessons.begin(session, session.axes[0], self.task)
        self.places = self.places | {place.number: place}
        place.clock.start()

    def remove(self, place: Place) -> None:
        """Free this place; its results stay in the files. This may take a moment."""
        with self._door:
            self.places = {n: each for n, each in self.places.items() if each is not place}
            self._keep()
        place.clock.stop()

    # ------------------------------------------------------- a server started anew

    @property
    def _kept(self) -> Path | None:
        """The file with the places of the class with this code."""
        if self._files is None:
            return None
        key = hashlib.sha256(_simple(self.word).encode()).hexdigest()[:12]
        return self._files / f"class-{key}.json"

    def _keep(self) -> None:
        """Write the places and their pupils; only the user of the server can read the file."""
        if self._kept is None:
            return
        with self._lock:
            rows = [
                {"number": place.number, "name": place.name, "code": place.code,
                 "token": place.token, "results": [each._asdict() for each in place.results]}
                for place in self.places.values()
            ]
            new = self._kept.with_suffix(".new")
            with open(os.open(new, os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o600), "w",
                      encoding="utf-8") as file:
                json.dump({"form": FORM, "places": rows}, file)
            new.replace(self._kept)

    def resume(self) -> int:
        """Restore the places of an earlier classroom; their machines are fresh.

        It had the same code and the same folder for results.

        Returns:
            The number of places.

        Raises:
            ValueError: the file in the folder is damaged.
        """
        if self._kept is None or not self._kept.exists():
            return 0
        try:
            known = json.loads(self._kept.read_text(encoding="utf-8"))
            if known["form"] != FORM:
                raise ValueError(known["form"])
            for row in known["places"]:
                place = Place(int(row["number"]), str(row["name"]), self._session(), self.pictures)
                place.code, place.token = str(row["code"]), str(row["token"])
                place.opened = True
                place.results = [Result(**each) for each in row["results"]]
                self._seat(place)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(
                f"{self._kept} is not a stored class ({error!r}): take another code, or another "
                "folder for --results"
            ) from None
        return len(self.places)

    def end(self) -> None:
        """Stop all clocks."""
        for place in self.places.values():
            place.clock.end()
        for place in self.places.values():
            place.clock.stop()

    # ----------------------------------------------------------- tasks and results

    def give(self, exercise: Exercise | None) -> None:
        """Begin an exercise on all machines at once, each one fresh; None ends the task for all."""
        with self._door:  # a pupil who enters meanwhile gets it once
            self.task, places = exercise, self.places
        if exercise is None:
            return
        for place in places.values():
            place.clock.stop_motion(lambda session: _given(session, exercise))

    def reset(self, place: Place) -> None:
        """Restore the initial state of a machine, which ends its exercise."""
        place.clock.stop_motion(_fresh)

    def stop(self) -> None:
        """Quick-stop all machines."""
        for place in self.places.values():
            place.clock.stop_motion(lambda session: session.quick_stop())

    def _attempted(self, place: Place, pupil: lessons.Pupil) -> None:
        """Record an attempt that has ended."""
        report, now = pupil.attempt.report, datetime.now().astimezone()
        with self._lock:
            run = ""
            if self._files is not None:
                stem = f"{now:%Y%m%d-%H%M%S}-{place.number}-{_slug(place.name)}"
                run = f"runs/{stem}-{report.exercise}-{len(place.results)}.json"
            place.results.append(Result(
                place.name, report.exercise, now.isoformat(timespec="seconds"), report.done,
                report.step, len(pupil.exercise.steps), report.wrong, report.hints,
                sum(report.predictions), len(report.predictions),
                round(pupil.journal.cycle * pupil.attempt.machine.cycle_time, 3), run,
            ))
            if self._files is None:
                return
            found = journal.outcome(self.kind, self.drive, pupil.axis, pupil.attempt, pupil.journal)
            text = json.dumps({"pupil": place.name, "ended": place.results[-1].ended} | found)
            (self._files / run).write_text(text, encoding="utf-8")
            path = self._files / "results.csv"
            head = not path.exists()
            with path.open("a", newline="", encoding="utf-8") as file:
                file.write(_rows(place.results[-1:], head=head))
            self._keep()

    def csv(self) -> str:
        """All results as a table."""
        with self._lock:
            return _rows([r for place in self.places.values() for r in place.results], head=True)


def code(length: int) -> str:
    """Make a code of letters and digits that can be read out without mistakes."""
    return "".join(secrets.choice(LETTERS) for _ in range(length))


def _simple(text: str) -> str:
    """Normalise a code that somebody has typed."""
    return "".join(text.split()).replace("-", "").casefold()


def _plain(name: str) -> str:
    """Normalise a name for comparison."""
    return " ".join(unicodedata.normalize("NFKC", name).casefold().split())


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "pupil"


def _rows(results: Iterable[Result], *, head: bool) -> str:
    heading = [[name.replace("_", " ") for name in Result._fields]] if head else []
    return table(heading + [
        [plain(each) if isinstance(each, str) else each for each in result] for result in results
    ])


def _given(session: Any, exercise: Exercise) -> None:
    lessons.begin(session, session.axes[0], exercise)
    session.tell("info", f"A task for everyone: {exercise.title}. It is on the page Lessons.")


def _fresh(session: Any) -> None:
    lessons.leave(session)
    session.release()
    session.restore(session.fresh)
    session.delay = 0.0
    session.underway.clear()
    session.tell("info", "The teacher has reset the machine to its initial state.")
