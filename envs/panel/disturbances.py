"""Disturbances for experiments: causes of faults, and defects of the machine's parts."""

import math
from collections.abc import Callable
from typing import NamedTuple

from .session import Session


class Disturbance(NamedTuple):
    """A disturbance with a size; 0 means none."""

    name: str
    unit: str  # in which it is entered
    scale: float  # of that unit in SI
    most: float  # in that unit
    read: Callable[[Session, int], float]
    part: str = ""  # key of `course.exercise.DISTURBANCES`; empty for the delay of commands


def _mechanics(name: str) -> Callable[[Session, int], float]:
    return lambda session, axis: float(session.machine.mechanics[name][axis])


def _coupling(name: str) -> Callable[[Session, int], float]:
    return lambda session, axis: float(session.machine.couplings[name][axis])


# "N" stands for N (slide) or Nm (hinge), "mm" for mm or mrad
DISTURBANCES = (
    Disturbance("Encoder noise", "µm", 1e-6, 1000, _coupling("noise"), "encoder_noise"),
    Disturbance("Cable drag", "N", 1.0, 5000, _mechanics("chain_drag"), "cable_drag"),
    Disturbance("Friction", "N", 1.0, 5000, _coupling("friction"), "friction"),
    Disturbance("Delay of commands", "ms", 1e-3, 200, lambda s, i: s.delay),
)


def unit_at(session: Session, disturbance: Disturbance, axis: str) -> str:
    """The unit of a disturbance for the joint of an axis."""
    turns = session.port.units(axis).name == "rad"
    return {"µm": "µrad", "N": "Nm"}.get(disturbance.unit, disturbance.unit) if turns else (
        disturbance.unit
    )


def disturb(session: Session, axis: str, disturbance: Disturbance, value: float) -> str:
    """Set a disturbance in its display unit; -> the reason of a refusal."""
    if not (math.isfinite(value) and 0.0 <= value <= disturbance.most):
        return f"{value:g} is out of range 0..{disturbance.most:g} {disturbance.unit}"
    if why := session.examined():
        return why
    if disturbance.part:
        session.act("ail", axis, disturbance.part, value * disturbance.scale)
    else:
        session.delay = value * disturbance.scale
    return ""


def inject(session: Session, axis: str, cause: str) -> str:
    """Inject the cause of a fault; -> the reason of a refusal."""
    if why := session.examined():
        return why
    try:
        session.act("inject", axis, cause)
    except ValueError as error:
        return str(error)
    session.tell("done", f"{axis}: {cause.replace('_', ' ')} injected")
    return ""


def clear(session: Session, axis: str) -> None:
    """Remove all injected causes."""
    session.act("clear", axis)
    session.tell("done", f"{axis}: nothing is injected any more")
