"""Who may ask: the one that knows the token, from a page of our own.

The token is asked for on the loopback, too: other people's programs on this computer reach it. It
comes as ``?token=`` once and as a cookie from then on. A stranger's page that the same browser has
open has no cookie of ours, or, as a page of another port of this computer, another origin; a name
that somebody points here (DNS rebinding) has no cookie either. So the host does not matter: behind
a proxy, an ``ssh -L`` with another port and by a bare name it is another one, and that is right.
"""

import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
LOOPBACK = ("127.0.0.1", "localhost", "::1")
HEADERS = (  # no other page shows ours in a frame; nothing is loaded from elsewhere
    (b"x-frame-options", b"DENY"),
    (
        b"content-security-policy",
        b"default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' "
        b"'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' "
        b"ws: wss:; object-src 'none'; base-uri 'self'; form-action 'self'; frame-ancestors 'none'",
    ),
    (b"referrer-policy", b"no-referrer"),  # the first address has the token
    (b"x-content-type-options", b"nosniff"),
)


def is_loopback(host: str) -> bool:
    """Whether a host is this computer alone."""
    return host in LOOPBACK


class Guard:
    """Lets pass what may, and answers the rest with 403 and a sentence.

    Args:
        app: what is guarded, an ASGI application.
        token: that has to be known.
        name: of the cookie: one for each server, for a browser keeps them by host, not by port.
    """

    def __init__(self, app: Callable[..., Awaitable[None]], token: str, name: str):
        self.app, self.token, self.name = app, token, name

    async def __call__(
        self, scope: Scope, receive: Callable[..., Any], send: Callable[..., Any]
    ) -> None:  # fmt: skip
        """ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1")
                   for name, value in scope["headers"]}  # fmt: skip
        wrong, cookie = self.judge(headers, scope.get("query_string", b"").decode("latin-1"))
        if not wrong:
            secure = headers.get("x-forwarded-proto", scope.get("scheme", "")) in ("https", "wss")
            await self.app(scope, receive, self._sending(send, cookie, secure))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": wrong[:100]})
        else:
            body = f"servogym panel: {wrong}\n".encode()
            kind = (b"content-type", b"text/plain; charset=utf-8")
            headers_ = [kind, *HEADERS]
            await send({"type": "http.response.start", "status": 403, "headers": headers_})
            await send({"type": "http.response.body", "body": body})

    def judge(self, headers: dict[str, str], query: str) -> tuple[str, bool]:
        """Why a request is refused, empty if it is not; and whether the cookie is to be set."""
        origin = headers.get("origin")
        if origin is not None:
            served = {headers.get("host", "").lower(), headers.get("x-forwarded-host", "").lower()}
            if urlsplit(origin).netloc.lower() not in served - {""}:
                return (
                    f"origin {origin[:80]!r} is a stranger here; a proxy has to pass the header "
                    "Host, or X-Forwarded-Host", False,
                )  # fmt: skip
        if headers.get("sec-fetch-site") == "cross-site" and "upgrade" in headers:
            return "a stranger's page may not connect", False
        given = parse_qs(query).get("token", [""])[0]
        if given and hmac.compare_digest(given.encode(), self.token.encode()):
            return "", True
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(self.name)
        except CookieError:
            kept = None
        if kept is not None and hmac.compare_digest(kept.value.encode(), self.token.encode()):
            return "", False
        return "the token is missing: open the address that `servogym panel` has printed", False

    def _sending(self, send: Callable[..., Any], cookie: bool, secure: bool) -> Callable[..., Any]:
        kept = f"{self.name}={self.token}; Path=/; HttpOnly; SameSite=Strict" + "; Secure" * secure

        async def sending(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                own = [(b"set-cookie", kept.encode())] if cookie else []
                message["headers"] = [*message.get("headers", []), *HEADERS, *own]
            await send(message)

        return sending
