"""Serve the panel of a session: the loopback alone, unless told otherwise."""

import secrets
import socket
from collections.abc import Callable

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


def serve(
    session: Bench, *, host: str = "127.0.0.1", port: int = PORT, browser: bool = True,
    pictures: int = 25, tell: Callable[[str], object] = print,
) -> None:  # fmt: skip
    """Serve until the process is told to end.

    Args:
        session: runs in real time from now on.
        host: address to listen on; beyond the loopback a token is needed, which is printed.
        port: TCP port.
        browser: whether to open one.
        pictures: a second, at most; a browser that is slower gets fewer.
        tell: is told where the page is.

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
    token = "" if is_loopback(host) else secrets.token_urlsafe(16)
    clock = Clock(session)

    async def root() -> None:
        await build(clock, pictures)

    def begin() -> None:
        clock.start()
        where = "localhost" if host in ("127.0.0.1", "0.0.0.0", "::", "::1") else host
        query = f"/?token={token}" if token else ""
        tell(f"panel of {session.title} on http://{where}:{port}{query}")
        if token:
            tell(
                f"open to whoever reaches {host} and knows the token: they command the machine, "
                "read and write its parameters; nothing is encrypted"
            )

    app.on_startup(begin)
    app.on_shutdown(clock.stop)
    app.add_middleware(Guard, host=host, port=port, token=token)
    ui.run(
        root, host=host, port=port, title=f"servogym panel · {session.title}", show=browser,
        reload=False, tailwind=False, show_welcome_message=False, dark=False,
        favicon="⚙️", reconnect_timeout=10.0, uvicorn_logging_level="error",
        ws_per_message_deflate=False,
    )  # fmt: skip
