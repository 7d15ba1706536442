"""A whole class at its machines: real time, nothing crosses, and monkeys that press everything.

    SERVOGYM_MINUTES=30 pytest -m slow -s tests/panel/test_panel_class_pace.py -k real_time
    SERVOGYM_MINUTES=15 pytest -m slow -s tests/panel/test_panel_class_pace.py -k for_long

Both say each half minute how far they are, and end with figures. `SERVOGYM_PUPILS` is 24.

Pupils' pages are `pupil.Page`, which answers the server as a browser does at a fraction of its
load; browsers are on the pupils' computers, not on the one that is measured. Real browsers come in
`test_panel_classroom` and, as monkeys, here.
"""

import asyncio
import contextlib
import os
import random
import re
import time

import pytest
from browser import (
    CHROMIUM,
    Server,
    at,
    chromium,
    expect,
    open_page,
    shows,
    sync_api,
    take_control,
)
from test_panel_classroom import WORD, come, teacher
from test_panel_pace import memory, processor_time

pytest.importorskip("nicegui", reason="needs servogym[panel]")
pupil = pytest.importorskip("pupil", reason="needs aiohttp and python-socketio")
MINUTES = float(os.environ.get("SERVOGYM_MINUTES", "2"))
PUPILS = int(os.environ.get("SERVOGYM_PUPILS", "24"))
TELL = 30.0  # s between two lines
NUMBERS = ("0", "1", "-1", "10", "100", "250", "1e3", "-5e4", "300000", "1e9", "x", "", "0Fh")
# what ends the page, asks for a file or takes minutes of the processor
NOT = re.compile("leave-class|pick|tune|measure|run-compare|hand-over|parameters|csv|theme|file")


@contextlib.contextmanager
def served(tmp_path, *options):
    """A classroom whose errors are in a file; none is an error of ours."""
    with (tmp_path / "errors").open("w+") as errors:
        server = Server("--code", WORD, "--results", str(tmp_path / "results"), *options,
                        command="classroom", log=errors)
        try:
            yield server
            assert server.process.poll() is None
        finally:
            if (status := server.process.poll()) is not None:
                print(f"the server has ended with {status}")
            server.kill()
        errors.seek(0)
        said = errors.read()
        print(f"tracebacks of the server: {said.count('Traceback')}")
        assert "Traceback" not in said, said[-3000:]


async def class_of(server, count, tell):
    """So many pupils at their machines, ready to move, each with a torque limit of its own."""
    pages = [pupil.Page(server.url) for _ in range(count)]
    for number, page in enumerate(pages):
        await page.enter(WORD, f"Pupil {number}")
    tell(f"{count} pupils are in")
    for number, page in enumerate(pages):
        await page.until(lambda page: page.text("control") == "In control")
        await page.click("go-motion")
        await page.until(lambda page: page.find("enable"))
        await page.type("set-max_torque", str(1000 + number))
        await page.click("enable")
    for page in pages:
        await page.until(lambda page: page.text("state") == "operation enabled")
        await page.click("home")
    for number, page in enumerate(pages):
        await page.until(lambda page: "is referenced" in page.text("homed"))
        await page.until(lambda page, number=number: limit(page) == 1000 + number)
    tell("all axes are referenced")
    return pages


def limit(page):
    return float(page.text("value-max_torque"))


async def to_and_fro(pages, speeds, seconds, tell):
    """All axes move all the time; real time by each page's own header."""
    end, target, said = time.monotonic() + seconds, 100, time.monotonic()
    while time.monotonic() < end:
        if time.monotonic() > said + TELL:
            said = time.monotonic()
            least = min(sum(row) / len(row) for row in speeds)
            tell(f"{end - said:.0f} s to go, least {least:.3f} of real time so far")
        target = 500 - target
        for page in pages:
            await page.type("target", str(target))
            await page.click("move-to")
        await asyncio.sleep(1.0)
        for page, row in zip(pages, speeds, strict=True):
            row.append(float(page.text("measured").split("×")[0]))


@pytest.mark.slow
def test_a_class_keeps_real_time(tmp_path, tell):
    async def go(server):
        pages = await class_of(server, PUPILS, tell)
        speeds = [[] for _ in pages]
        await to_and_fro(pages, [[] for _ in pages], 10, tell)
        before, used, begin = memory(server.process), processor_time(server.process), time.time()
        pictures = sum(page.pictures for page in pages)
        await to_and_fro(pages, speeds, 60 * MINUTES, tell)
        passed = time.time() - begin
        share = (processor_time(server.process) - used) / passed
        pictures = (sum(page.pictures for page in pages) - pictures) / passed / len(pages)
        mean = [sum(row) / len(row) for row in speeds]
        print(
            f"\n{PUPILS} pupils, {passed:.0f} s, load {os.getloadavg()[0]:.1f}: least "
            f"{min(mean):.3f} of real time, mean {sum(mean) / len(mean):.3f}, "
            f"{pictures:.1f} pictures a second each, server {100 * share:.0f} % of a core, "
            f"{before:.0f} MB at first, {memory(server.process) - before:+.1f} MB"
        )
        assert [limit(page) for page in pages] == [1000 + n for n in range(PUPILS)]
        assert memory(server.process) - before < 30 + 2 * MINUTES
        for page in pages:
            await page.leave()
        assert min(mean) >= 0.99

    with served(tmp_path) as server:
        asyncio.run(go(server))


# ----------------------------------------------------------------------------- monkeys


async def monkey(page, drawn, seconds, tell):
    """Press and type whatever there is, in any order."""
    end, done, said = time.monotonic() + seconds, 0, time.monotonic()
    while time.monotonic() < end:
        if time.monotonic() > said + TELL:
            said = time.monotonic()
            tell(f"{end - said:.0f} s to go, {done} presses of the first monkey")
        links = page.named("click")
        fields = page.named("update:value", "nicegui-input")
        name = drawn.choice(links)
        try:
            if drawn.random() < 0.3 and fields:
                await page.type(drawn.choice(fields), drawn.choice(NUMBERS))
            elif not NOT.search(name):
                await page.click(name)
            done += 1
        except LookupError:
            pass  # gone meanwhile
        await asyncio.sleep(drawn.uniform(0.0, 0.15))
    return done


async def settled(page):
    """Its machine stands, by the quick stop, and the page is that of the objects."""
    if page.text("control") != "In control":
        await page.click("control")
        await page.until(lambda page: page.text("control") == "In control")
    if "paused" in page.text("measured"):
        await page.click("pause")
    await page.click("quick-stop")
    await page.click("go-objects")
    await page.until(lambda page: page.find("search"))
    await asyncio.sleep(3.0)


STATES = {  # statusword & 6Fh, CiA 402-2 table 30; the rest is & 4Fh
    0x21: "ready to switch on", 0x23: "switched on", 0x27: "operation enabled",
    0x07: "quick stop active",
}


def state_of(word):
    """The state that a statusword says."""
    if word & 0x4F == 0x40:
        return "switch on disabled"
    if word & 0x4F == 0x08:
        return "fault"
    return STATES.get(word & 0x6F, "?")


async def look_up(page, address):
    """Type an address until its object is shown: what is typed into a line that is cut is lost."""
    for last in (False, False, True):
        await page.type("search", address)
        try:
            await page.until(lambda page: page.text("object").startswith(address), 20.0)
            return
        except TimeoutError:
            if last:
                raise


async def shown_is_drive(page):
    """State and position in the header are those of 6041h and 6064h.

    Looked at again where the line was cut meanwhile: the page then begins anew.
    """
    for _ in range(2):
        with contextlib.suppress(LookupError):
            return await looked_at(page)
    await looked_at(page)


async def looked_at(page):
    await settled(page)
    for address in ("6041h:00", "6064h:00"):
        await look_up(page, address)
        await asyncio.sleep(2.0)
        await page.until(lambda page: page.text("live").split())
        if address == "6041h:00":
            try:
                await page.until(
                    lambda page: page.text("state") == state_of(int(page.text("live").split()[0]))
                )
            except TimeoutError:
                shown = [page.text(name) for name in ("state", "live", "measured", "doing")]
                raise AssertionError(f"state, 6041h, pace, doing: {shown}") from None
            continue
        shown, read = [], []
        for _ in range(8):  # an axis that monkeys have tuned may swing, one without friction drifts
            shown.append(position(page))
            read.append(float(page.text("live").split()[0]) / 1000)  # µm to mm
            await asyncio.sleep(0.3)
        assert max(min(shown), min(read)) <= min(max(shown), max(read)) + 0.002, (shown, read)


def position(page):
    return float(page.text("header-position").replace("−", "-"))


PRESSABLE = """() => [...document.querySelectorAll(
    "button[data-test], .q-btn[data-test], [role=switch][data-test]")].filter(
    e => e.offsetParent && !e.disabled).map(e => e.dataset.test)"""
PRESS = "name => document.querySelector(`[data-test=${name}]`)?.click()"


def in_a_browser(server, seed, seconds):
    """A monkey in Chromium with the wall beside it; -> presses, what the consoles say is wrong."""
    drawn, done = random.Random(seed), 0
    with sync_api.sync_playwright() as playwright:
        browser = chromium(playwright)
        wall, page = teacher(browser, server), come(browser, server, "Chromium")
        shows(page, "control", "In control")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                names = [name for name in page.evaluate(PRESSABLE) if not NOT.search(name)]
                page.evaluate(PRESS, drawn.choice(names or ["quick-stop"]))
                done += 1
            except sync_api.Error as error:  # a line that was cut for long loads the page anew
                if "navigation" not in str(error):
                    raise
                page.wait_for_load_state()
            page.wait_for_timeout(drawn.uniform(0, 150))
        if page.locator(".q-dialog__inner").count():
            page.keyboard.press("Escape")
        take_control(page)
        page.evaluate(PRESS, "quick-stop")
        open_page(page, "objects")
        at(page, "search").fill("6041h:00")
        at(page, "search").press("Enter")
        page.wait_for_timeout(3000)
        live = at(page, "live")
        expect(live).to_have_text(re.compile(r"\d"))
        shows(page, "state", state_of(int(live.inner_text().split()[0])))
        shows(wall, "count", re.compile(" of "))
        browser.close()
        return done, browser.errors


def monkeys(tmp_path, count, seconds, seed, tell, real=False):
    async def go(server):
        pages = [pupil.Page(server.url) for _ in range(count)]
        for number, page in enumerate(pages):
            await page.enter(WORD, f"Monkey {number}")
            await page.until(lambda page: page.text("control") == "In control")
        beside = asyncio.to_thread(in_a_browser, server, seed, seconds) if real else None
        beside = beside and asyncio.ensure_future(beside)
        done = await asyncio.gather(*(
            monkey(page, random.Random(seed + number), seconds, tell if not number else silent)
            for number, page in enumerate(pages)
        ))
        tell("all stand; what is shown is compared with the drives")
        await asyncio.gather(*(shown_is_drive(page) for page in pages))
        for page in pages:
            await page.leave()
        pressed, errors = await beside if real else (0, [])
        print(
            f"\n{count} monkeys, {seconds:.0f} s, load {os.getloadavg()[0]:.1f}, {sum(done)} "
            f"presses, seed {seed}, {sum(page.drops for page in pages)} lines cut; {pressed} "
            f"presses in Chromium, errors in its consoles: {len(errors)}"
        )
        assert errors == []
        assert min(done) > seconds

    with served(tmp_path, "--pupils", str(count + real)) as server:
        asyncio.run(go(server))


def silent(text):
    """Nothing is told."""


def test_monkeys_in_a_class_leave_no_traceback_and_what_is_shown_is_the_drive(tmp_path, tell):
    monkeys(tmp_path, 3, 10.0, 1, tell)


@pytest.mark.slow
def test_monkeys_in_a_class_for_long(tmp_path, tell):
    monkeys(tmp_path, PUPILS, 60 * MINUTES, int(time.time()), tell, real=CHROMIUM is not None)
