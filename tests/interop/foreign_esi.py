"""What becomes of ESI files of other makers: imported, served, moved by a foreign master.

    python tests/interop/foreign_esi.py FOLDER > table.md

Each .xml and .bin of the folder becomes a model, the model a slave of `servogym ethercat` with a
linear axis at one end of a veth pair, and an unmodified pysoem at the other maps the PDOs as they
are found, enables the drive and moves it 100 mm in csp, in the drive's own position units.
"""

import sys
import tempfile
from pathlib import Path

from wire import on_the_wire

from servogym.drive.imports.ethercat import import_esi, import_sii
from servogym.drive.model.model import load
from servogym.envs import linear_axis

DISTANCE = 0.1  # m
HEAD = """| file | imported | objects | repairs | PDOs | OP | enabled | moved |
|---|---|---|---|---|---|---|---|"""


def outcome(file, place):
    """The cells of a row behind the name."""
    make = import_sii if file.suffix == ".bin" else import_esi
    try:
        made = make(file, place / "model")
    except ValueError as error:
        return [str(error).replace(f"{file.parent}/", "")[:120], *[""] * 6]
    cells = ["yes", str(made.objects), str(len(made.repairs)), f"{made.pdos[0]}, {made.pdos[1]}"]
    try:
        machine = linear_axis(load(made.folder, "ethercat"))
        machine.step()
        drive, gear = machine.drives["x"], float(machine.couplings[0].gear)
        unit = float(drive.axis.rad_per_position_unit) / gear
        found = on_the_wire(
            "pysoem_master", "as_found", "--drive", str(made.folder), distance=DISTANCE / unit
        )
    except (ValueError, AssertionError) as error:
        return [*cells, f"{type(error).__name__}: {error}".splitlines()[-1][:160], "", ""]
    way = found["moved"]
    moved = "no 607Ah in its PDOs" if way is None else f"{way * unit * 1e3:.2f} mm"
    return [*cells, "yes" if found["state"] == 8 else hex(found["state"]),
            "yes" if found["status"] & 0x6F == 0x27 else f"{found['status']:04X}h",
            found.get("why", moved)]


def main(folder):
    print(HEAD)
    for file in sorted(p for p in Path(folder).iterdir() if p.suffix in (".xml", ".bin")):
        with tempfile.TemporaryDirectory() as place:
            print(f"| {file.name} | {' | '.join(outcome(file, Path(place)))} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
