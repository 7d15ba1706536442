"""The exercises of three units by clicks, as a pupil does them with what the pages say.

    SERVOGYM_WALK=out pytest -m slow tests/panel/test_panel_course.py

writes a picture of each step into the folder `out`.
"""

import os
import re
from pathlib import Path

import pytest
from browser import Server, at, expect, move, needs_chromium, open_page, shows
from test_panel_classroom import WORD

pytestmark = needs_chromium
WIDE, NARROW = (1280, 800), (360, 740)


@pytest.fixture(scope="module")
def server():
    server = Server("--pictures", "5", "--code", WORD, command="classroom")
    yield server
    server.kill()


class Pupil:
    """A pupil at a window of some size, in a theme, with an exercise.

    Args:
        browser: that has the window.
        server: of the classroom.
        name: of the exercise.
        size: of the window.
        dark: theme.
    """

    def __init__(self, browser, server, name, size, dark):
        width, height = size
        self.name, self.count, self.width = name, 0, width
        context = browser.new_context(
            viewport={"width": width, "height": height}, reduced_motion="reduce")
        context.set_default_timeout(60_000)
        self.page = page = context.new_page()
        page.goto(server.url)
        page.fill("[name=word]", WORD)
        page.fill("[name=name]", f"{name} {width}")
        page.click("button")
        shows(page, "control", "In control")
        if dark:
            at(page, "theme").click()
        self.go("lessons")
        self.look()
        page.locator("button.lesson", has_text=name).click()
        expect(at(page, "step-0")).to_be_visible()
        page.evaluate("window.scrollTo(0, 0)")
        expect(at(page, "step-0")).to_be_in_viewport()
        self.look()

    def look(self):
        """A picture, if somebody wants to see it."""
        if folder := os.environ.get("SERVOGYM_WALK"):
            Path(folder).mkdir(exist_ok=True)
            self.page.wait_for_timeout(600)
            self.page.screenshot(path=f"{folder}/{self.name}-{self.width}-{self.count:02}.png")
            self.count += 1

    def go(self, name):
        open_page(self.page, name)

    def press(self, *names):
        for name in names:
            at(self.page, name).click()

    def state(self, text):
        shows(self.page, "state", text)

    def choose(self, name, text):
        """An entry of a list."""
        at(self.page, name).click()
        self.page.get_by_role("option", name=re.compile(f"^{text} ·")).click()

    def set(self, name, value):
        """A parameter of the page Motion."""
        field = at(self.page, f"set-{name}")
        field.fill(str(value))
        field.press("Enter")
        shows(self.page, f"value-{name}", str(value))

    def write(self, address, *values):
        """Write an object on the page Objects."""
        self.go("objects")
        at(self.page, "search").fill(address)
        at(self.page, "search").press("Enter")
        expect(at(self.page, "object")).to_contain_text(address)
        for value in values:
            at(self.page, "object-value").fill(str(value))
            at(self.page, "write").click()
            expect(at(self.page, "object-value")).to_have_value("")

    def answer(self, option):
        self.page.evaluate("window.scrollTo(0, 0)")
        self.go("lessons")
        self.look()
        expect(at(self.page, f"option-{option}")).to_be_in_viewport()
        at(self.page, f"option-{option}").click()
        expect(at(self.page, f"option-{option}")).to_have_count(0)

    def done(self, step):
        """So many steps are done, which stands on every page."""
        text = re.compile(rf"· ({step + 1}\. |done)")
        expect(at(self.page, "lesson-now")).to_contain_text(text)
        self.look()

    def all_done(self):
        expect(at(self.page, "lesson-now")).to_contain_text("· done")
        self.go("lessons")
        self.look()


def power(pupil):
    pupil.go("state")
    pupil.press("controlword-3", "controlword-0", "controlword-1", "controlword-2")
    pupil.done(1)
    pupil.press("command-2")
    pupil.done(2)
    pupil.press("command-3", "command-4")
    pupil.done(3)
    pupil.answer(1)
    pupil.press("quick-stop")
    pupil.done(4)
    pupil.go("motion")
    pupil.press("enable")


def stop_it(pupil):
    pupil.go("motion")
    pupil.press("enable")
    pupil.state("operation enabled")
    pupil.choose("homing-method", "37")
    pupil.press("home")
    pupil.done(1)
    pupil.answer(1)
    pupil.go("motion")
    move(pupil.page, "400")
    expect(at(pupil.page, "velocity")).to_have_text(re.compile(r"^(99|100)\."))
    pupil.look()
    pupil.press("quick-stop")


def overvoltage(pupil):
    pupil.go("motion")
    pupil.press("enable")
    pupil.done(1)
    pupil.state("fault")
    pupil.answer(1)
    pupil.go("state")
    pupil.look()
    pupil.press("reset-fault")
    pupil.done(2)
    pupil.go("experiments")
    pupil.look()
    pupil.press("clear-injected")
    pupil.go("motion")
    pupil.press("motion-reset")
    pupil.state("switch on disabled")
    pupil.press("enable")


def units(pupil):
    """607Ah and 6040h on the page Objects, as the plan of the unit says."""
    pupil.go("motion")
    pupil.press("enable")
    pupil.state("operation enabled")
    pupil.choose("homing-method", "37")
    pupil.press("home")
    shows(pupil.page, "homed", "The axis is referenced.")
    shows(pupil.page, "doing", "")
    pupil.choose("mode", "pp")
    shows(pupil.page, "mode-shown", "pp")
    pupil.write("607Ah:00", 75000)
    pupil.write("6040h:00", "0Fh", "1Fh")
    pupil.look()
    pupil.done(1)
    pupil.go("motion")
    pupil.set("profile_velocity", 40000)
    pupil.look()
    pupil.write("607Ah:00", 0)
    pupil.write("6040h:00", "0Fh", "1Fh")


def find_why_it_trips(pupil):
    pupil.go("motion")
    pupil.press("enable")
    pupil.state("operation enabled")
    pupil.choose("homing-method", "17")
    pupil.press("home")
    pupil.done(1)
    move(pupil.page, "400")
    pupil.state("fault")
    pupil.done(2)
    pupil.go("state")
    pupil.look()
    pupil.go("motion")
    pupil.set("max_torque", 3000)
    pupil.press("motion-reset")
    pupil.state("switch on disabled")
    pupil.press("enable")
    pupil.state("operation enabled")
    move(pupil.page, "400")


def gently(pupil):
    pupil.go("motion")
    pupil.press("enable")
    pupil.state("operation enabled")
    pupil.choose("homing-method", "35")
    pupil.press("home")
    pupil.done(1)
    pupil.set("profile_acceleration", 2000000)
    pupil.set("profile_deceleration", 2000000)
    pupil.done(2)
    pupil.set("motion_profile_type", 3)
    move(pupil.page, "420")
    pupil.done(3)
    pupil.go("scope")
    pupil.look()
    pupil.go("motion")
    page = pupil.page
    for speed, place in ((100, r"^1\d\d\.\d+$"), (8, r"^12[0-4]\.\d+$")):  # 5 pictures a second
        at(page, "jog-speed").fill(str(speed))
        at(page, "jog-negative").hover()
        page.mouse.down()
        expect(at(page, "position")).to_have_text(re.compile(place))
        page.mouse.up()
        expect(at(page, "velocity")).to_have_text(re.compile(r"^−?0\.\d+$"))


WAYS = {
    "11_power": power, "12_stop_it": stop_it, "13_overvoltage": overvoltage, "32_units": units,
    "31_find_why_it_trips": find_why_it_trips, "51_gently": gently,
}


@pytest.mark.parametrize(
    ("name", "size", "dark"),
    [
        pytest.param(name, size, (number % 2 == 0) == (size == NARROW),
                     marks=() if (name, size) == ("32_units", WIDE) else pytest.mark.slow,
                     id=f"{name}-{size[0]}")
        for number, name in enumerate(WAYS) for size in (WIDE, NARROW)
    ],
)
def test_an_exercise_is_done_by_clicks(browser, server, name, size, dark):
    pupil = Pupil(browser, server, name, size, dark)
    try:
        WAYS[name](pupil)
        pupil.all_done()
    finally:
        pupil.look()
        pupil.page.context.close()
