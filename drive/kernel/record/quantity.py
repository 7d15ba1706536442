"""What a row of the table of quantities says, and how big the units are in which objects stand."""

import math
from enum import IntEnum
from typing import NamedTuple

RAD_S_PER_MINUTE = 2 * math.pi / 60


class Kind(IntEnum):
    """Units of the factor group; the first two change their sign with the polarity 607Eh."""

    POSITION = 0
    VELOCITY = 1
    WIDTH = 2  # a distance without direction
    SPEED = 3
    ACCELERATION = 4


class Quantity(NamedTuple):
    """A quantity of the object dictionary: one row of `variables.OBJECTS`.

    With `si` the control cycle works on it in SI. `factors` makes that from the object after any
    write, in the way `how` says:

    ==========  ==========================================================================
    (nothing)   number times unit
    rate        the same; 0, which only process data can bring, counts as one unit
    amount      the same without its sign
    limit       the same; 0 switches it off (inf)
    window      the same; the largest number switches it off (inf)
    cycles      ms as whole position cycles, rounded up
    lag         a time as the share of a new sample, per velocity cycle
    slow lag    the same, per position cycle
    shown       the other way: the object shows what the cycle has found, saturated
    ==========  ==========================================================================

    Without `si`, `factor` makes the units themselves, and `published` is written by a function of
    its own. All else in units of the factor group is a value a master has written: it keeps its
    meaning when the units change, see `factors.stored`.
    """

    field: str  # of `od`
    type: str | tuple[str, tuple[int, ...]]
    unit: str
    meaning: str
    si: str = ""  # field of the record; of an array one name, or one for each element
    how: str = ""

    @property
    def elements(self) -> int:
        """Number of elements of an array; 0 for a single value."""
        return self.type[1][0] if isinstance(self.type, tuple) else 0

    @property
    def code(self) -> str:
        """Type of a value, as NumPy writes it."""
        return self.type[0] if isinstance(self.type, tuple) else self.type

    @property
    def kind(self) -> Kind | None:
        """Which unit of the factor group it has, None for any other."""
        signed, unsigned = KINDS_OF_UNITS.get(self.unit, (None, None))
        return signed if "i" in self.code else unsigned

    @property
    def kept(self) -> bool:
        """Whether its value keeps its meaning when the units change."""
        return self.kind is not None and self.how not in ("shown", "published")

    @property
    def fields(self) -> tuple[tuple[str, str | tuple[str, tuple[int, ...]], str, str], ...]:
        """Rows of the record for its values in SI."""
        if not self.si or self.how == "shown":
            return ()
        names, unit = self.si.split(), SI_UNITS[self.unit]
        unit = {"cycles": "position cycle", "lag": "", "slow lag": ""}.get(self.how, unit)
        about = {"limit": "; inf = off", "window": "; inf = off"}.get(self.how, "")
        single = "i8" if self.how == "cycles" else "f8"
        kind = (single, (self.elements,)) if self.elements and len(names) == 1 else single
        meaning = f"{self.field}, {self.meaning}{about}"
        return tuple((name, kind, unit, meaning) for name in names)


KINDS_OF_UNITS = {  # unit -> of a signed type, of an unsigned one
    "position unit": (Kind.POSITION, Kind.WIDTH),
    "velocity unit": (Kind.VELOCITY, Kind.SPEED),
    "speed unit": (Kind.SPEED, Kind.SPEED),  # a velocity unit without direction
    "acceleration unit": (Kind.ACCELERATION, Kind.ACCELERATION),
    "jerk unit": (Kind.ACCELERATION, Kind.ACCELERATION),
}
# unit of an object -> its size in SI: a number, or where the record has it
SIZES: dict[str, float | str] = {
    "ms": 1e-3,
    "µs": 1e-6,
    "1/1000": 1e-3,
    "1/min": RAD_S_PER_MINUTE,
    "1/1000 1/min": 1e-3 * RAD_S_PER_MINUTE,
    "1e-9 kg·m²": 1e-9,
    "rated torque/1000": "axis.rated_torque * 1e-3",
    "rated torque/1000 per s": "axis.rated_torque * 1e-3",
    "µNm·s/rad": 1e-6,
    "position gain unit": "axis.position_gain_unit",  # as the model has it
    "velocity gain unit": "axis.velocity_gain_unit",
}
SI_UNITS = {
    "position unit": "rad", "velocity unit": "rad/s", "speed unit": "rad/s",
    "acceleration unit": "rad/s²", "jerk unit": "rad/s³", "ms": "s", "µs": "s", "1/1000": "",
    "1/min": "rad/s", "1/1000 1/min": "rad/s", "1e-9 kg·m²": "kg·m²", "rated torque/1000": "Nm",
    "rated torque/1000 per s": "Nm/s", "µNm·s/rad": "Nm·s/rad",
    "position gain unit": "1/s", "velocity gain unit": "Nm·s/rad",
}
