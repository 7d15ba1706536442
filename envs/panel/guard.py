"""Who may ask: the right host, the right origin and, beyond the loopback, a token.

A page of a stranger that the same browser has open could send requests to the loopback, or let its
own name point there (DNS rebinding): it has another origin, or another host, and is refused.
"""

import hmac
import ipaddress
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
LOOPBACK = ("127.0.0.1", "localhost", "::1")
COOKIE = "servogym_panel"


def is_loopback(host: str) -> bool:
    """Whether a host is this computer alone."""
    return host in LOOPBACK


class Guard:
    """Lets pass what may, and answers the rest with 403 and a sentence.

    Args:
        app: what is guarded, an ASGI application.
        host: where it is served.
        port: at which port.
        token: that has to be known, as ``?token=`` once and as a cookie then; empty: none.
    """

    def __init__(self, app: Callable[..., Awaitable[None]], host: str, port: int, token: str):
        self.app, self.host, self.port, self.token = app, host, port, token

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
            await self.app(scope, receive, self._with_cookie(send) if cookie else send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": wrong[:100]})
        else:
            body = f"servogym panel: {wrong}\n".encode()
            kind = (b"content-type", b"text/plain; charset=utf-8")
            await send({"type": "http.response.start", "status": 403, "headers": [kind]})
            await send({"type": "http.response.body", "body": body})

    def judge(self, headers: dict[str, str], query: str) -> tuple[str, bool]:
        """Why a request is refused, empty if it is not; and whether the cookie is to be set."""
        host = headers.get("host", "")
        if not self._known(host):
            return f"host {host[:80]!r} is not served here, open http://{self._own()}", False
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return f"origin {origin[:80]!r} is a stranger here", False
        if headers.get("sec-fetch-site") == "cross-site" and "upgrade" in headers:
            return "a stranger's page may not connect", False
        if not self.token:
            return "", False
        given = parse_qs(query).get("token", [""])[0]
        if given and hmac.compare_digest(given.encode(), self.token.encode()):
            return "", True
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            kept = None
        if kept is not None and hmac.compare_digest(kept.value.encode(), self.token.encode()):
            return "", False
        return "the token is missing: open the address that `servogym panel` has printed", False

    def _own(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def _known(self, host: str) -> bool:
        try:
            parts = urlsplit(f"//{host}")
            name, port = parts.hostname or "", parts.port or 80
        except ValueError:
            return False
        if port != self.port:
            return False
        if is_loopback(self.host):
            return is_loopback(name)
        if name == self.host or is_loopback(name):
            return True
        try:  # by any of its addresses; by no name that somebody else may point here
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def _with_cookie(self, send: Callable[..., Any]) -> Callable[..., Any]:
        cookie = f"{COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict".encode()

        async def sending(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), (b"set-cookie", cookie)]
            await send(message)

        return sending
