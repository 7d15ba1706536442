"""`servogym observe`."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from . import bus as buses


def add(observe: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    observe.add_argument(
        "--node-id", type=arguments.NODE_ID, help="node-id of the drive on CAN, 1..127 (1)"
    )
    observe.add_argument(
        "--ethercat", metavar="IFACE",
        help="observe an EtherCAT slave at this interface, such as eth0",
    )
    observe.add_argument(
        "--position", type=arguments.POSITION,
        help="with --ethercat: position of the slave, from 0 on (0)",
    )
    observe.add_argument(
        "--drive", default="generic",
        help="drive model to compare with; while observing, it gives the data types of the "
        "objects (generic)",
    )
    observe.add_argument("--read-only", action="store_true", help="write nothing to the drive")
    observe.add_argument(
        "--compare", type=Path, metavar="FILE", help="compare this observation with the model"
    )
    observe.add_argument(
        "-o", "--out", type=Path,
        help="file for the observation; with --compare, folder for a model with the observed "
        "answers",
    )
    buses.add(observe)
    observe.set_defaults(run=_observe)


def _observe(options: argparse.Namespace, console: Console) -> int:
    if options.compare is not None:
        buses.refuse(options, "is not for --compare", "node_id", "ethercat", "position",
                     "read_only")
        return _compare(options, console)
    if options.ethercat is not None:
        buses.refuse(options, "is for CAN, not for --ethercat", "node_id")
    elif options.position is not None:
        raise ValueError("--position is for a slave on EtherCAT: give --ethercat IFACE")
    options.node_id, options.position = options.node_id or 1, options.position or 0
    if options.out is None:
        raise ValueError("-o FILE is missing: where the observation is written")
    if options.out.exists():
        raise ValueError(f"-o {options.out} is there already: choose a file that is new")
    on_ethercat = options.ethercat is not None
    drive = f"slave {options.position}" if on_ethercat else f"node {options.node_id}"
    with console.status(f"{drive} ...") as status:
        found = (_slave if on_ethercat else _node)(
            options, lambda text: status.update(f"{drive}: {text} ...")
        )
    options.out.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    wrote = "nothing was written to it: " + found["read_only"] if found["read_only"] else (
        "what was written to it is put back")
    print(
        f"{options.out}: {len(found['objects'])} objects, {len(found['dialogues'])} dialogues of "
        f"{drive}; {wrote}"
    )
    left = [where for where, one in found["objects"].items() if "not_restored" in one]
    if left:
        print(f"not put back, the drive shows another value now: {', '.join(left)}")
    return 0


def _node(options: argparse.Namespace, tell: Callable[[str], None]) -> dict[str, Any]:
    """Observe a node on CAN."""
    from ...drive.canopen.observe import Observer
    from ...drive.model.model import load
    from ...drive.wire.bus import CanPort

    model = load(options.drive)
    bus = buses.opened(options)
    try:
        port = CanPort(bus)
        return Observer(
            port, options.node_id, model, read_only=options.read_only, tell=tell
        ).observe()
    finally:
        bus.shutdown()


def _slave(options: argparse.Namespace, tell: Callable[[str], None]) -> dict[str, Any]:
    """Observe a slave on EtherCAT."""
    from ...drive.wire.soem import check_access

    check_access(options.ethercat)
    from ...drive.model.model import load
    from ...drive.wire.ethercat_observe import observe

    return observe(
        options.ethercat, options.position, load(options.drive, "ethercat"),
        read_only=options.read_only, tell=tell,
    )


def _compare(options: argparse.Namespace, console: Console) -> int:
    """Print the differences; exit status 1 if there are any."""
    from ...drive.canopen import observe as canopen
    from ...drive.ethercat import observe as ethercat
    from ...drive.model.files import content
    from ...drive.model.made import check_place, write
    from ...drive.model.model import load
    from ...drive.observation import compare, opened, proposed
    from ...drive.statements import data_sheet

    file = options.compare
    if not file.exists():
        raise ValueError(f"--compare {file}: there is no such file")
    found = opened(content(file, "an observation").decode("utf-8", "replace"), str(file))
    on_ethercat = found.get("bus") == "ethercat"
    model = load(options.drive, "ethercat" if on_ethercat else "can")
    if options.out is not None:
        check_place(options.out)
    with console.status(f"{model.name} ..."):
        if on_ethercat:
            own = ethercat.of_model(model, found)
        else:
            own = canopen.of_model(model, int(found["node_id"]), found)
        differences = compare(found, own)
    for difference in differences:
        print(difference)
    count = len({difference.where for difference in differences})
    print(f"{file}: {count} of {len(found['objects']) + len(found['dialogues'])} objects and "
          f"dialogues differ from {model.name}")
    if options.out is not None:
        write(proposed(differences, model, file.name, found), options.out, data_sheet)
        print(f"{options.out}: a model on top of {model.name}, its rows are marked observed")
    return int(bool(differences))
