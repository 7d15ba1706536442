"""The panel in a real browser, for its tests: a server, a tab, clicks by name."""

import io
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from later import Later, only_with
from PIL import Image

sync_api = Later("playwright.sync_api")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
needs_chromium = [
    only_with("nicegui", "playwright", reason="needs servogym[panel] and playwright"),
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium here"),
]
expect = Later("playwright.sync_api", "expect")

# pages are drawn without a GPU at a tenth of the work; WebGL alone is emulated
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]


NONSENSE = (
    "1e999", "-1e999", "NaN", "nan", "inf", "−∞", "+", "-", ".", "e5", "1e", "0x", "0xGG", "h",
    "1,2,3", "1.2.3", "--5", "1 000", "5 mm", "½", "²", "Ⅷ", "🙂", "é", "ﷺ", "\u202e12", "\u200b",
    "<script>window.hacked=1</script>", "<img src=x onerror=window.hacked=1>", "'; DROP TABLE",
    '"', "\\", "{{7*7}}", "${7}", "%s%n", "None", "true", "[]", "../../etc/passwd", "9" * 400,
    "A" * 10_000,
)
FIELD_PAGES = ("motion", "scope", "loops", "experiments", "objects")
TEXTS = ("snapshot-name", "policy", "search")  # fields for words


class Server:
    """`servogym panel`, or another command with pages, in a process of its own."""

    def __init__(self, *arguments, command="panel", prefix=(), log=None):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.arguments, self.prefix, self.log = (command, *arguments), prefix, log
        self.url = f"http://localhost:{self.port}/"
        self.start()

    def start(self):
        command = [
            *self.prefix, sys.executable, "-m", "servogym.training.cli", *self.arguments,
            "--no-browser", "--port", str(self.port),
        ]
        # nicegui looks whether pytest runs it
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=self.log,
            env=environment | {"PYTHONUNBUFFERED": "1"}, text=True,
        )
        for line in self.process.stdout:
            if found := re.search(rf"{self.url}\?token=(\S+)", line):
                self.token = found[1]
                return
        self.process.stdout.close()
        raise AssertionError(f"the server ended with {self.process.wait()}")

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


class Command:
    """A command without pages, in a process of its own.

    Args:
        arguments: of the command.
        until: text in its output by which it is ready.
    """

    def __init__(self, *arguments, until):
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "servogym.training.cli", *arguments], text=True,
            stdout=subprocess.PIPE, env=environment | {"PYTHONUNBUFFERED": "1", "COLUMNS": "200"},
        )
        said = ""
        while until not in said:
            line = self.process.stdout.readline()
            assert line, said
            said += line

    def end(self):
        """Interrupt it, so that it writes what it has to write."""
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=30)


# what a console says of a server that is away, or that refuses what it has to
EXPECTED = re.compile(r"ERR_CONNECTION|ERR_NETWORK|WebSocket connection to|status of 403")


def chromium(playwright):
    """A browser; `errors` has what the consoles of its pages say is wrong."""
    expect.set_options(timeout=60_000)  # ms; a slow machine is not a defect
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
    new, errors = browser.new_context, []

    def hear(message):
        if message.type == "error" and not EXPECTED.search(message.text):
            errors.append(message.text[:300])

    def new_context(**options):
        context = new(**options)
        context.on("console", hear)
        context.on("weberror", lambda error: errors.append(str(error.error)[:300]))
        return context

    browser.new_context, browser.errors = new_context, errors
    return browser


def tab(browser, server, width=1280, height=800):
    size = {"width": width, "height": height}
    context = browser.new_context(viewport=size, reduced_motion="reduce")  # a third of the work
    context.set_default_timeout(60_000)
    page = context.new_page()
    page.goto(f"{server.url}?token={server.token}")
    expect(at(page, "state")).to_be_visible()
    take_control(page)
    return page


def take_control(page):
    """Press Take control, unless the button says by now that this tab has it: that gives it back.

    The first tab gets it by itself, and the button is a picture behind the seat.
    """
    while at(page, "control").inner_text() != "In control":
        at(page, "control").evaluate("(b) => b.textContent.trim() == 'Take control' && b.click()")
        page.wait_for_timeout(200)


def at(page, name):
    return page.locator(f"[data-test={name}]")


def shows(page, name, text):
    try:
        expect(at(page, name)).to_have_text(text)
    except AssertionError as wrong:
        wrong.add_note(page.locator("body").inner_text())
        raise


def open_page(page, name):
    """Go to a page; once more where its line was cut.

    A browser that gets no processor for 14 s, as on a computer with ten times the load it has room
    for, is given up by NiceGUI (4 s without a pong, 10 s without a reconnection): its page comes
    anew, and a click between the two is lost.
    """
    at(page, f"go-{name}").click()
    try:
        expect(at(page, f"page-{name}")).to_be_visible(timeout=15_000)
    except AssertionError:
        print(f"the line was cut, the click on {name} is lost: again")
        at(page, f"go-{name}").click()
        expect(at(page, f"page-{name}")).to_be_visible()


def ready(page):
    """Enabled and referenced, by clicks, from wherever the last test has left the axis."""
    open_page(page, "motion")
    at(page, "motion-reset").click()
    at(page, "enable").click()
    shows(page, "state", "operation enabled")
    if at(page, "homed").inner_text() != "The axis is referenced.":
        at(page, "home").click()
    shows(page, "homed", "The axis is referenced.")
    shows(page, "doing", "")


def picture(page, name):
    """Of a part, for the documentation where SERVOGYM_PICTURES names a folder for it."""
    if os.environ.get("SERVOGYM_PICTURES"):  # what was said before belongs to another picture
        expect(page.locator(".q-notification")).to_have_count(0)
    image = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    assert len(image.getcolors(1 << 24)) > 50
    if folder := os.environ.get("SERVOGYM_PICTURES"):
        small = image.quantize(96, dither=Image.Dither.NONE)
        small.save(Path(folder) / f"panel_{name}.png", optimize=True)


def near(position):
    """A readout within the position window 6067h, 20 µm."""
    return re.compile(rf"^({position - 1}\.9[89]|{position}\.0[012])\d$")


def shown(page, name):
    """The number of a readout, whose minus is that of print."""
    return float(at(page, name).inner_text().replace("−", "-"))


def move(page, target):
    at(page, "target").fill(target)
    at(page, "move-to").click()


def parameters(page):
    """All storable objects, as a file has them."""
    open_page(page, "objects")
    with page.expect_download() as download:
        at(page, "save-parameters").click()
    return Path(download.value.path()).read_bytes()


def fields(page, name):
    """The fields for numbers of a page."""
    inputs = at(page, f"page-{name}").locator("input[data-test]:not([role=combobox]):visible")
    return [test for field in inputs.all()
            if (test := field.get_attribute("data-test")) not in TEXTS]


TYPE = """(told) => {
    const value = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value");
    for (const [name, text] of Object.entries(told)) {
        const field = document.querySelector(`input[data-test=${name}]`);
        value.set.call(field, text);
        field.dispatchEvent(new Event("input", { bubbles: true }));
        field.dispatchEvent(new KeyboardEvent("keydown", { key: "Enter", bubbles: true }));
    }
}"""
REFUSED = """(told) => Object.entries(told).every(([name, text]) => {
    const field = document.querySelector(`input[data-test=${name}]`).closest(".q-field");
    const words = field.querySelector(".q-field__messages")?.textContent ?? "";
    return words.includes(text) && /number|range/.test(words) && words.length < 160;
})"""


def refused(page, told):
    """Type a text and Enter into each field; words beside each tell back what was typed."""
    page.evaluate(TYPE, told)
    shown = {test: text.strip()[:40] for test, text in told.items()}
    page.wait_for_function(REFUSED, arg=shown)
