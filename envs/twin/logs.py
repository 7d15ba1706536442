"""Reads the logs of one axis into experiments."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...drive.drive import Drive
from ...drive.kernel.record import AXIS, OD
from ...drive.model.model import DriveModel
from ...drive.wire.recording import Signal, Source
from ..engine.machine import Machine
from .experiment import Experiment, Unusable, experiment, spans

NEEDED = ("position_actual_value",)


def read(
    logs: Sequence[str | Path], machine: Machine, drive: str | DriveModel, name: str, *,
    sender: str | None = None, columns: str | None = None, mode: int | None = None,
    torque_constant: float | None = None, cycle: float | None = None, hold: bool = False,
) -> list[Experiment]:
    """Read the logs into experiments, in their order.

    Args:
        logs: files: candump, asc, blf, pcapng, CSV.
        machine: machine commissioned as the logged one.
        drive: its model, which defines the objects of a CAN log.
        name: name of the drive in the machine.
        sender: node or slave of the log; by default the only one with a position.
        columns: columns of a CSV, see `Source`.
        mode: mode of operation, if the log does not contain it.
        torque_constant: Nm/A, if a table contains the current in A.
        cycle: bus cycle of the master (s), if a table was sampled less often.
        hold: set-points of such a table are steps.

    Raises:
        Unusable: a log is unsuitable; the message says how to record a better one.
        ValueError: a file is damaged.
    """
    found = []
    for log in map(Path, logs):
        source = Source(log, drive, columns)
        having = [each for each, units in source.units.items() if NEEDED[0] in units]
        if not having:
            raise Unusable(
                f"{log}: no position in it: map position_actual_value (6064h) into a TPDO and "
                "record again, with the SDOs that map it (of another drive model they mean "
                "something else: --drive), or say --columns of a CSV"
            )
        if sender is None and len(having) > 1:
            raise Unusable(
                f"{log}: {len(having)} axes are in it ({', '.join(having)}): say which one is "
                "meant with --axis"
            )
        signals = _by_variable(source.signals(source.drive(sender, NEEDED)), machine.drives[name])
        found += _parts(
            signals, machine, name, log=log.name, mode=mode, torque_constant=torque_constant,
            cycle=cycle, hold=hold,
        )
    cycles = {each.period for each in found}
    if len(cycles) > 1:
        raise Unusable(f"logs of different bus cycles ({cycles} s): make a twin of each")
    return found


def _parts(signals: Mapping[str, Signal], machine: Machine, name: str, **more: Any) -> list[
        Experiment]:
    """Return an experiment for each usable part of a log."""
    parts: list[Experiment] = []
    said: Unusable | None = None
    several = spans(signals, more["log"])
    for span in several:
        try:
            parts.append(experiment(signals, machine, name, span=span, **more))
        except Unusable as error:
            said = said or error
    if said is not None and not parts:
        raise said
    return parts


def _by_variable(signals: Mapping[str, Signal], drive: Drive) -> dict[str, Signal]:
    """Name signals by the variables of the drive, where an object has another name."""
    start = int(AXIS.fields["od"][1])  # type: ignore[index]
    names = {
        start + int(place[1]): name
        for name, place in (OD.fields or {}).items() if not place[0].shape
    }
    variable = {
        row.name: names.get(row.offset, row.name)
        for row in drive.model.objects.values() if row.area == "axis"
    }
    return {variable.get(name, name): signal for name, signal in signals.items()}
