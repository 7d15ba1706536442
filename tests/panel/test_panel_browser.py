"""The panel in a real browser, by clicks: Debian's Chromium, driven by Playwright."""

import http.client
import os
import re
import subprocess
import sys
from itertools import cycle
from pathlib import Path

import pytest
from browser import (
    FIELD_PAGES,
    NONSENSE,
    Server,
    at,
    expect,
    fields,
    move,
    near,
    needs_chromium,
    open_page,
    parameters,
    picture,
    ready,
    refused,
    shown,
    shows,
    tab,
)

pytestmark = needs_chromium
PLACES = """() => [...document.querySelectorAll(".page.open button, .page.open input")].map(
    e => [e.dataset.test, e.textContent.trim(), Math.round(e.getBoundingClientRect().y)])"""


@pytest.fixture(scope="module")
def server():
    server = Server("--pictures", "4")
    yield server
    server.kill()


@pytest.fixture(scope="module")
def page(server, browser):
    page = tab(browser, server)
    yield page
    page.context.close()


def test_enable_home_move_by_clicks(page):
    open_page(page, "state")
    for number, state in ((2, "ready to switch on"), (3, "switched on"), (4, "operation enabled")):
        at(page, f"command-{number}").click()
        shows(page, "state", state)
    shows(page, "controlword-word", "000Fh")
    open_page(page, "motion")
    at(page, "home").click()
    shows(page, "homed", "The axis is referenced.")
    move(page, "250")
    picture(page, "motion")
    expect(at(page, "position")).to_have_text(near(250))


def test_a_bit_of_the_controlword_is_toggled_and_a_refusal_is_told(page):
    ready(page)
    at(page, "disable").click()
    shows(page, "state", "switch on disabled")
    open_page(page, "state")
    for bit in (3, 0, 1, 2):  # to 000Fh, enable operation: too early
        at(page, f"controlword-{bit}").click()
        expect(at(page, f"controlword-{bit}")).to_have_attribute("aria-pressed", "true")
    shows(page, "controlword-word", "000Fh")
    expect(at(page, "refused")).to_contain_text(
        "ENABLE_OPERATION was refused in SWITCH_ON_DISABLED"
    )


def test_what_is_no_target_is_refused_beside_the_field_and_nothing_moves(page):
    ready(page)
    before = shown(page, "position")
    beside = page.locator(".q-field", has=at(page, "target")).locator(".q-field__messages")
    for typed, words in (("900", "beyond the stroke"), ("", "enter a number"),
                         ("12;drop", "“12;drop” is not a number"), ("nan", "not a finite number")):
        move(page, typed)
        expect(beside).to_contain_text(words)
    # held in control: the last digit, 1 µm, comes and goes
    assert shown(page, "position") == pytest.approx(before, abs=0.005)


def test_a_click_is_not_lost_where_what_was_said_of_a_field_goes_away(page):
    """The button was moved from under the pointer between pressing and releasing."""
    ready(page)
    beside = page.locator(".q-field", has=at(page, "target")).locator(".q-field__messages")
    move(page, "nan")
    expect(beside).to_contain_text("not a finite number")
    box = at(page, "move-to").bounding_box()
    page.mouse.move(box["x"] + 9, box["y"] + box["height"] - 3)
    at(page, "target").fill("900")
    page.mouse.down()
    expect(beside).to_have_count(0)
    page.mouse.up()
    expect(beside).to_contain_text("beyond the stroke")


def test_each_field_refuses_a_text_beside_it_and_nothing_is_sent_or_moves(page):
    """A sample; all of it: test_panel_pace.py -k any_text."""
    ready(page)
    before, texts = parameters(page), cycle(NONSENSE)
    for name in FIELD_PAGES:
        open_page(page, name)
        told, places = {test: next(texts) for test in fields(page, name)}, page.evaluate(PLACES)
        refused(page, told)
        assert page.evaluate(PLACES) == places, name
    assert parameters(page) == before
    page.reload()  # fields as they were


def test_the_scope_waits_for_its_trigger_and_shows_what_came_before(page):
    ready(page)
    move(page, "100")
    expect(at(page, "position")).to_have_text(near(100))
    open_page(page, "scope")
    plot = at(page, "scope-plot")
    at(page, "window").fill("0.5")
    at(page, "window").press("Enter")
    at(page, "trigger-level").fill("150")  # mm
    at(page, "trigger-run").get_by_text("Single").click()
    shows(page, "scope-state", "waiting")
    open_page(page, "motion")
    expect(at(page, "scope-state")).to_have_text("waiting")  # for the axis stands
    move(page, "200")
    open_page(page, "scope")
    shows(page, "scope-state", "stopped")
    expect(plot).to_have_attribute("data-state", "stopped")
    over = plot.locator(".u-over")
    over.click(position={"x": 5, "y": 5})
    box = over.bounding_box()
    for share, key in ((0.3, "a"), (0.7, "b")):
        over.hover(position={"x": share * box["width"], "y": box["height"] / 2})
        page.keyboard.press(key)
    times = plot.locator("table tr", has_text="time (s)").locator("td")
    expect(times.nth(3)).to_have_text(re.compile(r"^0\.(199|200)\d$"))  # 0.4 of the window
    page.keyboard.press("Shift+ArrowLeft")  # ten points of the picture
    expect(times.nth(3)).not_to_have_text(re.compile(r"^0\.(199|200)"))
    picture(page, "scope")
    with page.expect_download() as download:
        at(page, "csv").click()
    rows = Path(download.value.path()).read_text().splitlines()
    assert rows[0].startswith("time (s),position_actual_value (mm)")
    assert len(rows) == 1 + 0.5 * 2000


def test_jogging_lasts_as_long_as_the_button_is_held(page):
    ready(page)
    move(page, "100")
    expect(at(page, "position")).to_have_text(near(100))
    at(page, "jog-speed").fill("50")
    at(page, "jog-positive").hover()
    page.mouse.down()
    expect(at(page, "velocity")).to_have_text(re.compile(r"^(4[89]|5[012])\.\d+$"))
    page.mouse.up()
    expect(at(page, "velocity")).to_have_text(re.compile(r"^−?[01]\.\d+$"))
    shows(page, "state", "operation enabled")


def test_jogging_by_keys_ends_where_the_key_is_released_or_the_window_left(page):
    ready(page)
    move(page, "250")
    expect(at(page, "position")).to_have_text(near(250))
    at(page, "jog-speed").fill("20")
    at(page, "stop").focus()
    for window_left in (False, True):
        at(page, "stop").focus()
        page.keyboard.down("ArrowRight")
        expect(at(page, "velocity")).to_have_text(re.compile(r"^(19|2[01])\.\d+$"))
        if window_left:
            page.evaluate("window.dispatchEvent(new Event('blur'))")
        else:
            at(page, "target").focus()
            page.keyboard.up("ArrowRight")
        expect(at(page, "velocity")).to_have_text(re.compile(r"^−?[01]\.\d+$"))
        page.keyboard.up("ArrowRight")


def test_esc_is_the_quick_stop_on_a_button_and_in_a_field(page):
    for name in ("move-to", "target"):
        ready(page)
        at(page, name).focus()
        page.keyboard.press("Escape")
        shows(page, "state", "switch on disabled")


def test_esc_closes_an_open_list_and_only_then_is_the_quick_stop(page):
    ready(page)
    at(page, "mode").click()
    option = page.get_by_role("option", name="pv · profile velocity")
    expect(option).to_be_visible()
    page.keyboard.press("Escape")
    expect(option).not_to_be_visible()
    shows(page, "state", "operation enabled")
    page.keyboard.press("Escape")
    shows(page, "state", "switch on disabled")


def test_each_mode_that_is_chosen_is_reached(page):
    ready(page)
    for number in range(12):
        name, short = (("pv · profile velocity", "pv"), ("pp · profile position", "pp"))[number % 2]
        at(page, "mode").click()
        page.get_by_role("option", name=name).click()
        shows(page, "mode-shown", short)


def test_a_watcher_stops_by_esc_and_a_window_that_is_closed_ends_its_motion(browser, server, page):
    commander = tab(browser, server)
    ready(commander)
    move(commander, "100")
    expect(at(commander, "position")).to_have_text(near(100))
    at(commander, "set-profile_velocity").fill("10000")
    at(commander, "set-profile_velocity").press("Enter")
    shows(commander, "value-profile_velocity", "10000")
    move(commander, "400")
    expect(at(commander, "doing")).to_contain_text("move to")
    expect(at(page, "watching")).to_be_visible()
    at(page, "theme").focus()
    page.keyboard.press("Escape")
    shows(commander, "state", "switch on disabled")
    ready(commander)
    move(commander, "400")
    expect(at(page, "doing")).to_contain_text("move to")
    commander.context.close()
    expect(at(page, "doing")).to_have_text("")
    expect(page.locator(".q-notification").get_by_text("set in motion")).to_be_visible()
    at(page, "control").click()
    open_page(page, "motion")
    expect(at(page, "velocity")).to_have_text(re.compile(r"^−?0\.\d+$"))
    shows(page, "state", "operation enabled")
    assert float(at(page, "position").inner_text()) < 390
    at(page, "set-profile_velocity").fill("1000000")
    at(page, "set-profile_velocity").press("Enter")
    open_page(page, "log")
    expect(at(page, "events")).to_contain_text("quick stop")
    expect(at(page, "events")).to_contain_text("window 1")


def test_loops_of_a_drive_in_fault_are_refused_with_the_fault_and_its_remedy(page):
    ready(page)
    open_page(page, "experiments")
    at(page, "inject-overvoltage").click()
    shows(page, "state", "fault")
    open_page(page, "loops")
    for press in ("measure", "tune"):
        at(page, press).click()
        expect(at(page, "bode-wrong")).to_contain_text("FAULT, 3210h DC link over-voltage; brake")
    open_page(page, "experiments")
    at(page, "clear-injected").click()
    shows(page, "injected", "Nothing is injected.")


def test_a_set_point_is_followed_and_a_stop_ends_it(page):
    ready(page)
    move(page, "100")
    expect(at(page, "position")).to_have_text(near(100))
    at(page, "set-point-kind").get_by_text("velocity").click()
    at(page, "set-point").fill("20")
    at(page, "set-point-go").click()
    expect(at(page, "velocity")).to_have_text(re.compile(r"^(19|20)\.\d+$"))
    at(page, "stop").click()
    expect(at(page, "velocity")).to_have_text(re.compile(r"^−?0\.\d+$"))
    at(page, "set-point-kind").get_by_text("position").click()
    at(page, "set-point").fill("150")
    at(page, "set-point").press("Enter")
    shows(page, "mode-shown", "csp")
    expect(at(page, "position")).to_have_text(near(150))


def test_a_snapshot_brings_the_axis_back(page):
    ready(page)
    move(page, "100")
    expect(at(page, "position")).to_have_text(near(100))
    open_page(page, "experiments")
    at(page, "snapshot-name").fill("B")
    at(page, "keep").click()
    expect(at(page, "back-B")).to_be_visible()
    open_page(page, "motion")
    move(page, "130")
    expect(at(page, "position")).to_have_text(near(130))
    open_page(page, "experiments")
    at(page, "back-B").click()
    expect(at(page, "header-position")).to_have_text(near(100))


def test_policies_go_side_by_side_on_copies_and_one_takes_over_and_gives_back(page):
    ready(page)
    move(page, "100")
    expect(at(page, "position")).to_have_text(near(100))
    open_page(page, "experiments")
    before = shown(page, "header-position")
    at(page, "goal").fill("180")
    at(page, "run-compare").click()
    cells = at(page, "courses").locator("span")
    expect(cells).to_have_count(10)
    told = cells.all_inner_texts()
    settled = {told[n]: told[n + 1].removesuffix(" ms") for n in (0, 5)}  # "–": it has not
    assert float(settled["ruckig"]) < float(settled["proportional"].replace("–", "inf"))
    now = shown(page, "header-position")
    assert now == pytest.approx(before, abs=0.005), "the machine itself holds its place"
    at(page, "hand-over").click()
    expect(at(page, "agent")).to_contain_text("ruckig has the machine.")
    expect(at(page, "header-position")).to_have_text(near(180))
    picture(page, "experiments")
    at(page, "take-back").click()
    expect(at(page, "agent")).not_to_be_visible()
    expect(at(page, "measured")).to_contain_text("real time")  # it goes on


def test_gains_are_tuned_on_a_copy_taken_over_and_put_back(page):
    pytest.importorskip("scipy", reason="margins need servogym[tune]")
    ready(page)
    gain = at(page, "value-position_control_gain")
    before = gain.inner_text()
    open_page(page, "loops")
    at(page, "tune").click()
    shows(page, "tune-verdict", "The margins are reached.")
    expect(at(page, "margins")).to_contain_text("position before")
    tuned = at(page, "gains").locator(".strong").nth(2).inner_text()
    assert int(tuned) > int(before)
    open_page(page, "motion")
    expect(gain).to_have_text(before)
    for press, after in (("Take over", tuned), ("Put back", before)):
        open_page(page, "loops")
        expect(at(page, "take-gains")).to_have_text(press)
        at(page, "take-gains").click()
        open_page(page, "motion")
        expect(gain).to_have_text(after)
    open_page(page, "loops")
    expect(at(page, "take-gains")).to_have_text("Take over")
    picture(page, "loops")
    at(page, "discard-gains").click()
    expect(at(page, "take-gains")).not_to_be_visible()


def test_the_keyboard_reaches_everything_in_order_and_shows_where_it_is(page):
    open_page(page, "state")
    page.locator("header").click(position={"x": 2, "y": 2})
    seen = []
    for _ in range(9):
        page.keyboard.press("Tab")
        page.wait_for_function(
            """() => {
                const e = document.activeElement;
                const seen = getComputedStyle(e.closest('.q-field') || e);
                return seen.outlineStyle === 'solid' || seen.boxShadow !== 'none';
            }"""
        )
        seen.append(page.evaluate("document.activeElement.closest('[data-test]')?.dataset.test"))
    assert seen == [
        "pause", "single", "speed", "control", "theme", "quick-stop", "go-state", "go-motion",
        "go-scope",
    ]
    page.keyboard.press("Enter")
    expect(at(page, "page-scope")).to_be_visible()


def test_a_fault_is_injected_told_with_its_remedy_and_reset_by_clicks(page):
    ready(page)
    open_page(page, "experiments")
    at(page, "inject-overvoltage").click()
    shows(page, "state", "fault")
    open_page(page, "state")
    expect(at(page, "fault")).to_have_text("3210h DC link over-voltage")
    expect(at(page, "remedy")).to_contain_text("brake resistor")
    picture(page, "state")
    at(page, "reset-fault").click()
    expect(page.locator(".q-notification").get_by_text("the cause of x")).to_be_visible()
    open_page(page, "experiments")
    at(page, "clear-injected").click()
    shows(page, "injected", "Nothing is injected.")
    open_page(page, "state")
    at(page, "reset-fault").click()
    shows(page, "state", "switch on disabled")


def test_the_machine_is_seen_in_3d_where_the_axis_is(page):
    ready(page)
    move(page, "350")
    expect(at(page, "position")).to_have_text(near(350))
    open_page(page, "machine")
    expect(at(page, "scene")).to_have_attribute("data-at", re.compile(r"^0\.3(5|4999)\d* "))
    picture(page, "machine")


def test_an_object_is_searched_written_and_refused_in_words(page):
    ready(page)
    open_page(page, "objects")
    at(page, "search").fill("max torque")
    at(page, "objects").get_by_role("cell", name="6072h:00").click()
    shows(page, "live", "3000 rated torque/1000")
    beside = page.locator(".q-field", has=at(page, "object-value")).locator(".q-field__messages")
    at(page, "object-value").fill("70000")
    at(page, "write").click()
    expect(beside).to_contain_text("out of range 0..65535")
    at(page, "object-value").fill("0B54h")
    at(page, "write").click()
    shows(page, "live", "2900 rated torque/1000")
    picture(page, "objects")
    with page.expect_download() as download:
        at(page, "save-parameters").click()
    at(page, "object-value").fill("3000")
    at(page, "write").click()
    shows(page, "live", "3000 rated torque/1000")
    open_page(page, "motion")
    at(page, "disable").click()
    shows(page, "state", "switch on disabled")
    open_page(page, "objects")
    page.set_input_files("[data-test=load-parameters] input", download.value.path())
    expect(at(page, "loaded")).to_contain_text("is in force")
    shows(page, "live", "2900 rated torque/1000")


def test_an_exercise_is_begun_and_its_first_step_done(page):
    open_page(page, "lessons")
    at(page, "lesson-2").click()
    expect(at(page, "step-0")).to_have_text("Enable the drive.")
    open_page(page, "motion")
    at(page, "enable").click()
    open_page(page, "lessons")
    expect(at(page, "step-0")).to_contain_text("done after")
    at(page, "hint").click()
    expect(at(page, "step-1")).to_contain_text("State page, Reset fault.")
    at(page, "option-1").click()
    expect(at(page, "option-1")).to_have_count(0)
    picture(page, "lessons")
    at(page, "leave").click()
    open_page(page, "experiments")
    at(page, "clear-injected").click()


def test_the_table_of_objects_is_full_after_the_theme_has_changed_on_another_page(page):
    """It was measured while it had no height, and showed a dozen rows until it was scrolled."""
    open_page(page, "objects")
    at(page, "search").fill("")
    rows = at(page, "objects").locator("tbody.q-virtual-scroll__content tr")
    expect(rows.nth(30)).to_be_attached()
    for _ in range(2):
        open_page(page, "state")
        at(page, "theme").click()
        page.wait_for_timeout(500)
        open_page(page, "objects")
        expect(rows.nth(30)).to_be_attached()


def test_two_tabs_one_commands_and_taking_over_is_seen(page, browser, server):
    ready(page)
    other = tab(browser, server)  # takes over
    shows(page, "control", "Take control")
    expect(at(page, "watching")).to_be_visible()
    at(page, "disable").click()  # refused in words
    expect(page.get_by_text("another window has control: press")).to_be_visible()
    shows(other, "state", "operation enabled")
    at(page, "control").click()
    shows(other, "control", "Take control")
    # pressed as it looked a moment ago, it does what it said then
    block = at(page, "control").locator(".block")
    block.evaluate("element => { element.textContent = 'Take control'; }")
    at(page, "control").click()
    at(page, "disable").click()
    shows(other, "state", "switch on disabled")
    other.context.close()


def test_a_reload_in_the_middle_of_a_move_keeps_control_page_and_motion(page):
    ready(page)
    move(page, "20")
    shows(page, "doing", "")
    at(page, "set-profile_velocity").fill("100000")
    at(page, "set-profile_velocity").press("Enter")
    shows(page, "value-profile_velocity", "100000")
    move(page, "220")
    shows(page, "doing", "x: move to 220 mm")
    page.reload()
    shows(page, "control", "In control")
    expect(at(page, "page-motion")).to_be_visible()
    expect(at(page, "position")).to_have_text(near(220))


def test_the_page_comes_back_when_the_server_was_killed_and_started_again(page, server):
    ready(page)
    server.kill()
    server.start()
    expect(at(page, "state")).to_have_text(re.compile("switch on"))  # a new machine
    shows(page, "control", "In control")  # where nobody has it, who comes first has it
    ready(page)


@pytest.fixture
def node():
    """`servogym node` in a process of its own, and how a panel reaches it."""
    can = pytest.importorskip("can")
    pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")
    group, port = "239.74.163.80", 40_000 + os.getpid() % 9_000
    try:
        can.Bus(interface="udp_multicast", channel=group, port=port).shutdown()
    except (OSError, can.CanError) as error:
        pytest.skip(f"udp_multicast does not work here: {error}")
    way = ["-i", "udp_multicast", "-c", group, "--bus-kwargs", f"port={port}", "--node-id", "5"]
    command = [sys.executable, "-m", "servogym.training.cli", "node", *way]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    while "as node" not in (line := process.stdout.readline()):
        assert line, "the node ended"
    yield way
    process.kill()
    process.communicate()


def test_a_node_on_a_bus_is_watched_commanded_and_says_what_a_bus_cannot_give(browser, node):
    server = Server(*node, "--units", "1e-6", "--pictures", "4")
    try:
        page = tab(browser, server)  # nobody has control until a tab takes it
        open_page(page, "motion")
        at(page, "homing-method").click()
        page.get_by_role("option", name="37 · the present position").click()
        at(page, "enable").click()
        shows(page, "state", "operation enabled")
        at(page, "home").click()
        expect(at(page, "doing")).to_have_text("")
        move(page, "20")
        expect(at(page, "position")).to_have_text(near(20))
        open_page(page, "experiments")
        expect(at(page, "absent")).to_contain_text("the machine on a bus may be a real one")
        open_page(page, "state")
        expect(at(page, "measured")).to_contain_text("samples/s")
        picture(page, "bus")
        page.context.close()
    finally:
        server.kill()


UPGRADE = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport="


def answer(server, path, headers):
    """Status and body of a request over a connection of its own."""
    connection = http.client.HTTPConnection("localhost", server.port, timeout=60)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    body = b"" if answer.status == 101 else answer.read()
    connection.close()
    return answer.status, body, answer.headers


def cookie(server, **headers):
    return {"Cookie": f"servogym_panel_{server.port}={server.token}"} | headers


@pytest.mark.parametrize(
    "header",
    [{}, {"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"},
     {"Host": "evil.example", "Origin": "http://evil.example"}, {"Cookie": "servogym_panel=x"}],
)
def test_strangers_are_refused_on_the_loopback_too(server, header):
    """A page, a poll and a WebSocket, of who does not know the token."""
    for path in ("/", "/?token=guess", f"{SOCKET}polling"):
        status, body, _ = answer(server, path, header)
        assert status == 403
        assert b"servogym panel" in body
    status, *_ = answer(server, f"{SOCKET}websocket", UPGRADE | header)
    assert status == 403  # before there is a WebSocket, as RFC 6455 4.2.2 has it


@pytest.mark.parametrize(
    "header", [{"Origin": "http://evil.example"}, {"Origin": "http://localhost:1"},
               {"Sec-Fetch-Site": "cross-site"}]
)
def test_a_strangers_page_in_the_same_browser_gets_no_websocket(server, header):
    """Its request has our cookie where it is a page of another port."""
    status, *_ = answer(server, f"{SOCKET}websocket", UPGRADE | cookie(server) | header)
    assert status == 403


@pytest.mark.parametrize(
    ("host", "more"),
    [("localhost:{port}", {}), ("localhost:9", {}), ("127.0.0.1", {}), ("labpc", {}),
     ("127.0.0.1:{port}", {"X-Forwarded-Host": "lab.example", "Origin": "https://lab.example"})],
)
def test_behind_a_proxy_another_port_and_by_a_bare_name_it_is_served(server, host, more):
    """`ssh -L 9:localhost:8402`, a reverse proxy with and without the Host of the browser."""
    host = host.format(port=server.port)
    own = {"Host": host, "Origin": f"http://{host}", "Sec-Fetch-Site": "same-origin"} | more
    status, _, headers = answer(server, "/", cookie(server, Host=host))
    assert status == 200
    assert headers["X-Frame-Options"] == "DENY"
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    status, _, headers = answer(server, f"{SOCKET}websocket", UPGRADE | cookie(server) | own)
    assert status == 101
    assert headers["Sec-WebSocket-Accept"] == "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="  # RFC 6455 1.3
