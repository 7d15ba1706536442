"""Set-points of torque, velocity and position, once or as a wave of the function generator."""

from nicegui import ui

from ..bench import Bench
from ..generator import KINDS
from .desk import Desk, refuse
from .widgets import TOGGLE, Entry, button, card

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
                ui.label("This drive has no mode for set-points.").classes("prose quiet")
                return
            self.kind = ui.toggle(known, value=known[0], on_change=self._choose)
            self.kind.props(f"{TOGGLE} spread data-test=set-point-kind")
            with ui.element("div").classes("cluster"):
                self.value = Entry("Value", "", test="set-point", send=self._set)
                button("Set", lambda: self.value.apply(), "set-point-go", "main")
            with ui.element("div").classes("cluster"):
                self.shape = ui.select([], label="Generator").classes("entry grow")
                self.shape.props("dense outlined data-test=generator-shape")
                self.size = Entry("Size", "", test="generator-size")
            with ui.element("div").classes("cluster"):
                self.frequency = Entry("Frequency", "Hz", 0.01, 200, 1, test="generator-frequency")
                self.time = Entry("For", "s", 0.1, 600, TIME, test="generator-time")
                button("Run", self._run, "generator-run", "main")
            ui.label(
                "Within 6081h, 6083h, 6072h and 607Dh, or refused. Positions are streamed in csp; "
                "a wave counts from here. Stop ends it, in every window."
            ).classes("prose quiet")
            self._choose()

    def _choose(self) -> None:
        kind = str(self.kind.value)
        unit, _ = self._units[kind]
        for entry in (self.value, self.size):
            entry.unit = unit
            entry.field.props(f'suffix="{unit}"')
        self.shape.set_options(list(KINDS[kind].shapes), value=KINDS[kind].shapes[0])

    async def _set(self, value: float) -> str:
        kind, axis = str(self.kind.value), self.desk.axis
        _, scale = self._units[kind]
        refuse(await self.desk.motion(lambda s: s.set_points.set(axis, kind, value / scale)))
        return ""

    async def _run(self) -> None:
        kind, axis, shape = str(self.kind.value), self.desk.axis, str(self.shape.value)
        size, frequency, time = self.size.number(), self.frequency.number(), self.time.number()
        if size is None or frequency is None or time is None:
            return
        _, scale = self._units[kind]

        def motion(session: Bench) -> str:
            return session.set_points.generate(axis, kind, shape, size / scale, frequency, time)

        refuse(await self.desk.motion(motion))
