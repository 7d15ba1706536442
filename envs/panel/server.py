"""Serve the panel of a session: the loopback alone, unless told otherwise."""

import os
import secrets
import socket
from collections.abc import Callable
from pathlib import Path

from .bench import Bench
from .clock import Clock
from .guard import Guard, is_loopback

PORT = 8402


def free(host: str, port: int) -> None:
    """Raises ValueError where the port cannot be had."""
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
    """This user's token, the same each time, so that a page finds a server that was started anew.

    It lies in a file that nobody else may read; where none can be, it is a new one.
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
) -> None:  # fmt: skip
    """Serve until the process is told to end.

    Args:
        session: runs in real time from now on.
        host: address to listen on.
        port: TCP port.
        browser: whether to open one.
        pictures: a second, at most; a browser that is slower gets fewer.
        tell: is told where the page is, with the token that a browser needs.
        token: that a browser needs; this user's own if none is given.

    Raises:
        ValueError: the port cannot be had.
        ImportError: nicegui is missing.
    """
    try:
        from nicegui import app, ui
    except ImportError:
        raise ImportError("the panel needs nicegui: pip install 'servogym[panel]'") from None
    from .pages.shell import build

    free(host, port)
    token = token or kept_token()
    clock = Clock(session)

    first = f"/?token={token}"

    async def root() -> None:
        await build(clock, pictures)

    def begin() -> None:
        clock.start()
        where = "localhost" if host in ("127.0.0.1", "0.0.0.0", "::", "::1") else host
        tell(f"panel of {session.title} on http://{where}:{port}{first}")
        if not is_loopback(host):
            tell(
                f"open to whoever reaches {host} and knows the token: they command the machine, "
                "read and write its parameters; nothing is encrypted"
            )

    app.on_startup(begin)
    app.on_shutdown(clock.stop)
    app.add_middleware(Guard, token=token, name=f"servogym_panel_{port}")
    ui.run(
        root, host=host, port=port, title=f"servogym panel · {session.title}",
        show=first if browser else False, reload=False, tailwind=False, show_welcome_message=False,
        dark=False,         favicon="⚙️", reconnect_timeout=10.0, uvicorn_logging_level="error",
        ws_per_message_deflate=False,
    )  # fmt: skip
