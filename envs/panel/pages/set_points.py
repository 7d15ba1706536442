"""Set-points of torque, velocity and position, once or as a wave of the function generator."""

from typing import Any

from nicegui import ui

from ..generator import KINDS
from .desk import Desk, refuse
from .widgets import Entry, box, button, card, div, note, toggle

TIME = 5.0  # s of a wave


class SetPointCard:
    """Card of the motion page for set-points and the function generator."""

    def __init__(self, desk: Desk):
        self.desk = desk
        bench, axis = desk.bench, desk.axis
        name, scale = bench.unit(axis)
        self._units = {"position": (name, scale), "velocity": (f"{name}/s", scale),
                       "torque": ("% rated", 1.0)}
        known = [kind for kind, row in KINDS.items() if {*row.modes} & {*bench.model(axis).modes}]
        with card("Set-points", "set-points"):
            if not known:
                note("This drive has no mode for set-points.")
                return
            self.kind = toggle(known, known[0], self._choose, "set-point-kind", "spread")
            with div("cluster"):
                self.value = Entry("Value", test="set-point", send=self._set)
                button("Set", lambda: self.value.apply(), "set-point-go", "main")
            with div("cluster"):
                self.shape = box(ui.select([], label="Generator"), "generator-shape")
                self.size = Entry("Size", test="generator-size")
            with div("cluster"):
                self.frequency = Entry("Frequency", "Hz", 0.01, 200, 1, test="generator-frequency")
                self.time = Entry("For", "s", 0.1, 600, TIME, test="generator-time")
                button("Run", self._run, "generator-run", "main")
            note("A set-point beyond 6081h, 6083h, 6072h or 607Dh is refused. Positions are "
                 "streamed in csp; a wave begins at the present position. Stop ends it in every "
                 "window.")
            self._choose()

    def _choose(self) -> None:
        kind = str(self.kind.value)
        for entry in (self.value, self.size):
            entry.show_unit(self._units[kind][0])
        self.shape.set_options(list(KINDS[kind].shapes), value=KINDS[kind].shapes[0])

    async def _send(self, what: str, *sizes: Any) -> None:
        """Call a method of the session's set-points for the chosen kind."""
        kind, axis = str(self.kind.value), self.desk.axis
        refuse(await self.desk.motion(lambda s: getattr(s.set_points, what)(axis, kind, *sizes)))

    def _si(self, value: float) -> float:
        return value / self._units[str(self.kind.value)][1]

    async def _set(self, value: float) -> None:
        await self._send("set", self._si(value))

    async def _run(self) -> None:
        size, frequency, time = self.size.number(), self.frequency.number(), self.time.number()
        if size is None or frequency is None or time is None:
            return
        await self._send("generate", str(self.shape.value), self._si(size), frequency, time)
