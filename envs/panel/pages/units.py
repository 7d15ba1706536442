"""Physical units of objects in drive units."""

from ....drive.model.rows import Object, quantity
from ..bench import Bench


def physical(bench: Bench, axis: str, row: Object) -> tuple[float, str]:
    """Factor from drive units to a physical unit, and that unit; the factor is 0 if unknown."""
    unit, scale = bench.unit(axis)
    units = bench.units(axis)
    if unit == "units":
        return 0.0, ""
    known = {
        "position": (units.position * scale, unit),
        "velocity": (units.velocity * scale, f"{unit}/s"),
        "acceleration": (bench.acceleration(axis) * scale, f"{unit}/s²"),
        "torque": (0.1, "% rated"),
    }
    return known.get(quantity(row.unit), (0.0, ""))
