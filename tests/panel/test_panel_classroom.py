"""A classroom: who comes in, a machine each, nothing crosses, results that can be replayed."""

import asyncio
import csv
import gc
import io
import json
import logging
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from browser import (
    Server,
    at,
    expect,
    needs_chromium,
    open_page,
    picture,
    shows,
)
from hypothesis import given
from hypothesis import strategies as st

from servogym.envs.course.exercise import load_all, named
from servogym.envs.panel import journal, lessons, reception
from servogym.envs.panel.classroom import CYCLES, Classroom
from servogym.envs.panel.disturbances import DISTURBANCES, disturb, inject
from servogym.envs.panel.guard import Guard
from servogym.envs.panel.log import plain
from servogym.envs.panel.reception import Reception
from servogym.envs.panel.server import concerns_somebody
from servogym.envs.panel.session import Session
from servogym.envs.plants.catalogue import fresh
from servogym.training.cli import main
from servogym.training.policies.takeover import Laboratory

WORD = "kestrel 1"


def make(cycles):
    return Session(fresh("linear"), "linear", cycles)


@pytest.fixture
def room(tmp_path):
    room = Classroom(make, "linear", "generic", load_all(), 3, 8, tmp_path, WORD)
    yield room
    room.end()


def seat(room, name):
    """The place of who comes in with the code of the class, opened by their browser."""
    return room.person(room.enter(name, WORD))


@pytest.mark.parametrize(
    ("text", "cell"),
    [("=1+1", "'=1+1"), ("+1", "'+1"), ("-1", "'-1"), ("@A1", "'@A1"), ("", ""), ("Ada", "Ada")],
)
def test_a_cell_is_no_formula_and_an_empty_one_stays_empty(text, cell):
    assert plain(text) == cell


# ------------------------------------------------------------------- who comes in


def test_who_comes_in_needs_the_code_of_the_class_and_a_name_that_nobody_has(room):
    assert "not the code" in room.may_enter("Ada", "kestrel 2", "")
    assert room.may_enter("Ada", "KESTREL-1", "") == ""
    ada = seat(room, "Ada")
    assert "Ada is here already" in room.may_enter("ada", WORD, "")
    assert "Ada is here already" in room.may_enter("ADA", WORD, "aaaa")
    assert room.may_enter("Ada", WORD, ada.code.upper()) == ""
    assert room.enter("ada", WORD, ada.code) == ada.token
    for name in ("", "x" * 33, "a\nb", "\x00"):
        assert "1 to 32" in room.may_enter(name, WORD, "")
    seat(room, "Grace"), seat(room, "Katherine")
    assert "All 3 places" in room.may_enter("Dorothy", WORD, "")
    room.remove(room.named("Grace"))
    room.open = False
    assert "closed" in room.may_enter("Dorothy", WORD, "")
    room.open = True
    assert room.may_enter("Dorothy", WORD, "") == ""
    assert seat(room, "Dorothy").number == 2


@pytest.mark.parametrize("name", ["ADA", " ada ", "Ａｄａ", "Ada\u00a0"])  # full width, no-break
def test_a_name_that_reads_the_same_is_the_same(room, name):
    ada = seat(room, "Ada")
    assert room.named(name) is ada
    with pytest.raises(ValueError, match=r"is here already|Give a name"):
        seat(room, name)
    assert len(room.places) == 1


def at_once(count, work):
    """What `work(number)` returns or raises in so many threads that begin together."""
    begin = threading.Barrier(count)

    def run(number):
        begin.wait()
        try:
            return work(number)
        except ValueError as error:
            return str(error)

    with ThreadPoolExecutor(count) as pool:
        return [*pool.map(run, range(count))]


def test_a_form_that_is_sent_twice_opens_one_place(tmp_path):
    """As a click that is doubled on a slow machine; only the last cookie opens it."""

    def slowly(cycles):
        time.sleep(0.05)
        return make(cycles)

    room = Classroom(slowly, "linear", "generic", most=3, word=WORD)
    try:
        tokens = at_once(5, lambda _: seat(room, "Ada").token)
        (ada,) = room.places.values()
        assert len({*tokens}) >= 2
        assert ada.token in tokens
        assert [token for token in {*tokens} if room.person(token)] == [ada.token]
        with pytest.raises(ValueError, match="is here already"):
            seat(room, "Ada")
    finally:
        room.end()


def test_who_comes_at_the_same_moment_gets_a_place_of_their_own_or_the_reason(room):
    told = at_once(8, lambda number: seat(room, f"Pupil {number}"))
    here = [place for place in told if not isinstance(place, str)]
    assert {*here} == {*room.places.values()}
    assert sorted(room.places) == [1, 2, 3]
    assert [why for why in told if isinstance(why, str)] == ["All 3 places are taken."] * 5


def test_a_place_that_is_removed_twice_is_not_the_next_pupils(room):
    """Two walls are open, or "Yes" is pressed twice."""
    ada = seat(room, "Ada")
    room.remove(ada)
    grace = seat(room, "Grace")
    assert grace.number == ada.number
    room.remove(ada)
    assert room.named("Grace") is grace
    assert grace.clock._thread.is_alive()


def test_pupils_come_while_the_teacher_stops_and_looks(room):
    """Whoever walks through the places sees all of one instant."""
    for number in range(3):
        places = iter(room.places.values())
        seat(room, f"Pupil {number}")
        assert len([*places]) == number


def test_a_server_that_is_started_anew_knows_its_pupils(room, tmp_path):
    ada, grace = seat(room, "Ada"), seat(room, "Grace")
    seat(room, "Katherine")
    room.remove(grace)
    room.give(named("11_power"))
    ada.clock.move(lambda s: s.enable("x")).result(30)
    end = time.monotonic() + 30
    while not ada.results and time.monotonic() < end:
        time.sleep(0.05)
    assert room._kept.stat().st_mode & 0o077 == 0
    before = room.csv()
    room.end()

    again = Classroom(make, "linear", "generic", load_all(), 3, 8, tmp_path, "KESTREL 1")
    other = Classroom(make, "linear", "generic", load_all(), 3, 8, tmp_path, "kestrel 2")
    try:
        assert again.resume() == 2
        assert [(p.number, p.name) for p in again.places.values()] == [(1, "Ada"), (3, "Katherine")]
        assert again.person(ada.token).name == "Ada"
        assert "Ada is here already" in again.may_enter("Ada", WORD, "")
        assert again.enter("Ada", WORD, ada.code) == ada.token
        assert "Ada" in before
        assert again.csv() == before
        assert again.person(grace.token) is None
        assert seat(again, "Grace").number == 2
        assert other.resume() == 0  # another class
        again._kept.write_text('{"form": "servogym class 1", "places": [{}]}')
        with pytest.raises(ValueError, match="is not a stored class"):
            Classroom(make, "linear", "generic", most=3, results=tmp_path, word=WORD).resume()
    finally:
        again.end()


def test_tokens_and_codes_are_of_one_place_each(room):
    places = [seat(room, name) for name in ("Ada", "Grace", "Katherine")]
    assert len({place.token for place in places}) == len({place.code for place in places}) == 3
    assert [room.person(place.token) for place in places] == places
    room.remove(places[0])
    for token in ("", places[0].token, places[1].token[:-1], places[1].code, "é"):
        assert room.person(token) is None


@pytest.mark.parametrize(
    ("options", "said"),
    [("--pupils 0", "out of range 1..100"), ("--code abc", "give 6..32"),
     ("--pictures 99", "1..25"), ("--axis tower", "tower"), ("--port 0", "1..65535")],
)
def test_an_option_that_cannot_be_is_refused(options, said, refused):
    assert said in refused(["classroom", "--no-browser", "--port", "18993", *options.split()])


class Visit:
    """Requests to the guard of a classroom, as ASGI has them."""

    def __init__(self, room):
        self.door = Reception(room, "teacher's")
        self.passed = None
        self.guard = Guard(self._app, self.door, "class")

    async def _app(self, scope, receive, send):
        self.passed = scope["servogym.person"]
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"panel"})

    def ask(self, path="/", method="GET", body=b"", query="", **headers):
        self.passed, told = None, []
        named = [(n.replace("_", "-").encode(), v.encode("latin-1")) for n, v in headers.items()]
        scope = {"type": "http", "path": path, "method": method, "query_string": query.encode(),
                 "headers": named}

        async def receive():
            return {"type": "http.request", "body": body}

        async def send(message):
            told.append(message)

        asyncio.run(self.guard(scope, receive, send))
        found = {name.decode(): value.decode() for name, value in told[0]["headers"]}
        return told[0]["status"], found, told[1]["body"].decode()

    def join(self, name, word=WORD, **headers):
        body = f"word={word}&name={name}".replace(" ", "+").encode()
        return self.ask("/join", "POST", body, **headers)


def test_a_stranger_gets_the_form_and_nothing_else(room, monkeypatch):
    monkeypatch.setattr(reception, "PENALTY", 0.0)
    visit = Visit(room)
    status, headers, body = visit.ask()
    assert (status, visit.passed) == (200, None)
    assert 'action="/join"' in body
    assert "set-cookie" not in headers
    for path in ("/_nicegui/3/static/x.js", "/_nicegui_ws/socket.io/"):
        assert visit.ask(path)[0] == 403
    assert visit.ask("/place/1", "POST")[0] == 403
    assert visit.join("Ada", origin="http://evil.example", host="labpc")[0] == 403
    status, _, body = visit.join("<b>", word="wrong")
    assert status == 403
    assert 'role="alert"' in body
    assert "<b>" not in body
    assert not room.places


def test_who_has_the_code_gets_a_cookie_that_opens_one_place(room, monkeypatch):
    monkeypatch.setattr(reception, "PENALTY", 0.0)
    visit = Visit(room)
    status, headers, _ = visit.join("Ada", host="lab:9000", origin="http://lab:9000")
    assert (status, headers["location"]) == (303, "/")
    assert "HttpOnly; SameSite=Strict" in headers["set-cookie"]
    assert "Secure" not in headers["set-cookie"]
    ada = room.named("Ada")
    assert visit.ask(cookie=headers["set-cookie"].partition(";")[0])[0] == 200
    assert visit.passed is ada
    proxy = {"x_forwarded_proto": "https", "x_forwarded_host": "school.example",
             "x_forwarded_prefix": "/servo", "origin": "https://school.example"}
    status, headers, _ = visit.join("Grace", **proxy)
    assert headers["location"] == "/servo/"
    assert "; Secure" in headers["set-cookie"]
    assert visit.ask("/place/1", cookie=headers["set-cookie"].partition(";")[0])[0] == 200
    assert visit.passed is room.named("Grace")  # whatever the address says
    cookie = headers["set-cookie"].partition(";")[0]
    status, headers, _ = visit.join("Grace", cookie=cookie, **proxy)  # an older form, sent again
    assert (status, headers["location"], len(room.places)) == (303, ".", 2)
    gone = visit.ask("/leave", cookie=cookie)[1]["set-cookie"]
    assert gone.startswith("class=; ")
    assert "Max-Age=0" in gone


def test_the_teachers_token_leaves_the_address(room):
    """A projector shows the address; what looks like another server in it stays on this one."""
    visit = Visit(room)
    for path, place in (("/", "/"), ("//evil.example/x", "/evil.example/x"), ("/place/1",) * 2):
        status, headers, _ = visit.ask(path, query="token=teacher's")
        assert (status, headers["location"], visit.passed) == (303, place, None)
    assert visit.ask(cookie=headers["set-cookie"].partition(";")[0])[0] == 200
    assert visit.passed is visit.door


@given(st.text(max_size=40), st.text(max_size=40), st.text(max_size=40))
def test_whatever_a_stranger_types_is_answered_in_words_and_without_a_tag(name, word, own):
    room = Classroom(make, "linear", "generic", word=WORD)
    wrong = room.may_enter(name, word, own)
    page = reception._page("", {"name": name, "word": word}, wrong)
    fields = re.sub(r'value="[^"<>]*"', "", page)
    assert page.count("<input") == 3
    assert page.count("<script") == 0
    assert 'role="alert"' in fields or not wrong


def test_a_pupil_names_no_program_that_runs_here(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("raise SystemExit('it ran')")
    laboratory, session = Laboratory(shipped_only=True), make(CYCLES)
    for name in (f"{file}:mine", str(tmp_path), "", "../x"):
        for ask in (laboratory.prepare, laboratory.agent):
            with pytest.raises(ValueError, match="is not offered: "):
                ask(session.machine if ask == laboratory.prepare else session, "x", name, 200.0)
        with pytest.raises(ValueError, match="is not offered: "):
            laboratory.compare(session.machine, "x", ["hold", name], 200.0)


def test_measurements_on_copies_wait_for_one_another():
    pytest.importorskip("nicegui", reason="needs servogym[panel]")
    from servogym.envs.panel.pages.desk import beside

    under_way = []

    def work():
        under_way.append(1)
        assert len(under_way) == 1
        time.sleep(0.02)
        under_way.pop()

    async def all_at_once():
        await asyncio.gather(*(beside(work) for _ in range(5)))

    asyncio.run(all_at_once())


def test_a_policy_gets_each_cycle_in_a_class_room_too():
    session = make(CYCLES)
    session.enable("x"), session.home("x"), session.move("x", 0.1)
    laboratory = Laboratory()
    session.hand_over(laboratory.agent(session, "x", "trapezoid", 200.0))
    session.advance(1.0)
    session.release()
    assert session.value("x", "position_actual_value") == pytest.approx(200_000, abs=100)


# --------------------------------------------------------------- results and runs


def stop_it(session):
    """The exercise "Stop it in mid-move", as a pupil does it with the pages."""
    lessons.begin(session, "x", named("12_stop_it"))
    session.enable("x")
    session.home("x", 37)
    session.masters["x"].set_mode(1)
    session.write("x", "target_position", 400_000)
    for word in (0x0F, 0x1F):
        session.control_word("x", word)
        session.advance(0.02)
    session.advance(0.3)
    session.pupil.hint()
    session.pupil.predict(1)
    session.control_word("x", 0x02)
    session.advance(1.0)


@pytest.mark.parametrize("cycles", [1, CYCLES])
def test_a_run_is_replayed_to_the_same_bits_and_the_same_verdict(cycles):
    session = make(cycles)
    ended = []
    session.attempted = ended.append
    session.write("x", "max_torque", 100)  # of before: the exercise knows nothing of it
    session.advance(0.3)
    stop_it(session)
    (pupil,) = ended
    assert pupil.attempt.done, pupil.attempt.wrong
    run = json.loads(
        json.dumps(journal.outcome("linear", "generic", "x", pupil.attempt, pupil.journal))
    )
    attempt = journal.play(run, named("12_stop_it"))
    assert journal.same(run, attempt)
    assert attempt.report.hints == 1
    left = pupil.journal.cycle * session.machine.cycle_time
    assert attempt.machine.time == pytest.approx(left + 2 * session.machine.cycle_time)
    again = journal.play(run, named("12_stop_it"))
    assert again.machine.data.qpos[0] == attempt.machine.data.qpos[0]
    run["events"] = [
        event for event in run["events"] if event[1:4] != ["write", "x", "controlword"]
    ]
    assert not journal.same(run, journal.play(run, named("12_stop_it")))


def test_what_an_exercise_puts_in_the_way_cannot_be_taken_away(room):
    session = make(CYCLES)
    session.keep("before")
    lessons.begin(session, "x", named("31_find_why_it_trips"))
    for row in DISTURBANCES:
        assert "belongs to it" in disturb(session, "x", row, 0.0)
    assert "belongs to it" in inject(session, "x", "overvoltage")
    with pytest.raises(Exception, match="belongs to it"):
        session.hand_over(object())
    assert session.back("before") == ""
    assert "back at a snapshot" in session.pupil.present.wrong
    lessons.begin(session, "x", named("31_find_why_it_trips"))
    session.reset()
    assert "off and on" in session.pupil.present.wrong
    lessons.leave(session)
    assert disturb(session, "x", DISTURBANCES[1], 3.0) == ""


def ask(place, request):
    return place.clock.ask(request).result(30)


def test_nothing_crosses_and_results_are_written_as_they_come(room, tmp_path, capsys):
    ada, grace = seat(room, "Ada"), seat(room, "=Grace")
    assert ada.clock.move(lambda s: s.enable("x")).result(30) == ""
    ada.clock.session.write("x", "max_torque", 777)
    assert ask(grace, lambda s: int(s.machine.drives["x"].axis.state)) != ask(
        ada, lambda s: int(s.machine.drives["x"].axis.state)
    )
    assert ask(grace, lambda s: s.machine.drives["x"].read("max_torque")) == 3000
    ours, theirs = (place.clock.session for place in (ada, grace))
    for name in ("machine", "control", "log", "scope", "kept", "masters", "set_points", "port"):
        assert getattr(ours, name) is not getattr(theirs, name), name
    assert ours.machine.model is not theirs.machine.model
    ada.clock.pause(True)
    before = theirs.time
    room.give(named("11_power"))
    late = seat(room, "Katherine")  # gets the task as well
    for place in (ada, grace, late):
        place.clock.move(lambda s: s.enable("x")).result(30)
        end = time.monotonic() + 30
        while not place.results and time.monotonic() < end:
            time.sleep(0.05)
        (result,) = place.results
        assert (result.exercise, result.done) == ("11_power", False)
        assert "has left Switch on disabled" in result.wrong
        assert main(["course", "replay", str(tmp_path / result.run)]) == 0
        assert "has left Switch on disabled" in capsys.readouterr().out
    assert theirs.time > before
    rows = list(csv.DictReader(io.StringIO((tmp_path / "results.csv").read_text())))
    assert [row["pupil"] for row in rows] == ["Ada", "'=Grace", "Katherine"]
    assert rows == list(csv.DictReader(io.StringIO(room.csv())))
    room.reset(ada)
    ask(ada, lambda s: None)
    end = time.monotonic() + 30
    while ask(ada, lambda s: s.pupil) is not None and time.monotonic() < end:
        time.sleep(0.05)
    assert ask(ada, lambda s: s.machine.drives["x"].read("max_torque")) == 3000


@pytest.mark.parametrize(
    "text", ["", "{}", '{"form": "servogym run 1"}', "[]", "\0", '{"form": 1}']
)
def test_what_is_no_run_is_refused_in_words(text, tmp_path, capsys):
    file = tmp_path / "run.json"
    file.write_text(text)
    assert main(["course", "replay", str(file)]) == 2
    assert "not a run of an exercise" in capsys.readouterr().err


# --------------------------------------------------------------------- in browsers


@pytest.fixture
def server(tmp_path):
    server = Server("--pictures", "4", "--pupils", "3", "--code", WORD, "--results", str(tmp_path),
                    command="classroom")
    server.folder = tmp_path
    yield server
    server.kill()


def come(browser, server, name, own="", click="click"):
    """A pupil with a browser of their own."""
    context = browser.new_context(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
    context.set_default_timeout(60_000)
    page = context.new_page()
    page.goto(server.url)
    for field, text in (("word", WORD), ("name", name), ("own", own)):
        page.fill(f"[name={field}]", text)
    getattr(page, click)("button")
    return page


def teacher(browser, server):
    context = browser.new_context(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
    context.set_default_timeout(60_000)
    page = context.new_page()
    page.goto(f"{server.url}?token={server.token}")
    expect(at(page, "where")).to_contain_text(str(server.port))
    return page


class TestInBrowsers:
    """Two pupils and a teacher, each with a browser of their own."""

    pytestmark = needs_chromium

    def test_a_machine_each_a_wall_a_look_and_results(self, browser, server):
        wall = teacher(browser, server)
        assert server.token not in wall.url
        ada, grace = come(browser, server, "Ada"), come(browser, server, "Grace")
        for page in (ada, grace):
            shows(page, "state", "switch on disabled")
            shows(page, "control", "In control")
        open_page(ada, "motion")
        at(ada, "enable").click()
        shows(ada, "state", "operation enabled")
        shows(wall, "place-1-state", "operation enabled")
        shows(wall, "place-2-state", "switch on disabled")
        shows(grace, "state", "switch on disabled")
        shows(wall, "count", "2 of 3 places")
        grace.goto(f"{server.url}place/1")  # Ada's, if she could
        expect(grace.locator(".brand")).to_contain_text("Grace")
        shows(grace, "state", "switch on disabled")

        with wall.context.expect_page() as opened:
            at(wall, "place-1-look").click()
        look = opened.value
        shows(look, "state", "operation enabled")
        shows(look, "control", "Take control")  # the teacher watches until they take it
        expect(look.locator(".brand")).to_contain_text("Ada")
        at(look, "control").click()
        shows(ada, "control", "Take control")
        look.close()
        shows(ada, "control", "Take control")
        at(ada, "control").click()
        shows(ada, "control", "In control")

        at(wall, "task-name").click()
        wall.get_by_role("option", name="Stop it in mid-move").click()
        at(wall, "give").click()
        at(wall, "yes").click()
        for page, place in ((ada, 1), (grace, 2)):
            expect(at(page, "lesson-now")).to_contain_text("Stop it in mid-move")
            expect(at(wall, f"place-{place}-task")).to_contain_text("1 of 2")
        open_page(grace, "lessons")
        at(grace, "hint").click()
        expect(at(wall, "place-2-more")).to_contain_text("hints 1")
        picture(wall, "wall")
        at(grace, "leave").click()
        expect(at(wall, "place-2-more")).to_contain_text("1 tries")
        expect(at(wall, "place-2-task")).to_have_text("no exercise")
        with wall.expect_download() as download:
            at(wall, "csv").click()
        (row,) = csv.DictReader(io.StringIO(Path(download.value.path()).read_text()))
        assert (row["pupil"], row["exercise"], row["hints"]) == ("Grace", "12_stop_it", "1")
        assert main(["course", "replay", str(server.folder / row["run"])]) == 0

        at(wall, "place-1-reset").click()
        at(wall, "yes").click()
        expect(at(wall, "place-1-task")).to_have_text("no exercise")
        expect(ada.locator(".q-notification").first).to_be_visible()
        for page in (ada, grace, wall):
            page.context.close()

    def test_who_comes_again_needs_the_own_code_and_who_is_removed_is_out(self, browser, server):
        wall = teacher(browser, server)
        ada = come(browser, server, "Ada")
        shows(ada, "control", "In control")
        ada.context.close()
        again = come(browser, server, "Ada")
        expect(again.get_by_role("alert")).to_contain_text("Ada is here already")
        at(wall, "place-1-code").click()
        said = wall.locator(".q-notification").first.inner_text()
        own = re.search(r"own code (\w{6})", said)[1]
        again.context.close()
        ada = come(browser, server, "Ada", own)
        expect(ada.locator(".brand")).to_contain_text(f"own code {own}")
        server.kill()
        server.start()  # as after a crash: the same command
        ada.reload(), wall.reload()
        expect(ada.locator(".brand")).to_contain_text(f"Ada · own code {own}")
        at(wall, "place-1-remove").click()
        at(wall, "yes").click()
        expect(ada.locator("[name=word]")).to_be_visible()
        grace = come(browser, server, "Dorothy", click="dblclick")
        shows(grace, "state", "switch on disabled")
        at(grace, "leave-class").click()
        expect(grace.locator("[name=word]")).to_be_visible()
        for page in (ada, grace, wall):
            page.context.close()


def test_what_comes_of_a_page_that_is_gone_is_no_line_in_the_log(caplog):
    """The libraries' own errors, as the server logs them; an error of ours stays."""
    pytest.importorskip("nicegui", reason="needs servogym[panel]")
    from nicegui import Client, ui
    from nicegui.page import page
    from starlette.middleware.base import BaseHTTPMiddleware

    client = Client(page(""))
    with client:
        label, row = ui.label("gone"), ui.row()
    client.delete()

    def answered():
        """A request whose sender has hung up."""
        async def nothing(scope, receive, send):
            pass

        async def called(request, call_next):
            return await call_next(request)

        scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": b""}
        asked = BaseHTTPMiddleware(nothing, called)(scope, None, None)
        with ThreadPoolExecutor() as beside:  # a browser of other tests has this thread's loop
            beside.submit(asyncio.run, asked).result()

    def built():
        with row:
            ui.label("too late")

    logger = logging.getLogger("nicegui")
    logger.addFilter(concerns_somebody)
    try:
        with client:
            ui.notify("too late")
        del client
        gc.collect()
        errors = []
        for work in (lambda: label.client.id, built, answered, lambda: 1 / 0):
            try:
                work()
            except Exception as error:
                errors.append(error)
                logger.exception(error)
    finally:
        logger.removeFilter(concerns_somebody)
    assert [type(error) for error in errors] == [RuntimeError] * 3 + [ZeroDivisionError]
    assert [record.exc_info[0] for record in caplog.records] == [ZeroDivisionError]
