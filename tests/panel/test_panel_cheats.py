"""What a pupil may try beside the pages: a second window, forged and replayed messages, files.

Each is tried with the real tokens and page ids of two pupils, as if they were known: no one of them
is enough to touch what belongs to somebody else.
"""

import asyncio
import contextlib
import copy
import io
import json
import time
import uuid

import pytest
from browser import Server
from test_panel_classroom import WORD

pytest.importorskip("nicegui", reason="needs servogym[panel]")
pupil = pytest.importorskip("pupil", reason="needs aiohttp and python-socketio")
socketio = pytest.importorskip("socketio")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A classroom; whatever is sent reaches no line of ours that would fail."""
    folder = tmp_path_factory.mktemp("class")
    with (folder / "errors").open("w+") as errors:
        server = Server("--pictures", "4", "--code", WORD, "--results", str(folder / "results"),
                        command="classroom", log=errors)
        server.results = folder / "results"
        try:
            yield server
            assert server.process.poll() is None
        finally:
            server.kill()
        errors.seek(0)
        said = errors.read()
        assert "Task exception" not in said, said[-2000:]
        assert "/envs/" not in said, said[-2000:]


@contextlib.asynccontextmanager
async def pupils(server, *names):
    """Their pages, open on Motion."""
    pages = [pupil.Page(server.url) for _ in names]
    try:
        for page, name in zip(pages, names, strict=True):
            await page.enter(WORD, name)
            await page.until(lambda page: page.text("control") == "In control")
            await page.click("go-motion")
            await page.until(lambda page: page.find("enable"))
        yield pages
    finally:
        for page in pages:
            await page.leave()


async def window(page):
    """Another window of the same browser."""
    second = pupil.Page(page.url)
    second.http = page.http
    async with page.http.get(page.url) as answer:
        await second._connect(await answer.text())
    await second.until(lambda page: page.text("control"))
    return second


async def stands(page, seconds=1.0):
    """Nothing has happened to the drive for a while."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert page.text("state") == "switch on disabled"
        await asyncio.sleep(0.05)


async def enables(page):
    """The page still commands its own drive."""
    await page.click("enable")
    await page.until(lambda page: page.text("state") == "operation enabled")
    await page.click("disable")
    await page.until(lambda page: page.text("state") == "switch on disabled")


def test_a_second_window_watches_whatever_it_sends(server):
    async def go():
        async with pupils(server, "Second") as (first,):
            second = await window(first)
            assert second.text("control") == "Take control"
            await second.click("go-motion")
            await second.until(lambda page: page.find("enable"))
            before = first.text("value-max_torque")
            for press in ("enable", "home", "move-by"):
                await second.click(press)
            await second.type("set-max_torque", "7")
            await second.type("target", "100")
            for name, presses in (("lessons", ("lesson-0",)), ("experiments", ("keep",)),
                                  ("state", ("command-2", "controlword-3"))):
                await second.click(f"go-{name}")
                await second.until(lambda page, press=presses[0]: page.find(press))
                for press in presses:
                    await second.click(press)
            await stands(first)
            assert first.text("value-max_torque") == before
            await first.click("go-experiments")
            await first.until(lambda page: page.find("keep"))
            with pytest.raises(LookupError):
                first.find("back-A")
            await first.click("go-lessons")
            await first.until(lambda page: page.find("lesson-0"))
            with pytest.raises(LookupError):
                first.find("step-0")
            await first.click("go-motion")
            await enables(first)
            await second.socket.disconnect()

    asyncio.run(go())


def test_a_message_for_another_pupils_page_does_nothing(server):
    async def go():
        async with pupils(server, "Ada", "Grace") as (ada, grace):
            for press in ("enable", "leave-class", "quick-stop"):
                await ada.socket.emit("event", grace.message(press, "click", {}))
            await stands(grace)
            await stands(ada, 0.1)
            assert ada.client != grace.client
            query = "&".join(
                f"{name}={str(value).lower() if value is True else value}"
                for name, value in grace.query.items()
            )
            stranger = socketio.AsyncClient(http_session=ada.http, reconnection=False)
            heard = []
            stranger.on("*", lambda *message: heard.append(message))
            with contextlib.suppress(socketio.exceptions.ConnectionError):
                await stranger.connect(
                    f"{server.url}?{query}", transports=["websocket"], wait_timeout=5,
                    socketio_path="_nicegui_ws/socket.io",
                )
            await asyncio.sleep(1.0)
            assert heard == []
            await stranger.disconnect()
            open_door = socketio.AsyncClient(http_session=ada.http, reconnection=False)
            open_door.on("*", lambda *message: heard.append(message))
            with contextlib.suppress(socketio.exceptions.ConnectionError):
                await open_door.connect(  # a line without a page, which asks for one
                    server.url, transports=["websocket"], wait_timeout=5,
                    socketio_path="_nicegui_ws/socket.io",
                )
                for tab in (grace.tab, ada.tab):
                    asked = {"client_id": grace.client, "tab_id": tab, "old_tab_id": None,
                             "document_id": str(uuid.uuid4()), "next_message_id": 0}
                    await open_door.emit("handshake", asked)
                await asyncio.sleep(1.0)
                await open_door.disconnect()
            assert heard == []
            await enables(grace)
            await enables(ada)

    asyncio.run(go())


def test_a_file_for_another_pupils_page_or_a_large_one_is_refused(server):
    async def go():
        async with pupils(server, "Emmy", "Sophie") as (emmy, sophie):
            for page in (emmy, sophie):
                await page.click("go-objects")
                await page.until(lambda page: page.find("load-parameters"))
            theirs = sophie.find("load-parameters")[1]["props"]["url"].lstrip("/")
            own = emmy.find("load-parameters")[1]["props"]["url"].lstrip("/")

            async def post(page, where, content):
                for _ in range(20):  # who is refused may lose the line before the answer is read
                    form = pupil.aiohttp.FormData()
                    form.add_field("file", io.BytesIO(content), filename="drive.json")
                    with contextlib.suppress(pupil.aiohttp.ClientOSError):
                        async with page.http.post(f"{page.url}{where}", data=form) as answer:
                            return answer.status, await answer.text()
                raise AssertionError("no answer")

            assert await post(emmy, theirs, b"{}") == (
                403, "servogym panel: that page is another person's\n")
            status, said = await post(emmy, own, b" " * 3_000_000)
            assert (status, "state its length" in said[:200]) == (403, True)
            assert (await post(emmy, own, b"{}"))[0] == 200
            await emmy.until(lambda page: page.text("loaded"))
            assert not sophie.text("loaded")

    asyncio.run(go())


def test_messages_that_are_replayed_or_make_no_sense_do_nothing(server):
    async def go():
        async with pupils(server, "Lise") as (page,):
            kept = [page.message("enable", "click", {}), page.message("home", "click", {})]
            await enables(page)
            await page._again()
            await page.until(lambda page: page.text("control") == "In control")
            for message in kept:
                await page.socket.emit("event", message)  # of a page that is gone
                await page.socket.emit("event", message | {"client_id": page.client})
            await stands(page)
            await page.click("go-motion")
            await page.until(lambda page: page.find("mode"))
            good = page.message("enable", "click", {})
            for nonsense in (
                None, 7, "enable", [], {}, {"client_id": page.client}, good | {"client_id": ""},
                good | {"id": "1"}, good | {"id": None}, good | {"id": [1]}, good | {"id": 10**9},
                good | {"listener_id": "0"}, good | {"listener_id": {}}, good | {"args": "{"},
                good | {"args": ["{"]}, good | {"args": 3}, good | {"client_id": [page.client]},
            ):
                await page.socket.emit("event", nonsense)
            for kind in ("handshake", "ack", "log", "javascript_response", "nothing"):
                for nonsense in (None, 7, {}, {"client_id": page.client}, {"client_id": 3}):
                    await page.socket.emit(kind, nonsense)
            await stands(page)
            mode = page.message("mode", next(
                event["type"] for event in page.find("mode")[1]["events"]
                if event["type"].startswith("update:")
            ), {})
            for value in (99, -1, "x", None, {}, [], 1.5, {"value": 99}, {"value": -1},
                          {"value": "x"}, {"value": None}):
                await page.socket.emit("event", mode | {"args": [json.dumps(value)]})
            await stands(page)
            second = await window(page)
            for _ in range(200):  # and the line is cut before they are read
                await second.socket.emit("ack", {"client_id": second.client, "next_message_id": 0})
            await second.socket.disconnect()
            await enables(page)

    asyncio.run(go())


def test_a_tab_by_another_pupils_name_stays_with_its_own_machine(server):
    """The name of a tab lies in the storage of the browser, where anybody may change it."""
    async def go():
        async with pupils(server, "Maria", "Chien") as (maria, chien):
            copied = copy.copy(maria)
            copied.tab, copied.elements = chien.tab, {}
            async with maria.http.get(server.url) as answer:
                await copied._connect(await answer.text())
            await copied.until(lambda page: page.text("control") == "Take control")
            await copied.click("control")
            await copied.until(lambda page: page.text("control") == "In control")
            await maria.until(lambda page: page.text("control") == "Take control")
            assert chien.text("control") == "In control"
            await enables(chien)
            await copied.socket.disconnect()

    asyncio.run(go())


def test_a_pupil_gets_no_page_of_the_teacher_and_nobody_elses(server):
    async def go():
        async with pupils(server, "Hedy", "Mary") as (hedy, _):
            for path in ("", "place/1", "place/2", "place/99", "place/-1", "place/2/..", "wall",
                         "docs", "redoc", "openapi.json", "_nicegui/", "join", "results.csv"):
                for query in ("", "?token=", "?token=x", f"?token={server.token[:-1]}"):
                    async with hedy.http.get(f"{server.url}{path}{query}") as answer:
                        text = await answer.text()
                    for secret in ("Mary", WORD, server.token, "QUICK STOP ALL"):
                        assert secret not in text, (path, query, secret)
                async with hedy.http.post(f"{server.url}{path}", data={"token": "x"}) as answer:
                    text = await answer.text()
                for secret in ("Mary", WORD, server.token, "QUICK STOP ALL"):
                    assert secret not in text, (path, "post", secret)

    asyncio.run(go())


@pytest.mark.parametrize(("name", "said"), [
    ("\u0410da", "one alphabet"), ("Grac\u0435", "one alphabet"), ("\u0391da", "one alphabet"),
    ("Ann\u200b", "Give a name"), ("Ann\u202e", "Give a name"), ("ann", "is here already"),
])
def test_a_name_that_only_looks_like_another_pupils_is_refused(server, name, said):
    async def go():
        async with pupils(server, "Ann") if name == "ann" else contextlib.nullcontext():
            session = pupil.aiohttp.ClientSession()
            form = {"word": WORD, "name": name, "own": "aaaaaa"}
            async with session, session.post(f"{server.url}join", data=form) as answer:
                assert (answer.status, said in await answer.text()) == (403, True)

    asyncio.run(go())
