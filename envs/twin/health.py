"""Finds the changes of a machine since its twin was made, from a new log of its moves."""

import math
from dataclasses import dataclass
from typing import Any

from ..plants.twins import Twin
from .fit import Fitted

ABSOLUTE = ("load_force", "backlash")  # changes are given in the unit of the parameter
ALARM = 2.0  # half widths of a 95 % interval; 1 of 2,500 unchanged parameters exceeds it (t, 23)
WATCHED = (  # in the order of the report
    "coulomb_friction", "viscous_friction", "load_force", "payload", "inertia", "rotor_inertia",
    "load_stiffness",
    "transmission_stiffness", "load_damping", "transmission_damping", "backlash",
)


@dataclass(frozen=True)
class Change:
    """Change of one parameter: percent of its old value, or its unit if that was near zero."""

    name: str
    before: float
    now: float
    change: float
    low: float
    high: float
    unit: str  # "%" or that of the parameter
    known: bool = True  # the old twin determined it; otherwise it is that of the preset

    @property
    def certain(self) -> bool:
        """Whether zero is twice as far away as the 95 % interval reaches.

        Of many logs with several parameters each, some intervals exclude zero by chance.
        """
        return self.known and bool(abs(self.change) > ALARM * (self.high - self.low) / 2)

    def __str__(self) -> str:
        name = self.name.replace("_", " ")
        scale, unit = (1e6, "µm") if self.unit == "m" else (1.0, self.unit)
        low, high = scale * self.low, scale * self.high
        numbers = f"{scale * self.change:+.3g} {unit} [{low:+.3g}, {high:+.3g}]"
        if not self.known:
            return (f"{name} {numbers} relative to its preset, which the old twin uses: a change "
                    f"cannot be determined (--free {self.name})")
        return f"{name} {numbers}" + ("" if self.certain else ": no change is certain")


def changes(twin: Twin, now: Fitted) -> list[Change]:
    """Compare the parameters that both twins have; the certain changes come first.

    Raises:
        ValueError: the new log is of another family.
    """
    found = []
    for name in WATCHED:
        old = twin.parameters.get(name)
        if old is None or name not in {free.name for free in now.estimate.free}:
            continue
        low, high = now.estimate.interval(name)
        value = now.values[name]
        half = math.hypot((old.high - old.low) / 2, (high - low) / 2)
        relative = abs(old.value) > 2 * (old.high - old.low) and name not in ABSOLUTE
        per = 100.0 / old.value if relative else 1.0
        change = (value - old.value) * per
        half *= abs(per)
        unit = "%" if relative else old.unit
        low, high, known = change - half, change + half, old.low < old.high
        found.append(Change(name, old.value, value, change, low, high, unit, known))
    if not found:
        raise ValueError("the new log was fitted as another family: nothing can be compared")
    return sorted(found, key=lambda each: not each.certain)


def table(found: list[Change]) -> list[dict[str, Any]]:
    """Return the changes as rows of numbers, for JSON."""
    return [
        {"name": c.name, "before": c.before, "now": c.now, "change": c.change, "low": c.low,
         "high": c.high, "unit": c.unit, "known": c.known, "certain": c.certain}
        for c in found
    ]
