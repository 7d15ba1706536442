"""Scope: channels by name, a trigger that sees every sample, zoom, cursors, export."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui
from nicegui.element import Element

from ....drive.trace import Edge
from ..bench import Bench
from ..recorder import MOST_CHANNELS, Run, Window
from .desk import Desk, refuse
from .units import physical
from .widgets import TOGGLE, Entry, Tag, button, card, file_button

STATIC = Path(__file__).parents[1] / "static"
COLOURS = ("#3987e5", "#e0762b", "#2f9e5f", "#c2427a", "#8b6fd6", "#12a5a5", "#b08a1e", "#7a8291")
EDGES = {
    int(Edge.RISING): "rising", int(Edge.FALLING): "falling", int(Edge.ABOVE): "above",
    int(Edge.CHANGE): "any change",
}
RUNS = {int(Run.ROLL): "Roll", int(Run.NORMAL): "Normal", int(Run.SINGLE): "Single"}


class Plot(
    Element,
    component=STATIC / "scope.js",
    esm={"uplot": str(STATIC / "uplot")},
):
    """The chart of the scope."""

    def configure(self, channels: list[dict[str, Any]]) -> None:
        """Change the channels."""
        self.run_method("configure", channels)

    def draw(self, window: Window, info: dict[str, Any]) -> None:
        """Draw new samples."""
        packed = np.concatenate((window.time[None], window.values)).astype("<f4")
        text = base64.b64encode(packed.tobytes()).decode()
        self.run_method("draw", text, info | {"points": len(window.time), "state": window.state})


class ScopePage:
    """Page that plots channels over time."""

    name, title, icon = "scope", "Scope", "show_chart"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.channels: tuple[str, ...] = ()
        self._last: tuple[int, str] = (-1, "")
        self._factors = np.ones((1, 1))
        self._plotted = False
        ui.add_css((STATIC / "uplot" / "uPlot.css").read_text(encoding="utf-8"))
        bench = desk.bench
        offered, scope = bench.channels(), bench.scope
        with ui.element("div").classes("columns scope-columns"):
            with card("Scope", "scope"):
                with ui.element("div").classes("cluster scope-bar"):
                    self.state = ui.label("").classes("chip").props("data-test=scope-state")
                    self.freeze = button("Freeze", self._freeze, "freeze", "main")
                    button("Zoom out", lambda: self.plot.run_method("unzoom"))
                    button("Cursor A", lambda: self.plot.run_method("mark", "a"))
                    button("Cursor B", lambda: self.plot.run_method("mark", "b"))
                    button("No cursors", lambda: self.plot.run_method("unmark"))
                    ui.space()
                    self.physical = ui.switch("mm, mm/s, %", value=True, on_change=self._units)
                    self.physical.props("dense data-test=physical")
                    self.physical.props('title="physical units, or those of the drive"')
                    button("CSV", self._csv, "csv")
                    button("PNG", lambda: self.plot.run_method("png", desk.bench.title), "png")
                self.plot = Plot()
                self.plot.on("ready", self._ready, [])
                ui.label(
                    "Drag to zoom, double-click to zoom out. Keys a and b set cursors at the "
                    "pointer, ← and → move the last one, Delete removes them."
                ).classes("prose quiet")
            with ui.element("div").classes("stack"):
                with card("Channels"):
                    self.chosen = ui.select(
                        offered, multiple=True, value=list(scope.channels),
                        label="Objects, or fields of the record" if bench.fields() else "Objects",
                        with_input=True, on_change=self._choose,
                    )
                    self.chosen.props("dense outlined use-chips data-test=channels").classes(
                        "entry wide"
                    )
                with card("Trigger"):
                    self.run = ui.toggle(RUNS, value=int(scope.run), on_change=self._trigger)
                    self.run.props(f"{TOGGLE} spread data-test=trigger-run")
                    trigger = scope.trigger
                    self.channel = ui.select(
                        offered, label="Channel", with_input=True, on_change=self._trigger,
                        value=trigger.channel if trigger else scope.channels[0],
                    )
                    self.channel.props("dense outlined data-test=trigger-channel")
                    self.channel.classes("entry wide")
                    with ui.element("div").classes("cluster"):
                        self.edge = ui.select(
                            EDGES, label="Edge", value=int(trigger.edge if trigger else 0),
                            on_change=self._trigger,
                        )
                        self.edge.props("dense outlined data-test=trigger-edge")
                        self.edge.classes("entry grow")
                        self.level = Entry(
                            "Level", "", -1e12, 1e12, trigger.level if trigger else 0,
                            self._level, test="trigger-level",
                        )
                    button("Arm", self._trigger, "arm", "main")
                if bench.beside is not None:
                    with card("Twin"), ui.element("div").classes("cluster"):
                        self.twin = Tag("span", "", data_test="twin-state").classes("prose")
                        button("Align", self._align, "align-twin").props(
                            'title="Place the twin where the axis stands, in its mode"'
                        )
                with card("Set-up"), ui.element("div").classes("cluster"):
                    button("Save …", self._save, "save-set-up")
                    file_button("Load …", self._load, "load-set-up")
                with card("Time"), ui.element("div").classes("cluster"):
                    longest = scope.depth * scope.period
                    self.span = Entry("Window", "s", 10 * scope.period, longest, scope.span,
                                      self._window, test="window")
                    self.before = Entry("Pre-trigger", "%", 0, 95, scope.before * 100,
                                        self._window, test="pre-trigger")
                self.about = ui.label("").classes("prose quiet")
        rate = f"{1 / scope.period:g}"
        self.about.set_text(
            f"{bench.sampling.format(rate=rate)} The trigger evaluates all of them; the last "
            f"{longest:g} s are kept."
        )

    def _shown(self, channel: str) -> tuple[float, str]:
        """Factor by which the values of a channel are displayed, and the resulting unit."""
        bench = self.desk.bench
        axis, name = bench.found(channel)
        row = next((row for row in bench.rows(axis) if row.name == name), None)
        factor, unit = physical(bench, axis, row) if self.physical.value and row else (0.0, "")
        return (factor, unit) if factor else (1.0, bench.unit_of(channel))

    def _units(self) -> None:
        """Change the units; the level of the trigger stays where it is in the chart."""
        trigger = self.desk.bench.scope.trigger
        if trigger:
            factor, _ = self._shown(trigger.channel)
            self.level.field.value = f"{trigger.level * factor:.6g}"
        self.channels = ()

    async def _save(self) -> None:
        set_up = await self.desk.ask(lambda session: session.scope.set_up())
        ui.download.content(json.dumps(set_up, indent=1).encode(), "scope.json", "application/json")

    async def _load(self, event: events.UploadEventArguments) -> None:
        content = await event.file.read()

        def use(session: Bench) -> None:
            session.scope.use(json.loads(content))

        refuse(await self.desk.command(use))
        scope = self.desk.bench.scope
        self.run.value, self.channels = int(scope.run), ()
        self.span.field.value = f"{scope.span:g}"
        self.before.field.value = f"{scope.before * 100:g}"
        if scope.trigger:
            self.channel.value, self.edge.value = scope.trigger.channel, int(scope.trigger.edge)
        self._units()

    def _ready(self) -> None:
        self._plotted, self.channels = True, ()

    async def _choose(self) -> None:
        names = list(self.chosen.value or [])
        if tuple(names) == self.desk.clock.session.scope.channels:
            return
        if not 1 <= len(names) <= MOST_CHANNELS:
            self.chosen.props(f'error error-message="choose 1..{MOST_CHANNELS} channels"')
            return
        self.chosen.props(remove="error error-message")
        refuse(await self.desk.command(lambda session: session.scope.choose(names)))

    async def _trigger(self) -> None:
        level = self.level.number()
        if level is None:
            return
        await self._level(level)

    async def _level(self, level: float) -> str:
        run, channel, edge = Run(self.run.value), str(self.channel.value), Edge(self.edge.value)

        factor, _ = self._shown(channel)

        def set_trigger(session: Bench) -> None:
            session.scope.set_trigger(run, channel, edge, level / factor)

        return str(await self.desk.command(set_trigger) or "")

    async def _window(self, _: float) -> str:
        span, before = self.span.number(), self.before.number()

        def set_window(session: Bench) -> None:  # what is not a number stays as it is
            scope = session.scope
            ahead = scope.before if before is None else before / 100
            scope.set_window(scope.span if span is None else span, ahead)

        return str(await self.desk.command(set_window) or "")

    async def _freeze(self) -> None:
        refuse(await self.desk.command(lambda s: s.scope.freeze(not s.scope.frozen)))

    async def _align(self) -> None:
        def align(session: Bench) -> None:
            if session.beside is not None:
                session.beside.due = True

        refuse(await self.desk.command(align))

    async def _csv(self) -> None:
        shown = {name: self._shown(name) for name in self.channels}
        text = await self.desk.ask(lambda session: session.scope.csv(shown))
        ui.download.content(text.encode(), "scope.csv", "text/csv")

    async def show(self) -> None:
        """The present picture."""
        scope = self.desk.clock.session.scope
        self.state.set_text(scope.state)
        self.freeze.set_text("Go on" if scope.frozen else "Freeze")
        if self.desk.bench.beside is not None:
            self.twin.say(self.desk.shown["twin"])
        if not self._plotted:
            return
        if self.channels != scope.channels:
            self.channels = scope.channels
            self._last = (-1, "")
            shown = [self._shown(name) for name in self.channels]
            self._factors = np.array([[factor] for factor, _ in shown])
            self.plot.configure(
                [
                    {
                        "name": name,
                        "unit": unit,
                        "axis": ":".join(self.desk.bench.found(name))
                        if "following_error" in name else unit,
                        "colour": COLOURS[i],
                        "grain": 1e-3 if "axis." in name else factor,
                    }
                    for i, (name, (factor, unit)) in enumerate(
                        zip(self.channels, shown, strict=True)
                    )
                ]
            )
            if list(self.chosen.value or []) != list(self.channels):
                self.chosen.set_value(list(self.channels))
        await self._draw()

    async def _draw(self) -> None:
        def look(session: Bench) -> tuple[Window, dict[str, Any], tuple[str, ...]]:
            scope = session.scope
            ahead = scope.before if scope.trigger else 1.0
            info: dict[str, Any] = {
                "from": -ahead * scope.span, "to": (1 - ahead) * scope.span, "trigger": None
            }
            if scope.trigger:
                trigger = scope.trigger
                level = trigger.level * self._shown(trigger.channel)[0]
                info["trigger"] = {"channel": trigger.channel, "level": level}
            return scope.view(), info, scope.channels

        window, info, channels = await self.desk.ask(look)
        if (window.number, window.state) == self._last or channels != self.channels:
            return
        self._last = window.number, window.state
        self.plot.draw(window._replace(values=window.values * self._factors), info)
