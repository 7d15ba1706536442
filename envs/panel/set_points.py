"""Set-points of torque, velocity and position for drives of a bench, once or as a wave."""

import math
from typing import Any

from ...drive.diagrams import Mode, State
from ...drive.master import Refused
from .generator import KINDS, WAVES, AxisLimits, Wave, travel


class SetPoints:
    """Hands set-points to the drives of a `bench.Bench`, within their limits."""

    def __init__(self, bench: Any):
        self.bench = bench

    def most(self, axis: str) -> AxisLimits:
        """Speed and acceleration of the profile, 6081h and 6083h (SI at the load)."""
        bench = self.bench
        speed = float(bench.value(axis, "profile_velocity") or 0) * bench.units(axis).velocity
        rate = float(bench.value(axis, "profile_acceleration") or 0) * bench.acceleration(axis)
        return AxisLimits(speed, rate)

    def set(self, axis: str, kind: str, value: float) -> str:
        """Send a set-point of a kind (`generator.KINDS`); -> the reason of a refusal.

        Args:
            axis: that follows it.
            kind: position (m or rad), velocity (m/s or rad/s), torque (% of the rated torque).
            value: at last; a position is approached with 6081h and 6083h.
        """
        name, scale = self.bench.unit(axis)
        said = {"position": f"{value * scale:g} {name}", "velocity": f"{value * scale:g} {name}/s",
                "torque": f"{value:g} %"}[kind]
        what = f"{axis}: {kind} set-point {said}"

        def motion() -> None:
            master = self.bench.masters[axis]
            if kind != "position":
                raw = self._raw(axis, kind, value)
                master.follow(self._mode_of(axis, kind))
                master.write(KINDS[kind].name, raw)
                return
            begin = master.position
            self._inside(axis, value)
            wave, total = travel(value - begin, self._streamed(axis))
            self._stream(axis, kind, lambda time: begin + wave(time), total)

        return self.bench.run(what, motion, axis, goes_on=kind != "position" and value != 0.0)

    def generate(
        self, axis: str, kind: str, shape: str, size: float, frequency: float, time: float
    ) -> str:
        """Let set-points follow a wave for `time` (s), then stop; -> the reason of a refusal.

        Args:
            axis: that follows it.
            kind: as `set_point` has it; a position counts from the present one.
            shape: of `generator.KINDS`.
            size: of the wave: the way of a position, the peak of a velocity or torque.
            frequency: (Hz)
            time: how long (s).
        """

        def motion() -> None:
            if not (frequency > 0 and time > 0 and math.isfinite(frequency + time + size)):
                raise Refused("generator", "frequency and time are more than 0")
            begin = self.bench.masters[axis].position if kind == "position" else 0.0
            if kind == "position":
                self._inside(axis, begin + size)
            self._raw(axis, kind, size)
            wave = WAVES[kind](shape, size, frequency, self._streamed(axis))
            whole = math.ceil(time * frequency - 1e-9) / frequency  # it ends where it has begun
            self._stream(axis, kind, lambda now: begin + wave(now), whole)
            self.bench.masters[axis].stop()

        return self.bench.run(f"{axis}: {kind} {shape}, {frequency:g} Hz", motion, axis)

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
        modes = self.bench.model(axis).modes
        found = next((mode for mode in KINDS[kind].modes if mode in modes), None)
        if found is None:
            raise Refused(
                f"{kind} set-points", f"drive {self.bench.model(axis).name} has no mode for them"
            )
        return found

    def _raw(self, axis: str, kind: str, value: float) -> int:
        """Convert a set-point to drive units. Raises Refused beyond the limits of the drive."""
        units = self.bench.units(axis)
        if kind == "torque":
            most = self.bench.value(axis, "max_torque")
            if most is not None and abs(value) * 10 > most:
                raise Refused("torque", f"{value:g} % is more than 6072h allows, {most / 10:g} %",
                              "choose less, or raise 6072h")
            return round(value * 10)
        if kind == "velocity":
            fastest = self.most(axis).velocity
            if fastest and abs(value) > fastest * (1 + 1e-9):
                _, scale = self.bench.unit(axis)
                allowed = f"{fastest * scale:g}"
                raise Refused(
                    "velocity", f"{value * scale:g} is more than 6081h allows, {allowed}",
                    "choose less, or raise 6081h",
                )
            return round(value / units.velocity)
        return round(value / units.position)

    def _inside(self, axis: str, target: float) -> None:
        """Refuse a position beyond the software limits 607Dh."""
        low, high = (self.bench.value(axis, f"{end}_position_limit") for end in ("min", "max"))
        raw = target / self.bench.units(axis).position
        if low is not None and high is not None and low < high and not low <= raw <= high:
            name, scale = self.bench.unit(axis)
            scale *= self.bench.units(axis).position
            stroke = f"{low * scale:g}..{high * scale:g} {name}"
            raise Refused("position", f"{raw * scale:g} {name} is beyond the stroke {stroke}",
                          "choose a target inside")

    def _stream(self, axis: str, kind: str, wave: Wave, time: float) -> None:
        """Follow a wave with a set-point in each exchange."""
        master, name = self.bench.masters[axis], KINDS[kind].name
        master.follow(self._mode_of(axis, kind))
        units = self.bench.units(axis)
        unit = {"position": units.position, "velocity": units.velocity, "torque": 0.1}[kind]
        begin = master.port.now()
        self.bench.streams = kind == "position"
        try:
            while (now := master.port.now() - begin) < time:
                master.write(name, round(wave(now) / unit))
                if master.state is not State.OPERATION_ENABLED:
                    master.follow(self._mode_of(axis, kind))  # says why
        finally:
            self.bench.streams = False
        if kind == "position":
            master.write(name, round(wave(time) / unit))
