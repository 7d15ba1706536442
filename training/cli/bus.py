"""The options for a python-can bus, which several commands share."""

import argparse
import inspect
import re
from collections.abc import Callable
from typing import Any

from ...drive.model.names import hint

INTERFACE, CHANNEL, BITRATE = "udp_multicast", "239.74.163.2", 1_000_000


OPTIONS = (
    "interface", "channel", "bitrate", "data_bitrate", "fd", "timing", "bus_kwargs", "bus_config",
)


def refuse(options: argparse.Namespace, reason: str, *others: str) -> None:
    """Raise ValueError if an option for a bus, or one of the `others`, would have no effect."""
    for name in (*OPTIONS, *others):
        if getattr(options, name, None) not in (None, False):
            raise ValueError(f"--{name.replace('_', '-')} {reason}")


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of python-can."""
    from can.cli import add_bus_arguments

    add_bus_arguments(parser, group_title="bus (options of python-can)")
    parser.add_argument("--bus-config", help="section of python-can's configuration file")


def opened(options: argparse.Namespace):
    """Open the bus given by the options. Raises ValueError with a one-line reason."""
    import can
    from can.cli import create_bus_from_namespace

    given: dict[str, Any] = {}
    if options.bus_config:
        given["config_context"] = options.bus_config
    elif "interface" not in options:
        given = {"interface": INTERFACE} | ({} if "channel" in options else {"channel": CHANNEL})
    if "bitrate" not in options and "timing" not in options and not options.bus_config:
        given["bitrate"] = BITRATE
    if given.get("interface", getattr(options, "interface", "")) == "udp_multicast":
        given["fd"] = False  # a node speaks classical CAN; its bus is FD by default
    _check_keywords(options, given)
    try:
        return create_bus_from_namespace(options, **given)
    except Exception as error:
        reason = error.__cause__ or error  # python-can and its back-ends raise anything
        place = where(options)
        kind = "" if isinstance(reason, (can.CanError, OSError)) else f"{type(reason).__name__}: "
        said = re.sub(r"^.Errno -?[0-9]+. ", "", " ".join(str(reason).split()))
        if "serial module" in said:
            said += ': pip install "servogym[slcan]"'
        if missing := re.search(r"missing 1 required .*'(\w+)'", said):
            kind, said = "", f"give --{missing[1].replace('_', '-')}"
        raise ValueError(
            f"no bus on {place or 'the default'}: {kind}{said}; "
            f"without hardware use -i {INTERFACE} -c {CHANNEL}"
        ) from None


def where(options: argparse.Namespace) -> str:
    """Return the options for the bus as they were given."""
    names = ("bus_config", "interface", "channel", "bitrate", "bus_kwargs")
    given = {name: getattr(options, name, None) for name in names}
    if isinstance(given["bus_kwargs"], dict):
        given["bus_kwargs"] = " ".join(f"{k}={v}" for k, v in given["bus_kwargs"].items())
    return " ".join(f"--{name.replace('_', '-')} {v}" for name, v in given.items() if v)


def _keywords(constructor: Callable[..., Any]) -> set[str]:
    """Collect a constructor's keywords from its signature, its documentation and its kwargs."""
    parameters = inspect.signature(constructor).parameters.values()
    documented = re.findall(r":param\b[^:]*?(\w+):", constructor.__doc__ or "")
    code = getattr(constructor, "__code__", None)
    asked = {text for text in getattr(code, "co_consts", ()) if isinstance(text, str)}
    named = {p.name for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}
    return (named | {*documented} | {text for text in asked if text.isidentifier()}) - {"self"}


def _check_keywords(options: argparse.Namespace, given: dict[str, Any]) -> None:
    """Raise ValueError for a keyword of --bus-kwargs that the interface does not know.

    Many back-ends accept any keyword (**kwargs) and drop unknown ones, so the constructors of all
    their classes are inspected.
    """
    from can.interface import _get_class_for_interface
    from can.util import load_config

    keywords = getattr(options, "bus_kwargs", None)
    if not keywords:
        return
    interface = getattr(options, "interface", given.get("interface"))
    try:
        interface = load_config(
            config={"interface": interface} if interface else None,
            context=given.get("config_context"),
        )["interface"]
        classes = _get_class_for_interface(interface).__mro__
    except Exception:  # the bus itself gives a better message
        return
    known: set[str] = set()
    for cls in classes:
        if "__init__" in vars(cls) and cls is not object:
            known |= _keywords(vars(cls)["__init__"])
    for keyword in keywords:
        if keyword not in known:
            raise ValueError(
                f"--bus-kwargs {keyword}: -i {interface} does not know it; {hint(keyword, known)}"
            )
