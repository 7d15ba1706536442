"""`servogym esi`."""

import argparse
from pathlib import Path

from rich.console import Console


def add(esi: argparse.ArgumentParser) -> None:
    """Its options."""
    esi.add_argument("model", help="name or folder of a model")
    esi.add_argument("-o", "--out", type=Path, required=True, help="file .xml, or .bin: its EEPROM")
    esi.set_defaults(run=_esi, files=("out",))


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
