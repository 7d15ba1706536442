"""Serve the panel of a session, or a classroom, by default only on the loopback interface."""

import asyncio
import inspect
import logging
import os
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from .bench import Bench
from .classroom import Classroom
from .clock import Clock
from .guard import PERSON, Door, Guard, Owner, is_loopback
from .reception import Reception

PORT = 8402
# what NiceGUI and Starlette log if a browser has left before its answer was ready
GONE = ("has been deleted", "No response returned")


def free(host: str, port: int) -> None:
    """Raise ValueError if the port is not available."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except OSError as error:
        raise ValueError(
            f"--host {host} --port {port}: {error.strerror or error}; choose another of them"
        ) from None


def kept_token() -> str:
    """Return this user's permanent token, with which a page reconnects to a restarted server.

    It is kept in a file that nobody else may read; if that is impossible, the token is a new one.
    """
    path = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config", "servogym/token")
    token = secrets.token_urlsafe(16)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        try:
            with open(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w") as file:
                file.write(token)
            return token
        except FileExistsError:
            pass
        about = path.stat()
        mine = about.st_uid == os.getuid() and not about.st_mode & 0o077
        known = path.read_text(encoding="ascii").strip() if mine else ""
        return known if len(known) >= len(token) else token
    except (OSError, RuntimeError, UnicodeDecodeError):
        return token


def serve(
    session: Bench, *, host: str = "127.0.0.1", port: int = PORT, browser: bool = True,
    pictures: int = 25, tell: Callable[[str], object] = print, token: str = "",
) -> None:
    """Serve the panel of a session until the process ends.

    Args:
        session: runs in real time from now on.
        host: address to listen on.
        port: TCP port.
        browser: whether to open a browser.
        pictures: maximum number of pictures per second; a slower browser gets fewer.
        tell: receives the lines that say where the page is, with the token that a browser needs.
        token: the token that a browser needs; this user's own by default.

    Raises:
        ValueError: the port is not available.
        ImportError: nicegui is missing.
    """
    pages, token, clock = _pages(), token or kept_token(), Clock(session)

    async def root() -> None:
        await pages.build(clock, pictures)

    lines = [f"panel of {session.title} on {address(host, port)}?token={token}"]
    if not is_loopback(host):
        lines.append(
            f"open to everybody who reaches {host} and knows the token: they command the machine, "
            "read and write its parameters; nothing is encrypted"
        )
    _run(root, Owner(token), lines, tell, clock.start, clock.stop, host=host, port=port,
         title=f"servogym panel · {session.title}", show=f"/?token={token}" if browser else False)


def serve_class(
    room: Classroom, *, host: str = "127.0.0.1", port: int = PORT, browser: bool = True,
    tell: Callable[[str], object] = print, token: str = "",
) -> None:
    """Serve a classroom until the process ends.

    Args:
        room: the classroom.
        host: address to listen on.
        port: TCP port.
        browser: whether to open a browser with the teacher's wall.
        tell: receives the lines with the addresses and the code of the class.
        token: the teacher's token; this user's own by default.

    Raises as `serve` does.
    """
    pages, token, where = _pages(), token or kept_token(), address(host, port)
    door = Reception(room, token)

    async def root() -> None:
        await pages.show_class(room, door, where)

    lines = [
        f"the teacher's wall: {where}?token={token}",
        f"pupils open {where} and give the code {room.word} and a name",
        "only this computer reaches it; for pupils on others: --host 0.0.0.0" if is_loopback(host)
        else f"open to everybody who reaches {host}; nothing is encrypted, see "
        "docs/how-to/class.md",
    ]
    _run(root, door, lines, tell, lambda: None, room.end, host=host, port=port,
         title="servogym classroom", show=f"/?token={token}" if browser else False)


def concerns_somebody(record: logging.LogRecord) -> bool:
    """Whether a log record is more than the consequence of a page that has been closed."""
    said = str(record.exc_info[1]) if record.exc_info else record.getMessage()
    return not any(words in said for words in GONE)


def owner(page: str) -> Any:
    """The person to whom a page belongs, by its id; None if there is no such page."""
    from nicegui import Client

    client = Client.instances.get(page)
    return client.request.scope.get(PERSON) if client is not None and client.request else None


def speak_for_own_pages() -> None:
    """Drop messages of a web socket that are malformed or meant for another person's page.

    NiceGUI itself accepts every message that contains the id of a page.
    """
    from nicegui.nicegui import sio

    def checked(kind: str, handle: Callable[..., Any]) -> Callable[..., Any]:
        async def receive(socket: str, *sent: Any) -> Any:
            if (line := sio.get_environ(socket)) is None:
                return False  # the line was cut meanwhile
            person = line["asgi.scope"].get(PERSON)
            message = sent[0] if sent and isinstance(sent[0], dict) else {}
            page = message.get("client_id", "")
            if kind == "connect":
                page = parse_qs(message.get("QUERY_STRING", "")).get("client_id", [""])[0]
            if owner(str(page)) not in (None, person):
                return False
            try:
                done = handle(socket, *sent)
                return await done if inspect.isawaitable(done) else done
            except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
                logging.getLogger("servogym").warning("a message was dropped: %r", error)
                return False

        return receive

    for kind in ("connect", "handshake", "event", "javascript_response", "ack", "log"):
        sio.on(kind, checked(kind, sio.handlers["/"][kind]))


def address(host: str, port: int) -> str:
    """The address for a browser."""
    if host in ("0.0.0.0", "::"):
        return f"http://{socket.gethostname()}:{port}/"
    name = "localhost" if host in ("127.0.0.1", "::1") else host
    return f"http://[{name}]:{port}/" if ":" in name else f"http://{name}:{port}/"


def _pages() -> Any:
    try:
        from .pages import shell
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "nicegui":
            raise
        raise ImportError("the panel needs nicegui: pip install 'servogym[panel]'") from None
    return shell


def _run(
    root: Callable[[], Any], door: Door, lines: list[str], tell: Callable[[str], object],
    begin: Callable[[], None], end: Callable[[], None], *, host: str, port: int, **options: Any,
) -> None:
    from nicegui import app, ui
    from nicegui.server import Server

    async def listening() -> None:
        """Print the address once the port is open; uvicorn has no event for that."""
        while not Server.instance.started:
            await asyncio.sleep(0.01)
        for line in lines:
            tell(line)

    for logger in ("nicegui", "uvicorn.error"):
        logging.getLogger(logger).addFilter(concerns_somebody)
    free(host, port)
    app.on_startup(begin)
    app.on_startup(listening)
    app.on_shutdown(end)
    app.add_middleware(Guard, door=door, name=f"servogym_panel_{port}", owner=owner)
    speak_for_own_pages()
    ui.run(
        root, host=host, port=port, **options, reload=False, tailwind=False, dark=False,
        show_welcome_message=False, favicon="⚙️", reconnect_timeout=10.0,
        uvicorn_logging_level="error", ws_per_message_deflate=False,
    )
