"""The options for a python-can bus, shared by several commands."""

import argparse
from typing import TYPE_CHECKING, Any

from . import arguments

if TYPE_CHECKING:
    from ...envs.serve.description import BusRow

INTERFACE, CHANNEL, BITRATE = "udp_multicast", "239.74.163.2", 1_000_000


OPTIONS = (
    "interface", "channel", "bitrate", "data_bitrate", "fd", "timing", "bus_kwargs", "bus_config",
)


def refuse(options: argparse.Namespace, reason: str, *others: str) -> None:
    """Raise ValueError if an option for a bus, or one of the `others`, would have no effect."""
    arguments.refuse(options, reason, *OPTIONS, *others)


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of python-can."""
    from can.cli import add_bus_arguments

    add_bus_arguments(parser, group_title="bus (options of python-can)")
    parser.add_argument("--bus-config", help="section of python-can's configuration file")


def opened(options: argparse.Namespace) -> Any:
    """Open the bus given by the options. Raises ValueError with a one-line reason."""
    from ...drive.wire import interfaces

    return interfaces.opened(keywords(options), option)


def where(options: argparse.Namespace) -> str:
    """Describe the bus by its options."""
    from ...drive.wire import interfaces

    return interfaces.described(keywords(options), option)


def keywords(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keywords of ``can.Bus``."""
    given: dict[str, Any] = {"single_handle": True}
    if options.bus_config:
        given["config_context"] = options.bus_config
    elif "interface" not in options:
        given |= {"interface": INTERFACE} | ({} if "channel" in options else {"channel": CHANNEL})
    if "bitrate" not in options and "timing" not in options and not options.bus_config:
        given["bitrate"] = BITRATE
    names = ("channel", "interface", "bitrate", "fd", "data_bitrate", "timing")
    given |= {name: getattr(options, name) for name in names if name in options}
    return given | getattr(options, "bus_kwargs", {})


def row(options: argparse.Namespace, **others: Any) -> "BusRow":
    """Return the bus given by the options as a row of a machine file, with further fields."""
    from ...envs.serve.description import BusRow

    given = keywords(options)
    interface, channel = (f"{given.pop(name, '')}" for name in ("interface", "channel"))
    return BusRow("bus", "can", interface=interface, channel=channel, options=given, **others)


def option(name: str) -> str:
    """Return the option of a keyword."""
    return f"--{name.replace('_', '-')}"
