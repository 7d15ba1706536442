"""The panel for everybody: axe-core on every page in both themes, targets, zoom, a narrow window.

axe-core comes from npm when the test runs; where it cannot be had, that part is skipped.
"""

import shutil
import subprocess
from pathlib import Path

import pytest
from browser import Server, at, expect, needs_chromium, open_page, tab
from test_panel_classroom import WORD, come, teacher

pytestmark = needs_chromium
PAGES = (
    "state", "motion", "scope", "machine", "loops", "experiments", "objects", "lessons", "log",
)
SMALL = """() => [...document.querySelectorAll(
    "button, a[href], input, select, [role=button], [role=checkbox], [tabindex='0']")].filter(e => {
  const box = (e.closest(".q-field") || e).getBoundingClientRect();
  return box.width && box.height && !e.disabled && (box.width < 24 || box.height < 24);
}).map(e => e.outerHTML.slice(0, 120))"""
WRAPPED = """() => [...document.querySelectorAll(
    ".page.open .readout-value, .page.open .parameter-value")].filter(e => {
  const lines = parseFloat(getComputedStyle(e).lineHeight) || e.offsetHeight;
  return e.offsetHeight > 1.6 * lines;
}).map(e => e.textContent)"""

ADDRESSES = """() => [...document.querySelectorAll(".page.open .objects td:first-child")].map(e => {
  const text = document.createRange();
  text.selectNodeContents(e);
  return new Set([...text.getClientRects()].map(line => Math.round(line.top))).size;
}).filter(lines => lines)"""


@pytest.fixture(scope="module")
def server():
    server = Server("--axis", "gantry-x1x2", "--pictures", "4")  # axes side by side in the header
    yield server
    server.kill()


@pytest.fixture(scope="module")
def page(browser, server):
    return tab(browser, server)


@pytest.fixture(scope="module")
def axe(tmp_path_factory):
    """The text of axe-core."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("axe-core comes by npm, which is not here")
    folder = tmp_path_factory.mktemp("axe")
    command = [npm, "install", "--prefix", str(folder), "--no-audit", "--no-fund", "axe-core"]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=60)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"npm cannot install axe-core here: {error}")
    return Path(folder, "node_modules/axe-core/axe.min.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def class_pages(page):
    """The form of a classroom, its wall, and a pupil's page with an exercise under way."""
    server = Server("--pictures", "4", "--code", WORD, command="classroom")
    try:
        browser = page.context.browser
        form = browser.new_context().new_page()
        form.goto(server.url)
        pupil = come(browser, server, "Ada")
        open_page(pupil, "lessons")
        at(pupil, "lesson-0").click()
        expect(at(pupil, "step-0")).to_be_visible()
        wall = teacher(browser, server)
        expect(at(wall, "place-1-task")).to_contain_text("1 of")
        yield {"form": form, "wall": wall, "pupil": pupil}
    finally:
        server.kill()


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (640, 400), (360, 740)])
@pytest.mark.parametrize("name", ["form", "wall", "pupil"])
def test_a_class_room_has_room_on_a_narrow_or_zoomed_window_and_targets_to_hit(
    class_pages, name, width, height
):
    page = class_pages[name]
    page.set_viewport_size({"width": width, "height": height})
    room, needed = page.evaluate(
        "[document.documentElement.clientWidth, document.documentElement.scrollWidth]"
    )
    assert needed <= room
    assert page.evaluate(SMALL) == []
    assert page.locator("html").get_attribute("lang") == "en"
    assert page.get_by_role("main").count() == 1
    assert page.get_by_role("heading", level=1).count() == 1


def test_the_wall_is_worked_by_the_keyboard_alone(class_pages):
    """Tab reaches each control in the order that is seen, Enter and Esc do what clicks do."""
    wall = class_pages["wall"]
    wall.set_viewport_size({"width": 1280, "height": 800})
    wall.locator("body").click(position={"x": 5, "y": 700})
    reached = []
    for _ in range(16):
        wall.keyboard.press("Tab")
        reached.append(
            wall.evaluate("document.activeElement.closest('[data-test]')?.dataset.test ?? ''")
        )
    for name in ("open", "theme", "stop-all", "give", "csv", "place-1-look", "place-1-reset"):
        assert name in reached, reached
    at(wall, "place-1-reset").focus()
    wall.keyboard.press("Enter")
    expect(at(wall, "yes")).to_be_visible()
    wall.keyboard.press("Escape")
    expect(at(wall, "yes")).not_to_be_visible()


def test_each_page_is_reached_and_left_by_the_keyboard_alone(page):
    """Each page has a key; Tab gets into it and out of it, and each stop is seen (WCAG 2.1.2)."""
    page.set_viewport_size({"width": 1280, "height": 800})
    for number, name in enumerate(PAGES, 1):
        page.evaluate("document.activeElement?.blur()")
        page.keyboard.press(str(number))
        expect(at(page, f"page-{name}")).to_be_visible()
        at(page, f"go-{name}").focus()
        for _ in range(len(PAGES) - number + 1):
            page.keyboard.press("Tab")  # past the other links
        inside = page.evaluate("!!document.activeElement.closest('.page.open')")
        if name not in ("log",):
            assert inside, name
        seen = page.evaluate("""() => {
            const e = document.activeElement, box = e.getBoundingClientRect();
            return box.width > 0 && box.height > 0 && e !== document.body;
        }""")
        assert seen, name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["form", "wall", "pupil"])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_critical_or_serious_in_a_class_room(class_pages, axe, name, theme):
    page = class_pages[name]
    if name == "form":
        page.emulate_media(color_scheme=theme)
    elif page.evaluate("document.body.classList.contains('body--dark')") != (theme == "dark"):
        at(page, "theme").click()
    page.wait_for_timeout(500)
    page.evaluate(axe)
    result = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
    assert len(result["passes"]) > 8
    assert [
        (each["id"], each["impact"], node["html"][:120])
        for each in result["violations"] if each["impact"] in ("critical", "serious")
        for node in each["nodes"]
    ] == []


def test_the_page_has_a_language_one_main_part_and_one_heading(page):
    assert page.locator("html").get_attribute("lang") == "en"
    assert page.get_by_role("main").count() == 1
    assert page.get_by_role("heading", level=1).count() == 1


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (640, 400), (360, 740)])
def test_targets_are_large_enough_and_nothing_is_beside_a_narrow_or_zoomed_window(
    page, width, height
):
    """640 × 400 is 1280 × 800 at a zoom of 200 % (WCAG 1.4.4, 1.4.10; 2.5.8 has the 24 px)."""
    page.set_viewport_size({"width": width, "height": height})
    for name in PAGES:
        open_page(page, name)
        room, needed = page.evaluate(
            "[document.documentElement.clientWidth, document.documentElement.scrollWidth]"
        )
        assert needed <= room, name
        assert page.evaluate(SMALL) == [], name
        assert page.evaluate(WRAPPED) == [], name
        if name == "objects":
            assert set(page.evaluate(ADDRESSES)) == {1}, "an address in two lines"
    page.set_viewport_size({"width": 1280, "height": 800})


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_critical_or_serious_on_any_page(page, axe, theme):
    if page.evaluate("document.body.classList.contains('body--dark')") != (theme == "dark"):
        at(page, "theme").click()
    page.evaluate(axe)
    found = []
    for name in PAGES:
        open_page(page, name)
        page.wait_for_timeout(500)
        result = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
        assert len(result["passes"]) > 10, name  # it has looked
        found += [
            (name, each["id"], each["impact"], node["html"][:120])
            for each in result["violations"] if each["impact"] in ("critical", "serious")
            for node in each["nodes"]
        ]
    assert found == []
