"""The guard in front of a drive on a bus, which no policy can bypass.

It checks each command before it is sent and each answer when it arrives. A value outside the
envelope raises `Stopped` with the name of the limit; the line then sends a quick stop and nothing
else. The guard is not a safety function, because it runs on the same computer as the policy. What
protects people belongs to the machine, such as STO (IEC 61800-5-2).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from ..engine.checks import in_range

# Commands must not exceed the velocity itself. An axis may, as it catches up with a late set-point.
# A drive's own overspeed protection has the same margin (`drive.kernel.monitor`).
MARGIN = 1.2
FAULT = 0x0008  # statusword
OPERATION_ENABLED, STATE = 0x0027, 0x006F


class Stopped(RuntimeError):
    """The guard has stopped the drives; `reason` names the limit, `axis` the drive."""

    def __init__(self, axis: str, reason: str):
        reason = " ".join(reason.split())  # an action it quotes may have several lines
        super().__init__(f"{axis}: {reason}" if axis else reason)
        self.axis, self.reason = axis, reason


@dataclass(frozen=True)
class Envelope:
    """Limits of one drive, at the load: m or rad, s, and shares of the rated torque.

    Args:
        low, high: positions.
        velocity: of set-points and of the axis.
        acceleration: of set-points, from one step to the next.
        jerk: of set-points, over three steps.
        torque: of target torque, torque offset and torque limit.
        following_error: of the axis.
        following_error_time: how long the axis may exceed the following error (s).
    """

    low: float
    high: float
    velocity: float
    acceleration: float = math.inf
    jerk: float = math.inf
    torque: float = math.inf
    following_error: float = math.inf
    following_error_time: float = 0.0

    def __post_init__(self) -> None:
        if not self.low < self.high or not math.isfinite(self.high - self.low):
            raise ValueError(
                f"positions {self.low!r}..{self.high!r} limit nothing: set the software position "
                "limits of the drive (607Dh), or give limits (--limits)"
            )
        if not 0.0 < self.velocity < math.inf:
            raise ValueError(
                f"velocity {self.velocity!r} limits nothing: set the maximum profile velocity of "
                "the drive (607Fh) or its maximum motor speed (6080h), or give a maximum velocity "
                "(--max-velocity)"
            )
        for field in fields(self)[3:-1]:
            in_range(field.name, getattr(self, field.name), 1e-12, math.inf)
        in_range("following_error_time", self.following_error_time, 0.0, 60.0, "s")


class Guard:
    """Checks the commands to one drive and its answers.

    Args:
        axis: name of the drive.
        envelope: its limits.
        period: of the steps (s).
        position, speed: size of a position and a velocity unit at the load (m or rad, per s).

    Set-points are whole units, so their differences may exceed a limit by the rounding error.
    """

    def __init__(self, axis: str, envelope: Envelope, period: float, position: float, speed: float):
        self.axis, self.envelope, self.period = axis, envelope, period
        self._position, self._speed = position, speed
        self.begin(0.0)

    def begin(self, position: float) -> None:
        """Begin an episode at rest at a position (m or rad)."""
        self._at = position
        self._set_point, self._velocity, self._acceleration = position, 0.0, 0.0
        self._beyond = 0.0  # s for which the following error has been outside its window

    def command(self, values: Mapping[str, float]) -> None:
        """Check a command (drive units by object) before it is sent. Raises Stopped."""
        limits = self.envelope
        for name, value in values.items():
            if not math.isfinite(value):
                raise self._stop(f"{name} = {value} is not a number")
        if "target_position" in values and "target_velocity" not in values:
            set_point = values["target_position"] * self._position
            self._within("set-point", set_point)
            velocity = (set_point - self._set_point) / self.period
            step = f"the set-point steps by {set_point - self._set_point:.4g}"
            self._moves(velocity, self._position / self.period, step)
            self._set_point = set_point
        elif "target_velocity" in values:
            velocity = values["target_velocity"] * self._speed
            self._moves(velocity, self._speed, f"target velocity {velocity:.4g}")
            if math.isfinite(limits.acceleration):
                way = velocity * abs(velocity) / (2.0 * limits.acceleration)
                self._within("the place where it could stop", self._at + way)
        for name in ("target_torque", "torque_offset", "max_torque"):
            torque = 1e-3 * values.get(name, 0.0)
            if abs(torque) > limits.torque:
                raise self._stop(
                    f"{name} = {torque:.3g} of the rated torque, limit {limits.torque:.3g}"
                )

    def answer(self, values: Mapping[str, float]) -> None:
        """Check an answer (drive units by object). Raises Stopped."""
        limits, word = self.envelope, int(values["statusword"])
        if word & FAULT:
            raise self._stop("the drive is in a fault")
        self._at = values["position_actual_value"] * self._position
        self._within("position", self._at)
        velocity = values.get("velocity_actual_value", 0.0) * self._speed
        if abs(velocity) > MARGIN * limits.velocity:
            raise self._stop(f"velocity {velocity:.4g}, limit {limits.velocity:.4g}")
        error = values.get("following_error_actual_value", 0.0) * self._position
        beyond = abs(error) > limits.following_error
        self._beyond = self._beyond + self.period if beyond else 0.0
        if beyond and self._beyond >= limits.following_error_time:
            duration = f", for {self._beyond:.3g} s" if limits.following_error_time else ""
            raise self._stop(
                f"following error {error:.4g}, limit {limits.following_error:.4g}{duration}"
            )

    def _within(self, what: str, position: float) -> None:
        low, high = self.envelope.low, self.envelope.high
        if not low <= position <= high:
            raise self._stop(f"{what} {position:.4g} is out of {low:.4g}..{high:.4g}")

    def _moves(self, velocity: float, unit: float, what: str) -> None:
        """Check a velocity of set-points, with the resolution `unit`, and its differences."""
        limits = self.envelope
        acceleration = (velocity - self._velocity) / self.period
        jerk = (acceleration - self._acceleration) / self.period
        for name, value, limit, rounding in (
            ("velocity", velocity, limits.velocity, unit),
            ("acceleration", acceleration, limits.acceleration, 2.0 * unit / self.period),
            ("jerk", jerk, limits.jerk, 4.0 * unit / self.period**2),
        ):
            if abs(value) > limit * (1.0 + 1e-6) + rounding:
                raise self._stop(f"{what}: {name} {abs(value):.4g}, limit {limit:.4g}")
        self._velocity, self._acceleration = velocity, acceleration

    def _stop(self, reason: str) -> Stopped:
        return Stopped(self.axis, reason)
