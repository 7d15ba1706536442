"""Set-points of torque, velocity and position for drives of a bench, once or as a wave."""

import math
from typing import Any

from ...drive.diagrams import Mode, State
from ...drive.master import Refused
from .generator import KINDS, AxisLimits, Wave, travel


class SetPoints:
    """Hands set-points to the drives of a `bench.Bench`, within their limits.

    Sizes are in m or rad for a position, m/s or rad/s for a velocity, and % of the rated torque.
    """

    def __init__(self, bench: Any):
        self.bench = bench

    def most(self, axis: str) -> AxisLimits:
        """Speed and acceleration of the profile, 6081h and 6083h (SI at the load)."""
        bench = self.bench
        speed = float(bench.value(axis, "profile_velocity") or 0) * bench.units(axis).velocity
        rate = float(bench.value(axis, "profile_acceleration") or 0) * bench.acceleration(axis)
        return AxisLimits(speed, rate)

    def set(self, axis: str, kind: str, value: float) -> str:
        """Send a set-point; -> the reason of a refusal.

        Args:
            axis: the axis that follows it.
            kind: key of `generator.KINDS`.
            value: final value; a position is approached with 6081h and 6083h.
        """

        def motion() -> None:
            master = self.bench.masters[axis]
            raw = self._raw(axis, kind, value)
            if kind != "position":
                master.follow(self._mode_of(axis, kind))
                master.write(KINDS[kind].name, raw)
                return
            begin = master.position
            self._inside(axis, value)
            wave, total = travel(value - begin, self._streamed(axis))
            self._stream(axis, kind, lambda time: begin + wave(time), total)

        what = f"{axis}: {kind} set-point {self._shown(axis, kind, value)}"
        return self.bench.run(what, motion, axis, goes_on=kind != "position" and value != 0.0)

    def generate(
        self, axis: str, kind: str, shape: str, size: float, frequency: float, time: float
    ) -> str:
        """Let set-points follow a wave for some time, then stop; -> the reason of a refusal.

        Args:
            axis: the axis that follows it.
            kind: key of `generator.KINDS`.
            shape: one of the shapes of this kind.
            size: travel of a position, counted from the present one; else the peak.
            frequency: (Hz)
            time: duration (s).
        """

        def motion() -> None:
            if not (frequency > 0 and time > 0 and math.isfinite(frequency + time + size)):
                raise Refused("generator", "frequency and time are more than 0")
            begin = self.bench.masters[axis].position if kind == "position" else 0.0
            if kind == "position":
                self._inside(axis, begin + size)
            self._raw(axis, kind, size)
            wave = KINDS[kind].wave(shape, size, frequency, self._streamed(axis))
            whole = math.ceil(time * frequency - 1e-9) / frequency  # it ends where it has begun
            self._stream(axis, kind, lambda now: begin + wave(now), whole)
            self.bench.masters[axis].stop()

        return self.bench.run(f"{axis}: {kind} {shape}, {frequency:g} Hz", motion, axis)

    def _unit(self, axis: str, kind: str) -> float:
        """The size of a drive unit."""
        units = self.bench.units(axis)
        return {"position": units.position, "velocity": units.velocity, "torque": 0.1}[kind]

    def _shown(self, axis: str, kind: str, value: float) -> str:
        name, scale = self.bench.unit(axis)
        number, unit = {"position": (value * scale, name), "velocity": (value * scale, f"{name}/s"),
                        "torque": (value, "%")}[kind]
        return f"{number:g} {unit}"

    def _streamed(self, axis: str) -> AxisLimits:
        """The limits of a streamed set-point. Raises Refused if it cannot be streamed."""
        if self.bench.real_time:
            raise Refused("set-points", "the panel does not reach a node on a bus in each cycle",
                          "use Move, or a master with PDOs and SYNC")
        most = self.most(axis)
        if min(most) <= 0:
            raise Refused("set-points", "6081h or 6083h is 0", "write how fast it may be")
        return most

    def _mode_of(self, axis: str, kind: str) -> Mode:
        model = self.bench.model(axis)
        mode = next((mode for mode in KINDS[kind].modes if mode in model.modes), None)
        if mode is None:
            raise Refused(f"{kind} set-points", f"drive {model.name} has no mode for them")
        return mode

    def _raw(self, axis: str, kind: str, value: float) -> int:
        """Convert a set-point to drive units. Raises Refused beyond 6072h or 6081h."""
        limit, name = None, ""
        if kind == "torque" and (torque := self.bench.value(axis, "max_torque")) is not None:
            limit, name = torque * self._unit(axis, kind), "6072h"
        elif kind == "velocity":
            limit, name = self.most(axis).velocity or None, "6081h"
        if limit is not None and abs(value) > limit * (1 + 1e-9):
            given, allowed = (self._shown(axis, kind, each) for each in (value, limit))
            raise Refused(kind, f"{given} is more than {name} allows, {allowed}",
                          f"choose less, or raise {name}")
        return round(value / self._unit(axis, kind))

    def _inside(self, axis: str, target: float) -> None:
        """Raise Refused for a position beyond the software limits 607Dh."""
        low, high = (self.bench.value(axis, f"{end}_position_limit") for end in ("min", "max"))
        unit = self._unit(axis, "position")
        if low is None or high is None or not low < high or low <= round(target / unit) <= high:
            return
        shown = [self._shown(axis, "position", each) for each in (target, low * unit, high * unit)]
        raise Refused("position", f"{shown[0]} is beyond the stroke {shown[1]}..{shown[2]}",
                      "choose a target inside")

    def _stream(self, axis: str, kind: str, wave: Wave, time: float) -> None:
        """Follow a wave with a set-point in each exchange."""
        master, name, unit = self.bench.masters[axis], KINDS[kind].name, self._unit(axis, kind)
        master.follow(self._mode_of(axis, kind))
        begin = master.port.now()
        self.bench.streams = kind == "position"
        try:
            while (now := master.port.now() - begin) < time:
                master.write(name, round(wave(now) / unit))
                if master.state is not State.OPERATION_ENABLED:
                    master.follow(self._mode_of(axis, kind))  # raises the reason
        finally:
            self.bench.streams = False
        if kind == "position":
            master.write(name, round(wave(time) / unit))
