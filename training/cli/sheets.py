"""`servogym eds` and `servogym esi`: data sheets of a drive model for configuration tools."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments


def add_eds(eds: argparse.ArgumentParser) -> None:
    """Add the options of `eds`."""
    eds.add_argument("model", help="name or folder of a model")
    eds.add_argument("-o", "--out", type=Path, required=True, help="output file, .eds or .dcf")
    eds.add_argument("--dcf", action="store_true", help="write a DCF with the values of one node")
    eds.add_argument("--node-id", type=arguments.NODE_ID, help="node-id for --dcf, 1..127")
    eds.set_defaults(run=_eds, files=("out",))


def add_esi(esi: argparse.ArgumentParser) -> None:
    """Add the options of `esi`."""
    esi.add_argument("model", help="name or folder of a model")
    esi.add_argument(
        "-o", "--out", type=Path, required=True,
        help="output file: .xml, or .bin for the EEPROM image",
    )
    esi.set_defaults(run=_esi, files=("out",))


def _eds(options: argparse.Namespace, console: Console) -> int:
    from ...drive.canopen import eds
    from ...drive.model.model import load

    if options.dcf != (options.node_id is not None):
        raise ValueError("--dcf and --node-id belong together: a DCF is that of one node")
    count = eds.write(options.model, options.out, options.node_id)
    console.print(f"{options.out}: {count} objects of {load(options.model).name}")
    return 0


def _esi(options: argparse.Namespace, console: Console) -> int:
    from ...drive.ethercat import esi, sii
    from ...drive.model.model import load

    model = load(options.model, "ethercat")
    if options.out.suffix == ".bin":
        image = sii.of_model(model)
        options.out.write_bytes(image)
        console.print(f"{options.out}: EEPROM of {model.name}, {len(image)} bytes")
        return 0
    if options.out.suffix != ".xml":
        raise ValueError(f"-o {options.out}: the name of the file has to end with .xml or .bin")
    value = esi.of_model(model)
    options.out.write_text(esi.write(value), encoding="utf-8")
    console.print(f"{options.out}: {len(value.names)} objects of {model.name}")
    return 0
