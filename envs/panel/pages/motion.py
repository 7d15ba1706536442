"""Motion: power, mode, jog, moves, homing, and the parameters that shape them."""

import time
from collections.abc import Awaitable
from typing import Any

from nicegui import ui

from ....drive.model.rows import Object
from .desk import Desk, refuse
from .homing_diagram import homing_svg
from .set_points import SetPointCard
from .widgets import Entry, Readout, Tag, box, button, card, div, formatted, live, note

# objects that shape a motion, by kind; those that a model does not have are left out
PARAMETERS = {
    "Profile": (
        "profile_velocity", "profile_acceleration", "profile_deceleration",
        "quick_stop_deceleration", "motion_profile_type", "profile_jerk_1",
    ),
    "Limits": (
        "max_profile_velocity", "max_torque", "min_position_limit", "max_position_limit",
        "following_error_window", "following_error_time_out", "position_window",
        "position_window_time",
    ),
    "Homing": (
        "speed_during_search_for_switch", "speed_during_search_for_zero", "homing_acceleration",
        "home_offset",
    ),
    "Gains": (
        "position_control_gain", "velocity_control_gain", "velocity_control_time",
        "velocity_filter_time", "velocity_feed_forward", "acceleration_feed_forward",
    ),
}
SHOWN_WITHIN = 1.0  # s, within which a drive that has accepted a mode displays it
FASTEST = ("max_profile_velocity", "profile_velocity")  # not every model has the first one


class Choice:
    """A value chosen in a list, kept until the drive displays it.

    Without this, the list would show the previous value again for a moment, and choosing that
    value then would send nothing to the drive.
    """

    def __init__(self) -> None:
        self._wanted: int | None = None
        self._under_way = 0
        self._arrived = 0.0  # s

    def is_new(self, value: int, present: int) -> bool:
        """Whether a chosen value differs from the one displayed or sent, and has to be sent."""
        if value == (present if self._wanted is None else self._wanted):
            return False
        self._wanted = value
        self._under_way += 1
        return True

    def arrived(self, now: float) -> None:
        """Note that the drive has accepted or refused a value."""
        self._under_way -= 1
        self._arrived = now

    def keeps(self, present: int, now: float) -> bool:
        """Whether the list keeps the chosen value although the drive displays another one."""
        given_up = not self._under_way and now > self._arrived + SHOWN_WITHIN
        if present == self._wanted or given_up:
            self._wanted = None
        return self._wanted is not None


class MotionPage:
    """Page with power, mode, jog, moves and homing."""

    name, title, icon = "motion", "Motion", "open_with"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.model = desk.bench.model(desk.axis)
        self._choice = Choice()
        self.names = {row.name: row for row in desk.bench.rows(desk.axis)}
        self.unit, self.scale = desk.bench.unit(desk.axis)
        with div("columns motion-columns"):
            with div("stack"):
                self._power()
                self._move()
                self._jog()
                SetPointCard(desk)
            with div("stack"):
                self._readouts()
                self._homing()
            with div("stack"):
                self._parameters()

    def _power(self) -> None:
        go = self.desk.go
        with card("Power and mode"):
            with div("cluster"):
                button("Enable", lambda: go("enable"), "enable", "main")
                button("Disable", lambda: go("disable", at_once=True), "disable")
                button("Reset fault", lambda: go("reset_fault"), "motion-reset")
            modes = {
                int(mode): f"{self.model.mode_name(mode)} · {mode.name.replace('_', ' ').lower()}"
                for mode in self.model.modes
            }
            present = self.desk.status["mode"]
            self.mode = box(ui.select(
                modes, label="Mode of operation 6060h", value=present if present in modes else None,
                on_change=lambda event: self._mode(event.value),
            ), "mode", "wide")

    def _move(self) -> None:
        with card("Move"):
            self.target = Entry("Target", self.unit, test="target", send=self._move_to)
            with div("cluster"):
                button("Move to", lambda: self.target.apply(), "move-to", "main")
                button("Move by", self._move_by, "move-by")
                button("Stop", lambda: self.desk.halt("stop", self.desk.axis), "stop",
                       props="title='Every window may stop. The axis keeps its power.'")

    def _jog(self) -> None:
        with card("Jog"):
            self.jog = Entry("Speed", f"{self.unit}/s", 0.001, test="jog-speed")
            self._jog_speed = 0.0
            with div("cluster jog-row"):
                for sign, text, name in ((-1, "◀  negative", "jog-negative"),
                                         (1, "positive  ▶", "jog-positive")):
                    made = button(text, None, name, "jog")
                    made.on("pointerdown", lambda _, sign=sign: self.run(sign))
                    for event in ("pointerup", "pointerleave", "pointercancel"):
                        made.on(event, self.rest)
            note("Hold a button, or an arrow key.")

    def _readouts(self) -> None:
        with card("Now"):
            with div("readouts"):
                self.position = Readout("Position", self.unit, "position")
                self.velocity = Readout("Velocity", f"{self.unit}/s", "velocity")
                self.torque = Readout("Torque", "% rated")
                self.error = Readout("Following error", self.unit)
            self.stroke = _Stroke(self.desk)

    def _homing(self) -> None:
        with card("Homing"):
            methods = {
                int(method): _method_name(int(method), method in self.model.own_homing)
                for method in sorted(self.model.homing_methods)
            }
            present = self.desk.status["homing_method"]
            with div("cluster"):
                self.method = box(ui.select(
                    methods, label="Method 6098h", value=present if present in methods else None,
                    on_change=self._draw,
                ), "homing-method")
                button("Home", self._home, "home", "main")
            self.diagram = ui.html("", sanitize=False).classes("homing-box")
            self.homed = note("", "homed", "prose")
            self._draw()

    def _parameters(self) -> None:
        self.rows: list[_Parameter] = []
        with card("Parameters", "parameters"), div("parameters"):
            for kind, names in PARAMETERS.items():
                known = [name for name in names if name in self.names]
                if known:
                    ui.label(kind).classes("group")
                self.rows += [_Parameter(self.desk, self.names[name]) for name in known]

    def _draw(self) -> None:
        method = self.method.value
        self.diagram.set_content(
            homing_svg(int(method), self.model.own_homing) if method is not None else ""
        )

    async def _home(self) -> None:
        method = self.method.value
        if method is None:
            ui.notify("choose a homing method first", type="warning")
            return
        await self.desk.go("home", int(method))

    def _mode(self, mode: int | None) -> Awaitable[None] | None:
        """Send the chosen mode. `Choice` is asked here, before the event loop runs anything else.

        Otherwise the next picture could set the list back first, which would be sent as another
        choice.
        """
        if mode is None or not self._choice.is_new(mode, self.desk.status["mode"]):
            return None
        return self._set_mode(mode)

    async def _set_mode(self, mode: int) -> None:
        try:
            await self.desk.go("set_mode", mode)
        finally:
            self._choice.arrived(time.monotonic())

    async def _move_to(self, target: float, *, relative: bool = False) -> Any:
        axis, position = self.desk.axis, target / self.scale
        return await self.desk.motion(lambda s: s.move(axis, position, relative=relative))

    async def _move_by(self) -> None:
        distance = self.target.number()
        if distance is not None:
            self.target.refuse(await self._move_to(distance, relative=True))

    async def run(self, sign: int) -> None:
        """Begin to jog."""
        speed = self.jog.number()
        if speed is None:
            return
        if not self.desk.in_control:  # the key may be released before the session has answered
            refuse(await self.desk.barred() or "control has only now been taken: jog again")
            return
        self.desk.jogging = True
        await self.desk.go("jog", sign * speed / self.scale)

    async def rest(self) -> None:
        """End jogging, if this tab jogs."""
        if self.desk.jogging:
            self.desk.jogging = False
            await self.desk.go("jog", 0.0, at_once=True)

    def _top_speed(self) -> None:
        """Set the range of the jog speed, and a twentieth of it as the initial value."""
        bench, axis = self.desk.bench, self.desk.axis
        name = next((name for name in FASTEST if name in self.names), "")
        top = bench.value(axis, name) if name else 1e9
        if top is not None and top != self._jog_speed:
            speed = max(float(top) * bench.units(axis).velocity * self.scale, 0.001)
            if not self._jog_speed:
                self.jog.field.value = f"{float(f'{speed * 0.05:.3g}'):.10g}"
            self._jog_speed, self.jog.high = top, speed

    def show(self) -> None:
        """Show the present state."""
        seen = self.desk.status
        self._top_speed()
        digits = 0 if self.unit == "units" else 3
        self.position.show(formatted(seen["position"], digits))
        self.velocity.show(formatted(seen["velocity"], digits))
        self.torque.show(formatted(seen["torque"], 1))
        self.error.show(formatted(seen["following_error"], digits))
        self.homed.set_text(
            "A bus does not report whether the axis is referenced." if seen["homed"] is None
            else "The axis is referenced." if seen["homed"] else "Not referenced yet."
        )
        keeps = self._choice.keeps(seen["mode"], time.monotonic())
        if not keeps and seen["mode"] in self.mode.options:
            self.mode.set_value(seen["mode"])
        if self.method.value is None and seen["homing_method"] in self.method.options:
            self.method.set_value(seen["homing_method"])
        self.stroke.show(seen)
        for row in self.rows:
            row.show()


def _method_name(method: int, own: bool = False) -> str:
    if own:
        return f"{method} · of this drive model"
    if method in (35, 37):
        return f"{method} · the present position"
    if method in (33, 34):
        return f"{method} · next index pulse, {'negative' if method == 33 else 'positive'}"
    if method < 0:
        way = "negative" if method in (-1, -17) else "positive"
        return f"{method} · {way} end stop{' and index pulse' if method > -17 else ''}"
    edge = method if method < 17 else method - 16
    what = {1: "negative limit switch", 2: "positive limit switch"}.get(edge, "home switch")
    return f"{method} · {what}{' and index pulse' if method < 17 else ''}"


class _Parameter:
    """An object of the drive: its live value, and a field for a new one."""

    def __init__(self, desk: Desk, row: Object):
        self.desk, self.name = desk, row.name
        self.factor, self.unit = desk.bench.physical(desk.axis, row)
        self.address = row.address
        words = row.name.replace("_", " ")
        with div("parameter"):
            with div("parameter-name"):
                ui.label(words)
                self.plain = note(f"{self.address} {row.unit}", kind="quiet")
            self.value = note("", f"value-{row.name}", "parameter-value")
            Entry(
                "", "", row.minimum, row.maximum, send=self._send, whole=not row.real,
                test=f"set-{row.name}", spoken=f"{words} {self.address}",
            )

    async def _send(self, value: float) -> Any:
        axis, name = self.desk.axis, self.name
        return await self.desk.command(lambda session: session.command(axis, name, value))

    def show(self) -> None:
        """Show the present value."""
        value = self.desk.bench.value(self.desk.axis, self.name)
        live(self.value, "…" if value is None else f"{value}")
        if value is not None and self.factor:
            amount = f"{float(value) * self.factor:.6g} {self.unit}"
            live(self.plain, f"{self.address} = {amount}")


class _Stroke:
    """The axis as a ruler: position, target, software limits."""

    def __init__(self, desk: Desk):
        bench, axis = desk.bench, desk.axis
        names = [f"{end}_position_{limit}" for limit in ("limit", "range_limit")
                 for end in ("min", "max")]
        scale = bench.units(axis).position * bench.unit(axis)[1]

        def ends() -> tuple[float, float]:
            low, high, *turn = (float(bench.value(axis, name) or 0.0) * scale for name in names)
            if low >= high:
                low, high = turn  # 607Bh: the range after which positions repeat
            return (low, high) if low < high else (-180.0, 180.0)

        self._ends = ends
        with div("stroke"):
            with div("stroke-bar"):
                self.places = {name: div(f"stroke-{name}") for name in ("target", "position")}
            with div("stroke-scale"):
                self.marks = [Tag("span") for _ in range(5)]

    def show(self, seen: dict[str, Any]) -> None:
        """Show the present position."""
        low, high = self._ends()
        for part, mark in enumerate(self.marks):
            mark.say(f"{low + (high - low) * part / 4:g}")
        wide = (high - low) * 1.12
        for name, place in self.places.items():
            share = (seen[name] - low + wide * 0.0536) / wide
            place.style(f"left:{min(max(share * 100, 0.0), 100.0):.1f}%")
