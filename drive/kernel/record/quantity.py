"""The columns of the table of quantities, and the size of the units of objects."""

import math
from enum import IntEnum
from typing import NamedTuple

RAD_S_PER_MINUTE = 2 * math.pi / 60


class Kind(IntEnum):
    """Kinds of units of the factor group; polarity 607Eh changes the sign of the first two."""

    POSITION = 0
    VELOCITY = 1
    WIDTH = 2  # a distance without direction
    SPEED = 3
    ACCELERATION = 4


class Quantity(NamedTuple):
    """A quantity of the object dictionary: one row of `variables.OBJECTS`.

    If it has `si`, the control cycle works on that field in SI units. `factors` computes the field
    after any write of the object, as `how` states:

    ==========  ==========================================================================
    (nothing)   number times unit
    rate        number times unit; 0, which only process data can bring, counts as one unit
    amount      the magnitude of number times unit
    limit       number times unit; 0 switches the limit off (inf)
    window      number times unit; the largest number switches the window off (inf)
    cycles      ms as whole position cycles, rounded up
    lag         a time constant as the weight of a new sample, per velocity cycle
    slow lag    a time constant as the weight of a new sample, per position cycle
    shown       the reverse: the object shows the field of the cycle, saturated
    ==========  ==========================================================================

    Without `si`, a `factor` defines the units themselves, and a `published` object is written by a
    function of its own. Any other object in units of the factor group holds a value that a master
    has written; it keeps its meaning when the units change, see `factors.stored`.
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
        """NumPy type code of a value."""
        return self.type[0] if isinstance(self.type, tuple) else self.type

    @property
    def kind(self) -> Kind | None:
        """Kind of its unit in the factor group, None for any other unit."""
        signed, unsigned = KINDS_OF_UNITS.get(self.unit, (None, None))
        return signed if "i" in self.code else unsigned

    @property
    def kept(self) -> bool:
        """Whether its value keeps its meaning when the units change."""
        return self.kind is not None and self.how not in ("shown", "published")

    @property
    def fields(self) -> tuple[tuple[str, str | tuple[str, tuple[int, ...]], str, str], ...]:
        """Rows of the record for its values in SI units."""
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
# unit of an object -> its size in SI: a number, or an expression of the record
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
    "position gain unit": "axis.position_gain_unit",  # fixed by the model
    "velocity gain unit": "axis.velocity_gain_unit",
}
SI_UNITS = {
    "position unit": "rad", "velocity unit": "rad/s", "speed unit": "rad/s",
    "acceleration unit": "rad/s²", "jerk unit": "rad/s³", "ms": "s", "µs": "s", "1/1000": "",
    "1/min": "rad/s", "1/1000 1/min": "rad/s", "1e-9 kg·m²": "kg·m²", "rated torque/1000": "Nm",
    "rated torque/1000 per s": "Nm/s", "µNm·s/rad": "Nm·s/rad",
    "position gain unit": "1/s", "velocity gain unit": "Nm·s/rad",
}
