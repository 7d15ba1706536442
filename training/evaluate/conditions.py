"""The tables of `servogym compare --conditions`, with a row for each off-nominal condition.

A table has a version: its rows never change, and a new table gets a new version. `CONDITIONS`
varies one disturbance at a time. `TRANSFER` combines each drive with each mechanics of the family:
undisturbed, with delay, and with noise. It shows how policies that were trained on one drive and
one mechanics behave there without change. Random draws of the task stay as they are, except for
the values that the condition sets. All policies play the same episodes in a condition; episodes may
differ between conditions. Policies know the data sheet of the machine they meet, and nothing about
the condition.
"""

import inspect
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from ...drive.model.model import load, model_names
from ...drive.model.names import hint
from ...envs import FAMILY
from ..setup import Setup

VERSION = "v1"
NOMINAL = "nominal"
NONE: Mapping[str, Any] = MappingProxyType({})


class Condition(NamedTuple):
    """A row of the table."""

    axis: str  # kind of disturbance
    value: float | str  # its value
    randomise: Mapping[str, Any] = NONE  # values or ranges that replace those of the task
    beyond: Mapping[str, float] = NONE  # values in shares of the upper end of the task's range
    arguments: Mapping[str, str] = MappingProxyType({})  # of the environment
    drive: str = ""

    @property
    def name(self) -> str:
        """Return the name, such as ``"delay=3"`` or ``"generic rigid: delay 1"``."""
        between = ": " if self.drive and self.arguments else "="
        return f"{self.axis}{between}{self.value}" if self.value != "" else self.axis


CONDITIONS = (
    Condition(NOMINAL, ""),
    *(Condition("delay", n, {"delay": float(n)}) for n in (1, 3, 5)),
    *(Condition("encoder_noise_um", n, {"encoder_noise": n * 1e-6}) for n in (1, 5)),
    *(Condition("friction", n, {"friction": n}) for n in (0.25, 3.0, 5.0)),
    *(Condition("payload_of_range", n, beyond={"payload": n}) for n in (1.25, 1.5)),
    *(Condition("stiffness_of_range", n, beyond={"stiffness": n}) for n in (0.2, 1.5)),
    *(Condition("gains", n, {"gains": n}) for n in (0.6, 0.8, 1.25, 1.5)),
    *(Condition("drive", name, drive=name) for name in model_names()),
    *(Condition("mechanics", name, arguments={"parameters": name}) for name in FAMILY),
)
DISTURBANCES: dict[str, Mapping[str, float]] = {  # of the table `TRANSFER`
    "": NONE, "delay 1": {"delay": 1.0}, "noise 5 µm": {"encoder_noise": 5e-6},
}
TRANSFER = tuple(
    Condition(
        f"{drive} {mechanics}", disturbance, drawn, arguments={"parameters": mechanics}, drive=drive
    )
    for disturbance, drawn in DISTURBANCES.items()
    for drive in model_names()
    for mechanics in FAMILY
)
TABLES = {"all": CONDITIONS, "transfer": TRANSFER}


def suiting(setup: Setup, table: Sequence[Condition] = CONDITIONS) -> Iterator[Condition]:
    """Return the rows that apply to a task and differ from its nominal condition."""
    env, kind = setup.make(), setup.task
    ranges, own = env.randomisation.ranges, inspect.signature(kind.__init__).parameters
    nominal = env.datasheet
    env.close()
    for row in table:
        known = not row.drive or {*kind.MODES} <= {*load(row.drive).modes}
        same = row.axis == "drive" and row.drive == setup.drive
        same |= row.axis == "mechanics" and FAMILY[str(row.value)] == nominal
        if (
            known
            and not same
            and row.beyond.keys() <= ranges.keys()
            and row.arguments.keys() <= own.keys()
        ):
            yield row


def chosen(rows: Sequence[Condition], names: str) -> list[Condition]:
    """Return the conditions in a comma-separated list of names or axes; "all" means every one.

    Raises ValueError for a name that is not in the table or does not suit the task.
    """
    if names in TABLES:
        return list(rows)
    picked: list[Condition] = []
    for name in filter(None, map(str.strip, names.split(","))):
        found = [row for row in rows if name in (row.name, row.axis)]
        if not found:
            known = [*dict.fromkeys(each for row in rows for each in (row.axis, row.name))]
            raise ValueError(f"--conditions: {name!r} is unknown here: {hint(name, known)}")
        picked += [row for row in found if row not in picked]
    if not picked:
        raise ValueError("--conditions is empty: give names, separated by commas, or leave it out")
    return picked


def applied(setup: Setup, row: Condition) -> Setup:
    """Return the setup in a condition."""
    drawn = {**setup.ranges, **row.randomise}
    drawn |= {name: share * setup.ranges[name][1] for name, share in row.beyond.items()}
    plain = {name: value for name, value in setup.arguments.items() if name != "randomise"}
    given = plain | dict(row.arguments) | {"randomise": drawn}
    return setup.having(given, row.drive)
