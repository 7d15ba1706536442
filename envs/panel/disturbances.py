"""What an experiment puts in a machine's way: causes of faults, and what ails its parts."""

import math
from collections.abc import Callable
from typing import NamedTuple

from ..engine.machine import Machine
from .session import Session


class Disturbance(NamedTuple):
    """Something with a size; 0 is none."""

    name: str
    unit: str  # people give it in
    scale: float  # of that unit in SI
    most: float  # in that unit
    read: Callable[[Session, int], float]
    write: Callable[[Session, int, float], None]


def _noise(session: Session, axis: int, value: float) -> None:
    coupling = session.machine.couplings[axis]
    coupling.noise = value
    if not coupling.noise_state:
        coupling.noise_state = 0x9E3779B97F4A7C15 + axis  # its generator is never at 0


def _friction(machine: Machine, axis: int) -> float:
    return float(machine.couplings["friction"][axis])


def _set_friction(session: Session, axis: int, value: float) -> None:
    session.machine.couplings["friction"][axis] = value


def _set_drag(session: Session, axis: int, value: float) -> None:
    session.machine.mechanics["chain_drag"][axis] = value


def _set_delay(session: Session, axis: int, value: float) -> None:
    session.delay = value


# "N" stands for N (slide) or Nm (hinge), "mm" for mm or mrad
DISTURBANCES = (
    Disturbance("Encoder noise", "µm", 1e-6, 1000, lambda s, i: float(
        s.machine.couplings["noise"][i]), _noise),
    Disturbance("Cable drag", "N", 1.0, 5000, lambda s, i: float(
        s.machine.mechanics["chain_drag"][i]), _set_drag),
    Disturbance("Friction", "N", 1.0, 5000, lambda s, i: _friction(s.machine, i), _set_friction),
    Disturbance("Delay of commands", "ms", 1e-3, 200, lambda s, i: s.delay, _set_delay),
)  # fmt: skip


def unit_at(session: Session, disturbance: Disturbance, axis: str) -> str:
    """The unit people give it in, for the joint of an axis."""
    turns = session.port.units(axis).name == "rad"
    return {"µm": "µrad", "N": "Nm"}.get(disturbance.unit, disturbance.unit) if turns else (
        disturbance.unit
    )  # fmt: skip


def disturb(session: Session, axis: str, disturbance: Disturbance, value: float) -> str:
    """Set one, in the unit people give it in; -> why it is refused."""
    if not (math.isfinite(value) and 0.0 <= value <= disturbance.most):
        return f"{value:g} is out of range 0..{disturbance.most:g} {disturbance.unit}"
    disturbance.write(session, session.axes.index(axis), value * disturbance.scale)
    return ""


def inject(session: Session, axis: str, cause: str) -> str:
    """Make a cause of a fault present; -> why it is refused."""
    try:
        session.machine.drives[axis].inject(cause)
    except ValueError as error:
        return str(error)
    session.tell("done", f"{axis}: {cause.replace('_', ' ')} injected")
    return ""


def clear(session: Session, axis: str) -> None:
    """Take all injected causes away."""
    session.machine.drives[axis].clear_injected()
    session.tell("done", f"{axis}: nothing is injected any more")
