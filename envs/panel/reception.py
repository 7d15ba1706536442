"""Reception: the page on which a pupil enters the class code and a name.

It is plain HTML, because a browser without a token gets nothing else of the panel. The answer to a
wrong code takes a second, and such answers wait for one another, so that codes cannot be guessed.
"""

import asyncio
import hmac
from collections.abc import Callable
from html import escape
from typing import Any
from urllib.parse import parse_qs

from .classroom import LONGEST, Classroom, Place
from .guard import JOIN, Receive, Scope, Send, answer

AT_ONCE, WAITING = 4, 200  # codes that are checked at the same time, and that may wait
PENALTY = 1.0  # s
MOST = 2000  # bytes of a form
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>servogym classroom</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { color-scheme: light dark; --ground: #eef0f3; --card: #fff; --ink: #1b2430;
  --accent: #1f5fa8; --line: #8a94a1; --bad: #b3261e; --on: #fff }
@media (prefers-color-scheme: dark) { :root { --ground: #12161c; --card: #1b212a; --ink: #e8ecf2;
  --accent: #6ea8ec; --line: #7d8896; --bad: #ff8379; --on: #0d1520 } }
body { margin: 0; min-height: 100vh; display: grid; place-items: center; background: var(--ground);
  color: var(--ink); font: 1.05rem system-ui, sans-serif }
main { background: var(--card); border-radius: .75rem; padding: 1.5rem; width: min(24rem, 92vw);
  box-sizing: border-box }
h1 { font-size: 1.3rem; margin: 0 0 1rem } label { display: block; margin: 0 0 1rem }
input { display: block; width: 100%%; box-sizing: border-box; font: inherit; padding: .6rem;
  margin-top: .25rem; border: 1px solid var(--line); border-radius: .5rem; background: var(--card);
  color: var(--ink) }
small { display: block; margin-top: .25rem }
button { font: inherit; font-weight: 600; padding: .7rem 1.4rem; border: 0; border-radius: .5rem;
  background: var(--accent); color: var(--on); width: 100%% }
[role=alert] { color: var(--bad); font-weight: 600 }
</style></head><body><main><h1>servogym classroom</h1>%(wrong)s
<form method="post" action="%(prefix)s%(join)s">
<label>Code of the class
<input name="word" required maxlength="%(longest)d" autocomplete="off" value="%(word)s"></label>
<label>Your name
<input name="name" required maxlength="%(longest)d" autocomplete="off" value="%(name)s"></label>
<label>Your own code
<input name="own" maxlength="%(longest)d" autocomplete="off">
<small>Only if you were here before, in another browser.</small></label>
<button>Enter</button></form></main></body></html>
"""


class Reception:
    """The door of a classroom: the teacher by a token, pupils by that of their place.

    Args:
        room: the classroom.
        teacher: token of the teacher.
    """

    def __init__(self, room: Classroom, teacher: str):
        self.room, self.teacher = room, teacher
        self._looking = asyncio.Semaphore(AT_ONCE)
        self._waiting = 0

    def person(self, token: str) -> "Place | Reception | None":
        """Return the place of a pupil, or the reception itself for the teacher."""
        known = self.room.person(token)
        teaches = hmac.compare_digest(self.teacher.encode(), token.encode())
        return self if teaches else known

    async def answer(
        self, scope: Scope, receive: Receive, send: Send, cookie: Callable[[str], bytes]
    ) -> bool:
        """Serve the form and handle its submission."""
        prefix = _prefix(scope)
        if scope["method"] == "GET" and not scope["path"].startswith("/_nicegui"):
            await answer(send, 200, _page(prefix), kind="text/html")
            return True
        if scope["method"] != "POST" or scope["path"] != JOIN:
            return False
        form = await _form(receive)
        if self._waiting >= WAITING:
            busy = "Too many people are entering at once: try again soon."
            await answer(send, 503, _page(prefix, form, busy), kind="text/html")
            return True
        self._waiting += 1
        token, wrong = "", ""
        try:
            async with self._looking:
                try:
                    token = await asyncio.to_thread(
                        self.room.enter, form["name"], form["word"], form["own"]
                    )
                except (ValueError, OSError) as error:
                    wrong = str(error)
                    await asyncio.sleep(PENALTY)
        finally:
            self._waiting -= 1
        if not token:
            await answer(send, 403, _page(prefix, form, wrong), kind="text/html")
        else:
            await answer(send, 303, "", (b"location", f"{prefix}/".encode()),
                         (b"set-cookie", cookie(token)))
        return True


def _prefix(scope: Scope) -> str:
    """Return the path under which a proxy serves the panel; empty for anything but a path."""
    given = {name: value for name, value in scope["headers"]}.get(b"x-forwarded-prefix", b"")
    text = given.decode("latin-1").strip("/")
    fine = text and all(letter.isalnum() or letter in "-_./" for letter in text)
    return f"/{text}" if fine else ""


def _page(prefix: str, form: dict[str, str] | None = None, wrong: str = "") -> str:
    known: dict[str, Any] = {name: escape(text) for name, text in (form or {}).items()}
    said = f'<p role="alert">{escape(wrong)}</p>' if wrong else ""
    place = {"name": "", "word": "", "longest": LONGEST, "join": JOIN, "prefix": prefix}
    return PAGE % (place | known | {"wrong": said})


async def _form(receive: Receive) -> dict[str, str]:
    body, more = b"", True
    while more and len(body) <= MOST:
        message = await receive()
        body += message.get("body", b"")
        more = message.get("more_body", False)
    given = parse_qs(body[:MOST].decode("utf-8", "replace"))
    found = {name: given.get(name, [""])[0].strip()[:100] for name in ("name", "word", "own")}
    return found | {"name": " ".join(found["name"].split())}
