"""Commissions a drive in its own units and within its own ranges.

Values are given in units that suit the axis (1 µm, 1 µm/s, 1 µm/s²). A drive whose factor group
supports these units uses them. Any other drive gets the same motion in its own units, as close as
its objects allow.
"""

from collections.abc import Container, Mapping
from typing import Any

import numpy as np

from ...drive.drive import Drive
from ...drive.kernel.factors import units_changed
from ...drive.kernel.record import OD
from ...drive.model.model import load
from ...drive.model.rows import Object, quantity

SAME = 1e-9  # relative difference of units that are equal
INCREMENTS = 4  # of the encoder, the smallest position window
WINDOWS = (
    "following_error_window", "position_window", "velocity_window", "velocity_threshold",
)
# a limit of the drive -> the values that it limits
LIMITS = {
    "max_acceleration": ("profile_acceleration", "homing_acceleration"),
    "max_deceleration": ("profile_deceleration", "quick_stop_deceleration"),
}


def motor_and_factors(drive: Drive, values: Mapping[str, float]) -> None:
    """Set the motor data and the factor group, as far as they can be written.

    A factor that only the manufacturer can set stays unchanged, and so do its units.
    """
    names = drive.objects.names
    possible = {n: v for n, v in values.items() if n not in names or names[n].writable}
    drive.commission(
        {n: _inside(drive, names[n].row, v) if n in names else v for n, v in possible.items()}
    )


def commission(
    drive: Drive, values: Mapping[str, float], per_unit: float, exact: Container[str] = ()
) -> None:
    """Set objects by name.

    Args:
        drive: a drive whose factor group is set.
        values: values in units of `per_unit`, and per s and s².
        per_unit: one unit at the shaft (rad).
        exact: names of values that the drive refuses out of its range; other values are limited to
            the range.

    Raises:
        ValueError: as `Drive.commission`.
    """
    drive.commission(fitted(drive, values, per_unit, exact))


def fitted(
    drive: Drive, values: Mapping[str, float], per_unit: float, exact: Container[str] = ()
) -> dict[str, float]:
    """Convert values to the units and ranges of the drive; for arguments see `commission`."""
    units_changed(drive.axes, drive.index)
    axis = drive.axis
    own = {
        "position": abs(float(axis.rad_per_position_unit)),
        "velocity": abs(float(axis.rad_s_per_velocity_unit)),
        "acceleration": abs(float(axis.rad_s2_per_acceleration_unit)),
    }
    scale = {what: per_unit / unit if unit else 1.0 for what, unit in own.items()}
    scale = {what: 1.0 if abs(ratio - 1.0) < SAME else ratio for what, ratio in scale.items()}
    increment = float(axis.rad_per_increment)
    smallest = {
        "position": max(INCREMENTS * increment / own["position"], 1.0),
        "velocity": max(increment / float(axis.velocity_period) / own["velocity"], 1.0),
    }
    found = {}
    for name, value in values.items():
        what = _quantity(name)
        value = value * scale.get(what, 1.0)
        if name in WINDOWS:
            value = max(value, smallest[what])
        row = drive.model.names.get(name)
        if name in exact:
            found[name] = value
            continue
        found[name] = _in_field(name, value) if row is None else _inside(drive, row, value)
    for name, held in LIMITS.items():  # the default may be lower than the axis needs
        row = drive.model.names.get(name)
        needed = max((found[one] for one in held if one in found), default=0.0)
        if row is not None and name not in found and needed > drive.read(name):  # type: ignore
            found[name] = _inside(drive, row, needed)
    return found


def _in_field(name: str, value: float) -> float:
    """The nearest value that a field of the record can hold, for a field without an object."""
    kind: Any = OD[name].base if name in (OD.names or ()) else np.dtype(float)
    if kind.kind == "f":
        return value
    return min(max(value, float(np.iinfo(kind).min)), float(np.iinfo(kind).max))


def _quantity(name: str) -> str:
    """Quantity of an object of the profile in units of the factor group; "" for any other."""
    row = load("generic").names.get(name)
    if row is None:
        return ""
    return "acceleration" if row.unit == "jerk unit" else quantity(row.unit)


def _inside(drive: Drive, row: Object, value: float) -> float:
    """The nearest value that an object accepts."""
    if row.name == "homing_method" and drive.model.homing_methods:
        possible = value in drive.model.homing_methods
        possible = possible and row.minimum <= value <= row.maximum
        return value if possible else _homing_method(drive, row)
    if not row.format:
        return value
    if row.allowed is not None:
        return min(row.allowed, key=lambda one: abs(one - value))
    return min(max(value, row.minimum), row.maximum)


def _homing_method(drive: Drive, row: Object) -> float:
    """A method of the drive: the one that homes at the present position, or the first one."""
    methods = drive.model.homing_methods
    here = [m for m in (37, 35) if m in methods] + [*methods]
    return next((m for m in here if row.minimum <= m <= row.maximum), float(row.default))
