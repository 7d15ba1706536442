"""Fault injection of an environment: causes inside its drives, and faults of their bus."""

from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, NamedTuple

from ...drive.drive import Drive
from ...drive.model.names import hint

if TYPE_CHECKING:
    from ...drive.ethercat.faulty import Fault

Faults = Mapping[str, float] | Sequence["str | Fault"] | None  # the argument of an environment


class Injection(NamedTuple):
    """A cause of a fault that may be injected into a drive."""

    name: str  # in an info
    drive: Drive
    cause: str
    probability: float  # per step


def sort(faults: Faults) -> tuple[dict[str, float], list["Fault"]]:
    """Separate causes inside drives, with their probabilities, from faults of the bus.

    Raises ValueError for a line that is not a fault of the bus.
    """
    if not faults:
        return {}, []
    from ...drive.ethercat.faulty import KINDS, Fault

    if not isinstance(faults, Mapping):
        lines = [faults] if isinstance(faults, str) else faults
        if not isinstance(lines, Iterable):
            raise ValueError(f"faults = {faults!r}: give probabilities by name, or lines of a bus")
        return {}, [line if isinstance(line, Fault) else Fault.parse(line) for line in lines]
    causes, bus = {}, []
    for key, probability in faults.items():
        if not isinstance(key, str):
            raise ValueError(f"faults[{key!r}]: name a cause, as {{'encoder_loss': 1e-4}}")
        if next(iter(key.split()), "") in KINDS:
            again = "" if " count=" in key else " count=0"
            bus.append(Fault.parse(f"{key}{again} rate={probability}"))
        else:
            causes[key] = probability
    return causes, bus


def injections(
    causes: Mapping[str, float], machine: Mapping[str, Drive], drives: Sequence[Drive]
) -> list[Injection]:
    """Return the injections into the drives of the agent. Raises ValueError for unknown names."""
    own = {name: drive for name, drive in machine.items() if drive in drives}
    several = len(own) > 1
    rows = []
    for key, probability in causes.items():
        named, dot, cause = key.rpartition(".")
        if dot and named not in own:
            raise ValueError(f"faults[{key!r}]: there is no drive {named!r}: {hint(named, own)}")
        for name in [named] if dot else own:
            known = own[name].injectable
            if cause not in known:
                raise ValueError(
                    f"faults: unknown cause {cause!r}: {hint(cause, known)}; those of an "
                    "EtherCAT bus are listed in servogym.drive.ethercat.faulty"
                )
            label = f"{name}.{cause}" if several else cause
            rows.append(Injection(label, own[name], cause, probability))
        if not (isinstance(probability, Real) and 0.0 <= probability <= 1.0):
            raise ValueError(f"faults[{key!r}] = {probability!r} is out of range 0..1")
    return rows
