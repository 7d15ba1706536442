"""The panel for everybody: axe-core on every page in both themes, targets, zoom, a narrow window.

axe-core comes from npm when the test runs; where it cannot be had, that part is skipped.
"""

import shutil
import subprocess
from pathlib import Path

import pytest
from browser import Server, at, chromium, needs_chromium, open_page, sync_api, tab

pytestmark = needs_chromium
PAGES = (
    "state", "motion", "scope", "machine", "loops", "experiments", "objects", "lessons", "log",
)  # fmt: skip
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


@pytest.fixture(scope="module")
def server():
    server = Server("--axis", "gantry-x1x2", "--pictures", "4")  # axes side by side in the header
    yield server
    server.kill()


@pytest.fixture(scope="module")
def page(server):
    with sync_api.sync_playwright() as playwright:
        browser = chromium(playwright)
        yield tab(browser, server)
        browser.close()


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
        ]  # fmt: skip
    assert found == []
