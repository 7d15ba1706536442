"""The panel on narrow windows: a tablet, a phone."""

import pytest
from browser import Server, at, needs_chromium, open_page, tab

pytestmark = needs_chromium
PAGES = ("state", "motion", "scope", "machine", "loops", "experiments", "objects", "lessons")
# text that is drawn over other text: leaves of the page that share more than an edge
OVERLAPPING = """() => {
  const leaves = [...document.querySelectorAll(".page.open *")].filter(
    e => !e.children.length && e.textContent.trim() && !e.closest("svg, canvas, .uplot, i"));
  const boxes = leaves.map(e => {
    const range = document.createRange();
    range.selectNodeContents(e);
    return [e.textContent.trim(), range.getBoundingClientRect()];
  }).filter(([, b]) => b.width && b.height);
  const found = [];
  for (let i = 0; i < boxes.length; i++) for (let j = i + 1; j < boxes.length; j++) {
    const [a, b] = [boxes[i][1], boxes[j][1]];
    if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 4
      && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 4)
      found.push([boxes[i][0], boxes[j][0]]);
  }
  return found;
}"""


@pytest.fixture(scope="module")
def page(browser):
    """Of a gantry, which has the most to show."""
    server = Server("--axis", "gantry", "--pictures", "4")
    yield tab(browser, server)
    server.kill()


@pytest.mark.parametrize("width", [390, 820])
def test_nothing_is_beside_the_window_and_the_quick_stop_is_in_sight(page, width):
    page.set_viewport_size({"width": width, "height": 844})
    for name in PAGES:
        open_page(page, name)
        room, needed = page.evaluate(
            "[document.documentElement.clientWidth, document.documentElement.scrollWidth]"
        )
        assert needed <= room == width, name
        page.mouse.wheel(0, 3000)
        box = at(page, "quick-stop").bounding_box()
        assert 0 <= box["x"] <= width - box["width"], name
        assert 0 <= box["y"] <= 844 - box["height"], name
        if name in ("state", "motion"):
            assert page.evaluate(OVERLAPPING) == [], name
