"""Stops as a matrix: mode × who presses × connection of the window that commands.

Where the axis is, MuJoCo says. Time runs ten times as fast as the clock on the wall.
"""

import asyncio
import time
import types

import pytest

from servogym.drive.kernel.words import ENABLED, Mode, State
from servogym.envs.panel import control
from servogym.envs.panel.clock import Clock
from servogym.envs.panel.control import NotInControl
from servogym.envs.panel.pages.desk import Desk, over
from servogym.envs.panel.pages.motion import Choice, MotionPage
from servogym.envs.panel.session import Session
from servogym.envs.plants.gantry import gantry
from servogym.envs.plants.linear_axis import linear_axis

pytest.importorskip("nicegui", reason="needs servogym[panel]")
STILL = 2e-3  # m
SET_POINTS = {  # by mode: what is written to set the axis in motion, slowly, by any page
    Mode.VELOCITY: [("vl_target_velocity", 60), ("controlword", ENABLED | 0x70)],
    Mode.PROFILE_VELOCITY: [("target_velocity", 30_000)],
    Mode.PROFILE_TORQUE: [("target_torque", 110)],
    Mode.CYCLIC_SYNC_POSITION: [],  # streamed
    Mode.CYCLIC_SYNC_VELOCITY: [("target_velocity", 30_000)],
    Mode.CYCLIC_SYNC_TORQUE: [("target_torque", 110)],
}
MODES = (Mode.PROFILE_POSITION, Mode.HOMING, *SET_POINTS)
WHO = ("here", "there", "nobody commands")


class Room:
    """A clock, and two windows: one commands, the other one watches."""

    def __init__(self):
        machine = linear_axis()
        machine.reset(positions={"x": 0.25})
        self.session = Session(machine, "test")
        self.session.control.take("here")
        self.session.enable("x")
        self.session.write("x", "home_offset", -250_000)
        self.session.home("x", 35)
        self.clock = Clock(self.session)
        self.clock.start()
        self.clock.set_speed(10)
        self.desks = {name: Desk(self.clock, name) for name in ("here", "there")}

    @property
    def place(self):
        return self.clock.ask(lambda s: float(s.machine.data.qpos[0])).result(20)

    @property
    def state(self):
        return self.clock.ask(lambda s: s.machine.drives["x"].state).result(20)

    def passes(self, seconds):
        """So much time of the machine."""
        end = self.clock.ask(lambda s: s.time).result(20) + seconds
        while self.clock.ask(lambda s: s.time).result(20) < end:
            time.sleep(0.005)

    def run_in(self, mode):
        """By what a page sends; -> the motion that is under way."""
        clock, motion = self.clock, None
        begin = self.place
        if mode == Mode.PROFILE_POSITION:
            clock.ask(lambda s: s.command("x", "profile_velocity", 30_000)).result(20)
            motion = clock.move(lambda s: s.move("x", 0.45))
        elif mode == Mode.HOMING:
            clock.ask(lambda s: s.command("x", "speed_during_search_for_switch", 30_000)).result(20)
            motion = clock.move(lambda s: s.home("x", 17))
        else:
            assert clock.move(lambda s: s.set_mode("x", mode)).result(20) == ""
            for name, value in SET_POINTS[mode]:
                clock.ask(lambda s, n=name, v=value: s.command("x", n, v)).result(20)
            if mode == Mode.CYCLIC_SYNC_POSITION:
                motion = clock.move(stream)
        end = time.monotonic() + 20
        while abs(self.place - begin) < 2e-3:
            assert time.monotonic() < end, self.session.log.events[-3:]
            self.passes(0.01)
        return motion

    def stands(self):
        """For some time."""
        self.passes(0.1)
        at = self.place
        for _ in range(2):
            self.passes(0.15)
            assert self.place == pytest.approx(at, abs=STILL)
        return True


def stream(session):
    """A position each cycle, as a master sends them: 30 mm/s."""
    at = session.value("x", "position_actual_value")
    for n in range(20_000):
        assert session.write("x", "target_position", round(at + n * 15)) == ""
        session.underway.add("x")
        session.exchange()


@pytest.fixture
def room():
    room = Room()
    yield room
    room.clock.stop()


PRESSED = [
    (mode, button, who) for mode in MODES for button in ("stop", "quick_stop") for who in WHO
]
LOST = [(mode, how) for mode in MODES for how in ("closed", "slow", "reloaded", "left")]


def sampled(cases, kept):
    """All of them; those that are not in the sample are slow."""
    return [case if kept(case) else pytest.param(*case, marks=pytest.mark.slow) for case in cases]


@pytest.mark.parametrize(
    ("mode", "button", "who"),
    sampled(PRESSED, lambda case: case[1:] == ("stop", WHO[MODES.index(case[0]) % 3])),
)
def test_a_stop_stands_in_every_mode_whoever_presses(room, mode, button, who):
    motion = room.run_in(mode)
    if who == "nobody commands":
        room.clock.ask(lambda s: s.control.leave("here")).result(20)
        who = "here"
    begun = time.monotonic()
    assert asyncio.run(room.desks[who].stop(lambda s: getattr(s, button)())) == ""
    assert time.monotonic() - begun < 10
    assert motion is None or over(motion.result(20))
    assert room.stands()
    after = State.OPERATION_ENABLED if button == "stop" else State.SWITCH_ON_DISABLED
    assert room.state is after, room.session.log.events[-4:]
    if button == "stop":  # what was stopped is forgotten: neither halt nor the mode brings it back
        room.clock.move(lambda s: s.masters["x"].resume()).result(20)
        assert room.stands()
    event = next(e for e in room.session.log.events if e.kind == "stop")
    assert event.window.startswith("window")


@pytest.mark.parametrize(
    ("mode", "connection"), sampled(LOST, lambda case: case[0] == Mode.PROFILE_TORQUE)
)
def test_a_commander_that_is_lost_ends_what_it_has_set_in_motion(
    room, mode, connection, monkeypatch
):
    """Closed and cut off are the same to a server: silence. Slow and reloaded are shorter."""
    here = room.desks["here"]
    room.run_in(mode)
    here.beat()
    monkeypatch.setattr(control, "LOST", 1.0)

    def events():
        return [e for e in room.session.log.events if "what it had set in motion" in e.text]

    if connection == "left":  # the seat is given up
        from servogym.envs.panel.pages.shell import leave

        asyncio.run(here.stop(lambda s: leave(s, "here")))
    elif connection != "closed":
        gaps = [0.25] * 5 if connection == "slow" else [0.5, 0.02]
        for gap in gaps:
            time.sleep(gap)
            here.beat()
        assert not events()
        return
    end = time.monotonic() + 10
    while not events() and time.monotonic() < end:
        time.sleep(0.01)
    assert events()
    assert room.stands()


def test_what_waits_is_dropped_by_a_stop_and_what_comes_after_it_is_a_new_command(room):
    """All three are asked for between two cycles, so that nothing of it runs before the stop."""
    motion, clock = room.run_in(Mode.PROFILE_POSITION), room.clock
    *waiting, stopped = clock.ask(lambda _: [
        clock.move(lambda s: s.home("x", 35)), clock.move(lambda s: 1 / 0),
        clock.stop_motion(lambda s: s.stop()),
    ]).result(20)
    assert stopped.result(20) == ""
    assert over(motion.result(20))
    assert all(over(each.result(20)) for each in waiting)
    assert room.stands()
    assert room.clock.move(lambda s: s.move("x", 0.25)).result(20) == ""
    assert room.session.value("x", "position_actual_value") == pytest.approx(250_000, abs=30)


def test_only_stops_need_no_seat(room):
    there = room.desks["there"]
    refused = asyncio.run(there.motion(lambda s: s.move("x", 0.01)))
    assert "another window has control" in refused
    assert "Take control" in asyncio.run(there.command(lambda s: s.control_word("x", 0)))
    with pytest.raises(NotInControl):
        room.session.control.check("there")


def test_all_axes_stop_at_once_although_one_of_them_is_in_fault():
    machine = gantry()
    machine.reset()
    session = Session(machine, "gantry")
    names = session.axes
    for name in names:
        session.enable(name), session.jog(name, 0.05)
    machine.drives[names[0]].inject("overvoltage")
    session.advance(0.05)
    session.quick_stop()
    session.advance(0.5)
    assert all(drive.axis.standstill for drive in machine.drives.values())
    (fault,) = [e for e in session.log.events if e.kind == "fault"]
    assert fault.reason.startswith("3210h")
    assert "brake" in fault.remedy
    for refused in (session.move(names[0], 0.1), session.home(names[0]), session.jog(names[0], 1)):
        assert "3210h" in refused
        assert "Reset fault and Enable" in refused


def test_a_stop_takes_the_machine_back_from_an_agent(room):
    class Agent:
        name = "a policy"

        def step(self):
            room.session.exchange()

        def release(self):
            pass

    for button in ("stop", "quick_stop", "disable"):
        room.clock.ask(lambda s: s.hand_over(Agent())).result(20)
        asyncio.run(
            room.desks["there"].stop(lambda s, b=button: getattr(s, b)(*["x"] * (b[0] == "d")))
        )
        assert room.session.agent is None


def test_a_list_keeps_what_was_chosen_until_the_drive_shows_it():
    """The mode before was shown again for a moment; chosen anew then, it was no change: lost."""
    old, new, third = Mode.PROFILE_POSITION, Mode.INTERPOLATED_POSITION, Mode.PROFILE_TORQUE
    choice = Choice()
    assert not choice.keeps(old, 10.0)
    assert choice.is_new(new, old)
    assert choice.keeps(old, 50.0), "on its way, however long that takes"
    choice.arrived(50.0)
    assert choice.keeps(old, 50.1), "what is shown is older than the answer"
    assert choice.is_new(old, old), "back to the one before is a change as well"
    choice.arrived(50.2)
    assert choice.is_new(third, old)
    assert choice.keeps(old, 60.0)
    assert choice.keeps(new, 60.0)
    assert not choice.keeps(third, 60.0)
    assert not choice.is_new(third, third), "what the list shows by itself is not a command"
    choice.arrived(60.1)
    assert choice.is_new(new, third)
    choice.arrived(70.0)
    assert choice.keeps(third, 70.5)
    assert not choice.keeps(third, 71.5), "a refused one goes from the list"


def test_a_choice_counts_before_the_next_picture():
    """It was looked at when the event loop came to it; the list had then gone back by itself."""
    page, sent = object.__new__(MotionPage), []
    first, second = Mode.CYCLIC_SYNC_POSITION, Mode.HOMING

    async def go(*command):
        sent.append(command)

    page._choice = Choice()
    page.desk = types.SimpleNamespace(status={"mode": first}, go=go)
    assert page._choice.is_new(first, Mode.PROFILE_POSITION)  # the drive shows it by now
    pending = page._mode(second)
    assert page._choice.keeps(first, 1.0), "the list follows the drive: the choice is lost"
    asyncio.run(pending)
    assert sent == [("set_mode", second)]
    assert page._mode(second) is None
