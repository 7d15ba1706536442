"""What a tab asks of a session while something else is under way: no command without an answer."""

import asyncio
import contextlib

import pytest

pytest.importorskip("nicegui", reason="needs servogym[panel]")
from nicegui import Client
from nicegui.page import page

from servogym.drive.kernel.words import State
from servogym.envs.panel.clock import ENDED, SILENT, Clock
from servogym.envs.panel.pages.desk import Desk, over
from servogym.envs.panel.pages.motion import MotionPage
from servogym.envs.panel.pages.objects import ObjectsPage
from servogym.envs.panel.session import Session
from servogym.envs.plants.catalogue import fresh


@pytest.fixture
def clock():
    clock = Clock(Session(fresh("linear"), "linear"), pictures=0.01)
    yield clock
    clock.stop()


@contextlib.contextmanager
def opened(clock):
    """A tab without a browser."""
    with Client(page("")):
        yield Desk(clock, "tab")


@pytest.mark.parametrize("holds", [True, False])
def test_a_command_right_after_taking_control_is_carried_out_or_refused(clock, holds):
    """The picture, made some times a second, may still show nobody in control."""
    async def go():
        clock.start()
        with opened(clock) as desk:
            if holds:
                clock.session.control.take("tab")
            assert not desk.in_control
            return await desk.motion(lambda session: session.enable("x"))

    said = asyncio.run(go())
    assert said == ("" if holds else "nobody has control: press Take control first")
    assert clock.session.powered("x") == holds


def test_a_jog_right_after_taking_control_is_answered_and_does_not_begin_late(clock, monkeypatch):
    """Until the answer is there, the key may have been released."""
    told = []
    monkeypatch.setattr("servogym.envs.panel.pages.motion.refuse", told.append)

    async def go():
        clock.start()
        with opened(clock) as desk:
            motion = MotionPage(desk)
            motion.jog.field.value = "50"
            clock.session.control.take("tab")
            await motion.run(1)
            return desk.jogging

    assert asyncio.run(go()) is False
    assert told == ["control has only now been taken: jog again"]
    assert State(clock.session.shown()["axes"]["x"]["state"]) is State.SWITCH_ON_DISABLED


def test_a_motion_that_is_dropped_because_the_window_fell_silent_says_so(clock):
    dropped = [clock.move(lambda session: session.enable("x")) for _ in range(2)]
    clock.stop_motion(lambda session: session.abandon(SILENT), SILENT)
    assert [each.result(1) for each in dropped] == [SILENT] * 2
    assert not over(SILENT)
    by_a_stop = clock.move(lambda session: session.enable("x"))
    clock.stop_motion(lambda session: session.stop("x"))
    assert over(by_a_stop.result(1))
    assert ENDED in by_a_stop.result(1)


def test_a_search_or_a_choice_while_values_are_read_shows_none_of_another_object(clock):
    session = clock.session
    limit, window = (str(session.value("x", name))
                     for name in ("max_torque", "following_error_window"))

    async def go():
        with opened(clock) as desk:
            objects, asked = ObjectsPage(desk), []

            async def ask(request):
                answer = request(session)
                asked.append(answer)
                if len(asked) == 1:
                    objects.search.value = "6072h:00"
                if len(asked) == 3:
                    objects._take("6065h:00")
                return answer

            desk.ask = ask
            await objects.show()  # all values, while somebody searches
            await objects.show()
            assert [row["value"] for row in objects.table.rows] == [limit]
            objects._take("6072h:00")
            await objects.show()  # that of 6072h, while somebody chooses 6065h
            assert len(asked) == 3
            assert objects.live.text.startswith(f"{window} ")
            assert objects._values["6072h:00"] == limit

    asyncio.run(go())
