"""Access control: a request needs the token and has to come from one of our own pages.

The token is required on the loopback interface too, because programs of other users of this
computer reach it. It arrives as ``?token=`` once and as a cookie afterwards; the address loses it,
because it may be shown on a projector. A foreign page in the same browser has no cookie of ours,
or, if another port of this computer serves it, another origin. A foreign host name that points
here (DNS rebinding) has no cookie either. For this reason the host name is not checked: behind a
proxy, through ``ssh -L`` or under a bare name it is a different one.
"""

import hmac
import re
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, Protocol
from urllib.parse import parse_qs, quote, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
LOOPBACK = ("127.0.0.1", "localhost", "::1")
HEADERS = (  # no other page shows ours in a frame, and nothing is loaded from other hosts
    (b"x-frame-options", b"DENY"),
    (
        b"content-security-policy",
        b"default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' "
        b"'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' "
        b"ws: wss:; object-src 'none'; base-uri 'self'; form-action 'self'; frame-ancestors 'none'",
    ),
    (b"referrer-policy", b"same-origin"),  # "no-referrer" would remove the origin of a form too
    (b"x-content-type-options", b"nosniff"),
)


def is_loopback(host: str) -> bool:
    """Whether a host is a loopback address of this computer."""
    return host in LOOPBACK


PAGE = re.compile("/_nicegui/client/([^/]+)/")  # path of files that are sent to a page
LARGEST = 1_000_000  # bytes of a file
PERSON = "servogym.person"  # key of a scope: the person who sends the request
LEAVE = "/leave"  # the browser forgets its token
JOIN = "/join"  # where strangers send their form


class Door(Protocol):
    """Recognises the owners of tokens, and answers strangers."""

    def person(self, token: str) -> Any:
        """Return the owner of a token, None for a stranger."""

    async def answer(
        self, scope: Scope, receive: Receive, send: Send, cookie: Callable[[str], bytes]
    ) -> bool:
        """Answer a stranger's HTTP request; -> whether it was one. `cookie` builds a cookie."""


class Owner:
    """The owner of a panel with a single token."""

    def __init__(self, token: str):
        self.token = token

    def person(self, token: str) -> "Owner | None":
        """The owner, or nobody."""
        return self if hmac.compare_digest(self.token.encode(), token.encode()) else None

    async def answer(
        self, scope: Scope, receive: Receive, send: Send, cookie: Callable[[str], bytes]
    ) -> bool:
        """Answer no request of strangers, who get no page."""
        return False


class Guard:
    """Forwards permitted requests and answers the rest with 403 and a sentence.

    Args:
        app: the guarded ASGI application.
        door: recognises tokens.
        name: name of the cookie, different for each server, because a browser stores cookies by
            host and not by port.
        owner: returns the owner of a page by its id; None if there is no such page.
    """

    def __init__(
        self, app: Callable[..., Awaitable[None]], door: Door, name: str,
        owner: Callable[[str], Any] = lambda page: None,
    ):
        self.app, self.door, self.name, self.owner = app, door, name, owner

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request, as ASGI defines."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1")
                   for name, value in scope["headers"]}
        secure = headers.get("x-forwarded-proto", scope.get("scheme", "")) in ("https", "wss")
        plain = scope["type"] == "http"
        wrong, given, person = self.judge(headers, scope.get("query_string", b"").decode("latin-1"))
        wrong = wrong or self._sent_elsewhere(scope, headers, person)
        own = _with_headers(send)
        if not wrong and given and plain and scope["method"] == "GET":
            place = headers.get("x-forwarded-prefix", "") + scope["path"]
            where = "/" + place.lstrip("/\\")  # of this server, whatever it looks like
            await answer(own, 303, "", (b"location", quote(where).encode()),
                          (b"set-cookie", self._cookie(given, secure)))
        elif not wrong and plain and scope["path"] == LEAVE:
            gone = self._cookie("", secure) + b"; Max-Age=0"
            await answer(own, 303, "", (b"location", b"."), (b"set-cookie", gone))
        elif not wrong and plain and scope["path"] == JOIN:  # a form that was sent twice
            await answer(own, 303, "", (b"location", b"."))
        elif not wrong:
            scope[PERSON] = person
            await self.app(scope, receive, own)
        elif not plain:
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": wrong[:100]})
        elif self.stranger(headers) or not await self.door.answer(
            scope, receive, own, lambda token: self._cookie(token, secure)
        ):
            await answer(own, 403, f"servogym panel: {wrong}\n")

    def _sent_elsewhere(self, scope: Scope, headers: dict[str, str], person: Any) -> str:
        """The reason why a file is refused: it is meant for another person, or too large."""
        if (found := PAGE.match(scope["path"])) is None:
            return ""
        if self.owner(found[1]) not in (None, person):
            return "that page is another person's"
        length = headers.get("content-length", "" if scope.get("method") == "POST" else "0")
        if not length.isdecimal() or int(length) > 2 * LARGEST:
            return f"a file has to state its length, at most {LARGEST} bytes"
        return ""

    @staticmethod
    def stranger(headers: dict[str, str]) -> str:
        """The reason why the requesting page is foreign; empty if it is ours or there is none."""
        origin = headers.get("origin")
        if origin is not None:
            served = {headers.get("host", "").lower(), headers.get("x-forwarded-host", "").lower()}
            if urlsplit(origin).netloc.lower() not in served - {""}:
                return (
                    f"origin {origin[:80]!r} is a stranger here; a proxy has to pass the header "
                    "Host, or X-Forwarded-Host"
                )
        if headers.get("sec-fetch-site") == "cross-site" and "upgrade" in headers:
            return "a stranger's page may not connect"
        return ""

    def judge(self, headers: dict[str, str], query: str) -> tuple[str, str, Any]:
        """The reason why a request is refused or "", the token in its address, and the person."""
        if wrong := self.stranger(headers):
            return wrong, "", None
        given = parse_qs(query).get("token", [""])[0]
        if given and (person := self.door.person(given)) is not None:
            return "", given, person
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(self.name)
        except CookieError:
            kept = None
        if kept is not None and (person := self.door.person(kept.value)) is not None:
            return "", "", person
        return "the token is missing: open the address that the command has printed", "", None

    def _cookie(self, token: str, secure: bool) -> bytes:
        kept = f"{self.name}={token}; Path=/; HttpOnly; SameSite=Strict" + "; Secure" * secure
        return kept.encode()


def _with_headers(send: Send) -> Send:
    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *HEADERS]
        await send(message)

    return sending


async def answer(
    send: Send, status: int, text: str, *headers: tuple[bytes, bytes],
    kind: str = "text/plain",
) -> None:
    """Send a short page."""
    own = (b"content-type", f"{kind}; charset=utf-8".encode()), (b"cache-control", b"no-store")
    await send({"type": "http.response.start", "status": status, "headers": [*own, *headers]})
    await send({"type": "http.response.body", "body": text.encode()})
