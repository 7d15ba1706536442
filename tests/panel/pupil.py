"""A pupil's page without a browser: it answers, clicks and types as NiceGUI's page does.

A browser takes ten times the work of the page's server; two dozen of them on the computer that is
measured would measure themselves. This one keeps the elements that the server sends, sends the
events of those with a name (`data-test`), and answers each picture as soon as it is there.
"""

import ast
import asyncio
import contextlib
import json
import re
import uuid

import aiohttp
import socketio

PICTURE = re.compile(r"^const texts = (\{.*?\});", re.S)


class Page:
    """A page of a classroom, or of a panel.

    Args:
        url: of the server, with a slash at its end.
    """

    def __init__(self, url):
        self.url, self.elements, self.pictures = url, {}, 0
        self.socket, self.http, self.drops = None, None, 0
        self.tab = str(uuid.uuid4())  # the same after a reload, as a browser's is

    async def enter(self, word, name):
        """Come in as a pupil."""
        self.http = aiohttp.ClientSession(
            cookie_jar=aiohttp.CookieJar(unsafe=True),
            # as a browser, no web socket on a connection that has carried pages: uvicorn closes it
            connector=aiohttp.TCPConnector(force_close=True),
        )
        form = {"word": word, "name": name, "own": ""}
        async with self.http.post(f"{self.url}join", data=form) as answer:
            status, page = answer.status, await answer.text()
        assert status == 200, page[:200]
        with contextlib.suppress(socketio.exceptions.ConnectionError):
            await self._connect(page)
        while not self.socket.connected:
            await self._again()

    async def _connect(self, page):
        found = re.search(r"query: (\{.*?\}),\n", page)
        self.query = ast.literal_eval(re.sub(r"\btrue\b", "True", found[1])) | {
            "document_id": str(uuid.uuid4()), "tab_id": self.tab, "old_tab_id": "",
        }
        self.client = self.query["client_id"]
        self.socket = socketio.AsyncClient(http_session=self.http, reconnection=False)
        self.socket.on("update", self._update)
        self.socket.on("run_javascript", self._picture)
        query = "&".join(f"{name}={str(value).lower() if value is True else value}"
                         for name, value in self.query.items())
        await self.socket.connect(
            f"{self.url}?{query}", transports=["websocket"],
            socketio_path="_nicegui_ws/socket.io", wait_timeout=60,
        )

    async def _update(self, data):
        self._see(data)
        for number, element in data.items():
            if not number.startswith("_"):
                self.elements.pop(number, None) if element is None else self.elements.update(
                    {number: self.elements.get(number, {}) | element}
                )

    def _see(self, data):
        if "_id" in data:
            self.query["next_message_id"] = data["_id"] + 1

    async def _picture(self, data):
        self._see(data)
        if (texts := PICTURE.match(data.get("code", ""))) is not None:
            self.pictures += 1
            for name, text in json.loads(texts[1]).items():
                self.elements.setdefault(name.removeprefix("c"), {})["text"] = text
        if (request := data.get("request_id")) and self.socket.connected:
            await self.socket.emit(
                "javascript_response",
                {"request_id": request, "client_id": self.client, "result": 1},
            )

    def find(self, test):
        """Number and element by its name in tests."""
        for number, element in self.elements.items():
            if element.get("props", {}).get("data-test") == test:
                return number, element
        raise LookupError(f"there is no {test}")

    def text(self, test):
        """What an element says."""
        _, element = self.find(test)
        props = element.get("props", {})
        return str(element.get("text") or props.get("label") or "")

    async def _again(self):
        """Load the page anew, as a browser does where the line was cut."""
        self.drops, self.elements = self.drops + 1, {}
        if (line := self.socket.eio.ws) is not None:
            await line.close()
        async with self.http.get(self.url) as answer:
            with contextlib.suppress(socketio.exceptions.ConnectionError):
                await self._connect(await answer.text())
        await self.until(lambda page: not page.socket.connected or page.find("state"))

    def message(self, test, kind, *arguments):
        """An event of an element, as it goes through the line."""
        number, element = self.find(test)
        for event in element.get("events", ()):
            if event["type"] == kind:
                shown = event["js_handler"] and (element.get("props", {}).get("label") or "")
                args = [json.dumps(a) for a in ([shown] if shown is not None else arguments)]
                return {"id": int(number), "client_id": self.client,
                        "listener_id": event["listener_id"], "args": args}
        raise LookupError(f"{test} has no {kind}")

    async def send(self, test, kind, *arguments):
        """Send an event of an element."""
        while not self.socket.connected:
            await self._again()
        await self.socket.emit("event", self.message(test, kind, *arguments))

    async def click(self, test):
        """Click it."""
        await self.send(test, "click", {})

    async def type(self, test, text):
        """Type a text and Enter."""
        await self.send(test, "update:value", text)
        await self.send(test, "keydown", {})

    def named(self, kind, tag=""):
        """Names of all elements that have a kind of event, of one tag if that is given."""
        return sorted(
            element["props"]["data-test"] for element in self.elements.values()
            if element.get("props", {}).get("data-test") and tag in ("", element.get("tag"))
            and any(event["type"] == kind for event in element.get("events", ()))
        )

    async def until(self, holds, time=60.0):
        """Wait until something holds of the page."""
        for _ in range(int(time / 0.05)):
            try:
                if holds(self):
                    return
            except LookupError:
                pass
            await asyncio.sleep(0.05)
        raise TimeoutError

    async def leave(self):
        """Close the page."""
        if self.socket is not None:
            await self.socket.disconnect()
        await self.http.close()
