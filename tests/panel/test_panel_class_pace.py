"""A whole class at its machines: real time, nothing crosses, and monkeys that press everything.

    pytest -m slow -s tests/panel/test_panel_class_pace.py -k real_time   # prints figures
    SERVOGYM_MINUTES=30 pytest -m slow -s tests/panel/test_panel_class_pace.py

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
    Server,
)
from test_panel_classroom import WORD
from test_panel_pace import memory, processor_time

pytest.importorskip("nicegui", reason="needs servogym[panel]")
pupil = pytest.importorskip("pupil", reason="needs aiohttp and python-socketio")
MINUTES = float(os.environ.get("SERVOGYM_MINUTES", "2"))
PUPILS = int(os.environ.get("SERVOGYM_PUPILS", "24"))
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
        assert "Traceback" not in said, said[-3000:]


async def class_of(server, count):
    """So many pupils at their machines, ready to move, each with a torque limit of its own."""
    pages = [pupil.Page(server.url) for _ in range(count)]
    for number, page in enumerate(pages):
        await page.enter(WORD, f"Pupil {number}")
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
    return pages


def limit(page):
    return float(page.text("value-max_torque"))


async def to_and_fro(pages, speeds, seconds):
    """All axes move all the time; real time by each page's own header."""
    end, target = time.monotonic() + seconds, 100
    while time.monotonic() < end:
        target = 500 - target
        for page in pages:
            await page.type("target", str(target))
            await page.click("move-to")
        await asyncio.sleep(1.0)
        for page, row in zip(pages, speeds, strict=True):
            row.append(float(page.text("measured").split("×")[0]))


@pytest.mark.slow
def test_a_class_keeps_real_time(tmp_path):
    async def go(server):
        pages = await class_of(server, PUPILS)
        speeds = [[] for _ in pages]
        await to_and_fro(pages, [[] for _ in pages], 10)
        before, used, begin = memory(server.process), processor_time(server.process), time.time()
        pictures = sum(page.pictures for page in pages)
        await to_and_fro(pages, speeds, 60 * MINUTES)
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


async def monkey(page, drawn, seconds):
    """Press and type whatever there is, in any order."""
    end, done = time.monotonic() + seconds, 0
    while time.monotonic() < end:
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


async def shown_is_drive(page):
    """State and position in the header are those of 6041h and 6064h."""
    await settled(page)
    for address in ("6041h:00", "6064h:00"):
        await page.type("search", address)
        await asyncio.sleep(2.0)
        if address == "6041h:00":
            assert page.text("state") == state_of(int(page.text("live").split()[0]))
            continue
        shown, read = [], []
        for _ in range(8):  # an axis that monkeys have tuned may swing, one without friction drifts
            shown.append(position(page))
            read.append(float(page.text("live").split()[0]) / 1000)  # µm to mm
            await asyncio.sleep(0.3)
        assert max(min(shown), min(read)) <= min(max(shown), max(read)) + 0.002, (shown, read)


def position(page):
    return float(page.text("header-position").replace("−", "-"))


def monkeys(tmp_path, count, seconds, seed):
    async def go(server):
        pages = [pupil.Page(server.url) for _ in range(count)]
        for number, page in enumerate(pages):
            await page.enter(WORD, f"Monkey {number}")
            await page.until(lambda page: page.text("control") == "In control")
        done = await asyncio.gather(*(
            monkey(page, random.Random(seed + number), seconds)
            for number, page in enumerate(pages)
        ))
        for page in pages:
            await shown_is_drive(page)
            await page.leave()
        print(
            f"\n{count} monkeys, {seconds:.0f} s, {sum(done)} presses, seed {seed}, "
            f"{sum(page.drops for page in pages)} lines cut"
        )
        assert min(done) > seconds

    with served(tmp_path) as server:
        asyncio.run(go(server))


def test_monkeys_in_a_class_leave_no_traceback_and_what_is_shown_is_the_drive(tmp_path):
    monkeys(tmp_path, 3, 10.0, 1)


@pytest.mark.slow
def test_monkeys_in_a_class_for_long(tmp_path):
    monkeys(tmp_path, PUPILS, 60 * MINUTES, int(time.time()))
