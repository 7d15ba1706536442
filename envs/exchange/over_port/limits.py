"""The limits of the guard: those that are given, and those of the drive itself."""

import math
from collections.abc import Collection
from contextlib import suppress

from ....drive.master.port import Port
from ....drive.objects.abort import SdoAbort
from ...engine.machine import Machine
from ..envelope import Envelope
from .side import Limits

NO_LIMIT = 4294967295  # of an UNSIGNED32, such as 607Fh or 60C5h
OPEN = -(2**31), 2**31 - 1  # of 607Dh: a drive without position limits (CiA 402-2)
REVERSALS = 5.0  # set-points may have this multiple of the quick-stop deceleration (inferred)
BEYOND_STOPS = 0.01  # m or rad by which an axis may be pressed into its end stops
GUARDED = {  # objects an agent may command on a bus: the guard checks these
    "controlword", "modes_of_operation", "target_position", "target_velocity", "target_torque",
    "torque_offset", "max_torque",
}


def check_guarded(names: Collection[str]) -> None:
    """Raise ValueError if an agent commands an object that the guard does not check."""
    for name in sorted({*names} - GUARDED):
        raise ValueError(
            f"RPDO has {name}, which the guard does not check: on a bus an agent may command "
            f"{', '.join(sorted(GUARDED))}"
        )
    if {"target_position", "target_velocity"} <= {*names}:
        raise ValueError(
            "RPDO has target_position and target_velocity: the guard follows one of them, leave "
            "the other out"
        )


def envelope(
    axis: str, given: Limits, port: Port, machine: Machine, *,
    units: float, period: float, referenced: bool,
) -> Envelope:
    """Return the limits given for a drive, completed with its own.

    Args:
        axis: name of the drive.
        given: limits by drive.
        port: of the drives.
        machine: of the environment.
        units: position units per m or rad.
        period: of the agent's steps (s).
        referenced: whether the drive has a reference at the beginning of an episode.

    Raises:
        ValueError: neither has limits of position or velocity.
    """
    limits = given.get(axis, {})
    if isinstance(limits, Envelope):
        return limits
    try:
        return Envelope(**{**_of_drive(axis, port, machine, units, period, referenced), **limits})
    except ValueError as error:
        raise ValueError(f"{axis}: {error}") from None


def _of_drive(
    axis: str, port: Port, machine: Machine, units: float, period: float, referenced: bool
) -> dict[str, float]:
    """Return the limits that a drive has: positions, velocity, torque, following error.

    Set-points may accelerate as 60C5h and 60C6h permit or, where these set no limit, several times
    as fast as the quick stop. The jerk limit is a full reversal of that within one step.
    """
    unit, n = 1.0 / units, [*machine.drives].index(axis)

    def read(name: str, otherwise: float = math.inf) -> float:
        with suppress(SdoAbort, ValueError):
            value = port.upload(axis, name)
            return value if value < NO_LIMIT else otherwise
        return otherwise

    most = max(read("max_acceleration"), read("max_deceleration"))
    if not most < math.inf:
        most = REVERSALS * read("quick_stop_deceleration")
    acceleration = most * unit
    low, high = (read(f"{end}_position_limit") * unit for end in ("min", "max"))
    if not referenced:
        stops = machine.mechanics[n]
        low, high = float(stops["low"]) - BEYOND_STOPS, float(stops["high"]) + BEYOND_STOPS
    elif {low, high} & {OPEN[0] * unit, OPEN[1] * unit}:
        low, high = -math.inf, math.inf
    speed = read("max_motor_speed") * math.tau / 60.0 / abs(machine.couplings[n].gear)
    return {
        "low": low, "high": high,
        "velocity": min(read("max_profile_velocity") * unit, speed),
        "acceleration": acceleration, "jerk": 2.0 * acceleration / period,
        "torque": 1e-3 * read("max_torque"),
        "following_error": read("following_error_window") * unit,
        "following_error_time": 1e-3 * read("following_error_time_out", 0.0),
    }
