"""`servogym drives`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.table import Table

from . import arguments


def add(drives: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    drives.add_argument("model", nargs="?", help="name or folder of a model")
    drives.add_argument(
        "--from-eds", type=Path, metavar="FILE", help="make a model from an EDS or a DCF"
    )
    drives.add_argument(
        "--from-esi", type=Path, metavar="FILE", help="make an EtherCAT model from an ESI file"
    )
    drives.add_argument(
        "--from-sii", type=Path, metavar="FILE", help="make a model from an EEPROM image"
    )
    drives.add_argument(
        "--from-slave", metavar="IFACE",
        help="make a model from a connected slave by SDO information; needs servogym[soem]",
    )
    drives.add_argument(
        "--device", help="with --from-esi: select one of several devices by type or name"
    )
    drives.add_argument(
        "--position", type=arguments.POSITION, default=0,
        help="with --from-slave: position of the slave, from 0 on (0)",
    )
    drives.add_argument(
        "--chip", choices=("et1100", "lan9252", "emulated"), default="et1100",
        help="with --from-esi and --from-sii: slave controller; `emulated` has an emulated EEPROM "
        "(et1100)",
    )
    drives.add_argument(
        "--strict", action="store_true",
        help="with --from-eds: refuse a file that departs from CiA 306, and list the departures",
    )
    drives.add_argument(
        "--check", action="store_true",
        help="test the statements of the model (objects, ranges, modes, faults) and print its "
        "data sheet",
    )
    drives.add_argument("-o", "--out", type=Path, help="new or empty folder for the model")
    drives.set_defaults(run=_drives)


def _identity(model) -> str:
    """Format identity object 1018h, as far as the model has it."""
    parts = ("vendor-id", "product code", "revision", "serial number")
    rows = [(part, model.objects.get((0x1018, n))) for n, part in enumerate(parts, start=1)]
    return "\n".join(f"{part} {row.default:08X}h" for part, row in rows if row)


def _modes(model) -> str:
    return " ".join(map(model.mode_name, model.modes))


def _changes(model) -> Iterator[tuple[str, str]]:
    """Rows of the summary with the differences from the objects of the base model."""
    from ...drive.model.capabilities import SUPPORTED_METHODS, SUPPORTED_MODES
    from ...drive.model.model import load

    if model.based_on is None:
        return
    base = load(model.based_on)
    if model.bus in base.buses:
        base = load(base, model.bus)
    yield "based on", base.name
    own = {SUPPORTED_METHODS, SUPPORTED_MODES} & set(_indices(base))  # by rows of their own
    objects = {a: row for a, row in model.objects.items() if a[0] not in own}
    added = [row for address, row in objects.items() if address not in base.objects]
    yield "objects added", "\n".join(f"{_called(row)} {_limits(row)}".rstrip() for row in added)
    gone = [f"{index:04X}h" for index in _indices(base) if index not in _indices(model)]
    yield "objects left out", " ".join(gone)
    both = [(row, base.objects[a]) for a, row in objects.items() if a in base.objects]
    for what, of in (("limits", _limits), ("default", lambda row: str(row.default))):
        changed = [(row, of(row), of(other)) for row, other in both if of(row) != of(other)]
        lines = [
            f"{_called(row)} {now or 'any'}, was {then or 'any'}" for row, now, then in changed
        ]
        yield f"{what} changed", "\n".join(lines)


def _indices(model) -> list[int]:
    return list(dict.fromkeys(index for index, _ in model.objects))


def _called(row) -> str:
    return f"{row.index:04X}h:{row.subindex:02X}h {row.name}"


def _limits(row) -> str:
    """Format the allowed values of an object: a list, a range, or nothing for texts."""
    if row.allowed is not None:
        return ", ".join(map(str, sorted(row.allowed)))
    return f"{row.minimum:.12g}..{row.maximum:.12g}" if row.format else ""


def _import(options: argparse.Namespace) -> int:
    from ...drive.imports.eds import import_eds

    if options.from_eds is None or options.out is None or options.model is not None:
        raise ValueError("--from-eds FILE and -o FOLDER belong together, without a model")
    made = import_eds(options.from_eds, options.out, strict=options.strict)
    node = f"; a DCF of node {made.node_id}" if made.node_id is not None else ""
    print(
        f"{made.folder}: {made.objects} objects, {len(made.unknown)} of them unknown to the "
        f"profile, {len(made.left_out)} left out, {len(made.repairs)} repairs{node}; "
        f"{made.folder / 'README.md'} says what was repaired and what is inferred"
    )
    return 0


def _check(options: argparse.Namespace) -> int:
    """Print the data sheet of a model; exit status 1 if a statement does not hold."""
    from ...drive.statements import data_sheet

    if options.model is None:
        raise ValueError("--check needs a model: its name or its folder")
    sheet = data_sheet(options.model)
    print(sheet, end="")
    return int("\n- " in sheet)


def _of_ethercat(options: argparse.Namespace) -> int:
    from ...drive.imports.ethercat import import_esi, import_sii

    if options.out is None or options.model is not None:
        raise ValueError("--from-esi, --from-sii or --from-slave and -o FOLDER belong together, "
                         "without a model")
    if options.from_esi:
        made = import_esi(options.from_esi, options.out, device=options.device, chip=options.chip)
    elif options.from_sii:
        made = import_sii(options.from_sii, options.out, chip=options.chip)
    else:
        from ...drive.wire.slave_import import import_slave

        made = import_slave(options.from_slave, options.out, position=options.position)
    objects = f"{made.objects} objects" if made.objects else "the objects of generic"
    print(
        f"{made.folder}: {made.name}, {objects}, {made.pdos[0]} receive and {made.pdos[1]} "
        f"transmit PDOs, {len(made.repairs)} repairs; {made.folder / 'README.md'} says what was "
        "repaired and what is inferred"
    )
    return 0


def _drives(options: argparse.Namespace, console: Console) -> int:
    if options.check:
        return _check(options)
    sources = [options.from_eds, options.from_esi, options.from_sii, options.from_slave]
    if sum(source is not None for source in sources) > 1:
        raise ValueError("--from-eds, --from-esi, --from-sii and --from-slave: choose one")
    if any(source is not None for source in sources[1:]):
        return _of_ethercat(options)
    if options.from_eds is not None or options.out is not None or options.strict:
        return _import(options)
    from ...drive.drive import Drive
    from ...drive.model.model import foreign_names, load, model_names

    if options.model is None:
        table = Table("model", "title", "modes", "position cycle (µs)")
        for name in dict.fromkeys([*model_names(), *foreign_names()]):
            try:
                model = load(name)
            except ValueError as error:  # of another package
                table.add_row(name, str(error))
                continue
            table.add_row(
                name, model.title, _modes(model), f"{model.cycle_time['position'] * 1e6:g}"
            )
        console.print(table)
        return 0
    model = Drive(options.model).model  # with all the checks a drive makes
    own = [fault for fault in model.faults if fault.cause]
    faults = [f"{fault.name} {fault.code:04X}h {fault.meaning}".strip() for fault in own]
    if len(own) < len(model.faults):
        faults.append(f"{len(model.faults) - len(own)} more by injection, see faults.csv")
    page = model.folder / "README.md"
    table = Table(show_header=False, title=model.title)
    for key, value in (
        ("model", model.name),
        ("standard", model.standard),
        ("bus", ", ".join(model.buses)),
        ("axes", "1" if model.axes == 1 else f"{model.axes}, with consecutive node-ids"),
        ("identity", _identity(model)),
        ("modes", _modes(model)),
        ("homing methods", " ".join(map(str, model.homing_methods))),
        *((f"{n} cycle", f"{t * 1e6:g} µs") for n, t in model.cycle_time.items()),
        ("objects", str(len(model.objects))),
        *_changes(model),
        ("PDOs", f"{len(model.rpdos)} receive, {len(model.tpdos)} transmit"),
        ("faults", "\n".join(faults)),
        ("quirks", "\n".join(f"{n} = {q.value} ({q.source})" for n, q in model.quirks.items())),
    ):
        table.add_row(key, value or "none")
    console.print(table)
    if page.is_file():
        print(f"what is inferred, what is not supported: {page}")
    return 0
