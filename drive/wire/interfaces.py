"""Opens a python-can bus; an error is one line that says the next step."""

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import can

from ..model.names import hint

OWN = {  # keywords of `can.Bus` itself, and those that every interface accepts
    "interface", "channel", "config_context", "bitrate", "fd", "data_bitrate", "timing",
    "single_handle",
}


def described(given: Mapping[str, Any], named: Callable[[str], str]) -> str:
    """Describe a bus by interface, channel and further keywords, as the user gave them.

    Args:
        given: keywords of ``can.Bus``.
        named: returns the user's name for a keyword.
    """
    further = [f"{name}={given[name]}" for name in sorted(given.keys() - OWN)]
    rows = {
        "bus_config": given.get("config_context"), "interface": given.get("interface"),
        "channel": given.get("channel"), "bus_kwargs": " ".join(further),
    }
    return " ".join(f"{named(name)} {value}" for name, value in rows.items() if value)


def opened(given: Mapping[str, Any], named: Callable[[str], str] = str) -> can.BusABC:
    """Open a bus.

    Args:
        given: keywords of ``can.Bus``; empty ones are left out.
        named: see `described`.

    Raises:
        ValueError: unknown or unavailable interface, channel or keyword; the message is one line.
    """
    given = {name: value for name, value in given.items() if value != ""}
    if given.get("interface") == "udp_multicast":
        given.setdefault("fd", False)  # a node speaks classical CAN; its bus is FD by default
    _check(given.get("interface"), given.get("config_context"), [*given.keys() - OWN])
    try:
        return can.Bus(**given)
    except Exception as reason:  # python-can and its back-ends raise anything
        kind = "" if isinstance(reason, (can.CanError, OSError)) else f"{type(reason).__name__}: "
        said = re.sub(r"^.Errno -?[0-9]+. ", "", " ".join(str(reason).split()))
        if "serial module" in said:
            said += ': pip install "servogym[slcan]"'
        if missing := re.search(r"missing 1 required .*'(\w+)'", said):
            kind, said = "", f"give --{missing[1].replace('_', '-')}"
        raise ValueError(
            f"no bus on {described(given, named)}: {kind}{said}; "
            "without hardware use -i udp_multicast -c 239.74.163.2"
        ) from None


def _keywords(constructor: Callable[..., Any]) -> set[str]:
    """Collect a constructor's keywords from its signature, its documentation and its kwargs."""
    parameters = inspect.signature(constructor).parameters.values()
    documented = re.findall(r":param\b[^:]*?(\w+):", constructor.__doc__ or "")
    code = getattr(constructor, "__code__", None)
    asked = {text for text in getattr(code, "co_consts", ()) if isinstance(text, str)}
    named = {p.name for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}
    return (named | {*documented} | {text for text in asked if text.isidentifier()}) - {"self"}


def _check(interface: str | None, context: str | None, keywords: Iterable[str]) -> None:
    """Raise ValueError for a keyword that the interface does not know.

    Many back-ends accept any keyword (**kwargs) and drop unknown ones, so the constructors of all
    their classes are inspected.
    """
    from can.interface import _get_class_for_interface
    from can.util import load_config

    if not keywords:
        return
    try:
        interface = load_config(
            config={"interface": interface} if interface else None, context=context
        )["interface"]
        classes = _get_class_for_interface(interface).__mro__
    except Exception:  # opening the bus gives a better message
        return
    known: set[str] = set()
    for cls in classes:
        if "__init__" in vars(cls) and cls is not object:
            known |= _keywords(vars(cls)["__init__"])
    for keyword in keywords:
        if keyword not in known:
            raise ValueError(
                f"--bus-kwargs {keyword}: unknown to -i {interface}; {hint(keyword, known)}"
            )
