"""`servogym observe`."""

import argparse
import json
from pathlib import Path

from rich.console import Console

from . import bus as buses


def add(observe: argparse.ArgumentParser) -> None:
    """Its options."""
    observe.add_argument("--node-id", type=int, default=1, help="of the drive, 1..127 (1)")
    observe.add_argument(
        "--drive", default="generic",
        help="model to compare with; while observing, whose data types the objects have (generic)",
    )  # fmt: skip
    observe.add_argument("--read-only", action="store_true", help="write nothing to the drive")
    observe.add_argument("--compare", type=Path, metavar="FILE", help="an observation made before")
    observe.add_argument(
        "-o", "--out", type=Path,
        help="file for the observation; with --compare a folder for a model that says the same",
    )  # fmt: skip
    buses.add(observe)
    observe.set_defaults(run=_observe)


def _observe(options: argparse.Namespace, console: Console) -> int:
    if options.compare is not None:
        return _compare(options, console)
    from ...drive.canopen.observe import Observer
    from ...drive.model.model import load
    from ...drive.wire.bus import CanPort

    if not 1 <= options.node_id <= 127:
        raise ValueError(f"--node-id = {options.node_id} is out of range 1..127")
    if options.out is None:
        raise ValueError("-o FILE is missing: where the observation is written")
    if options.out.exists():
        raise ValueError(f"-o {options.out} is there already: choose a file that is new")
    model = load(options.drive)
    bus = buses.opened(options)
    try:
        with console.status(f"node {options.node_id} ...") as status:
            observer = Observer(
                CanPort(bus), options.node_id, model, read_only=options.read_only,
                tell=lambda text: status.update(f"node {options.node_id}: {text} ..."),
            )  # fmt: skip
            found = observer.observe()
    finally:
        bus.shutdown()
    options.out.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    wrote = "nothing was written to it: " + found["read_only"] if found["read_only"] else (
        "what was written to it is put back")  # fmt: skip
    print(
        f"{options.out}: {len(found['objects'])} objects, {len(found['dialogues'])} dialogues of "
        f"node {options.node_id}; {wrote}"
    )
    left = [where for where, one in found["objects"].items() if "not_restored" in one]
    if left:
        print(f"not put back, the drive shows another value now: {', '.join(left)}")
    return 0


def _compare(options: argparse.Namespace, console: Console) -> int:
    """Print the differences; 1 where there are some."""
    from ...drive.canopen.observe import compare, of_model, opened, proposed
    from ...drive.model.files import content
    from ...drive.model.made import check_place, write
    from ...drive.model.model import load
    from ...drive.statements import data_sheet

    file = options.compare
    if not file.exists():
        raise ValueError(f"--compare {file}: there is no such file")
    found = opened(content(file, "an observation").decode("utf-8", "replace"), str(file))
    model = load(options.drive, "can")
    if options.out is not None:
        check_place(options.out)
    with console.status(f"{model.name} ..."):
        differences = compare(found, of_model(model, int(found["node_id"])))
    for difference in differences:
        print(difference)
    count = len({difference.where for difference in differences})
    print(f"{file}: {count} of {len(found['objects']) + len(found['dialogues'])} objects and "
          f"dialogues differ from {model.name}")  # fmt: skip
    if options.out is not None:
        write(proposed(differences, model, file.name), options.out, data_sheet)
        print(f"{options.out}: a model on top of {model.name}, its rows are marked observed")
    return int(bool(differences))
