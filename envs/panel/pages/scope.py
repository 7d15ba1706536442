"""Scope: channels by name, a trigger that evaluates every sample, zoom, cursors, export."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui
from nicegui.element import Element

from ....drive.trace import Edge, Trigger
from ..bench import Bench
from ..recorder import MOST_CHANNELS, Run, Window
from .desk import Desk
from .widgets import Entry, Tag, box, button, card, div, file_button, note, toggle

STATIC = Path(__file__).parents[1] / "static"
COLOURS = ("#3987e5", "#e0762b", "#2f9e5f", "#c2427a", "#8b6fd6", "#12a5a5", "#b08a1e", "#7a8291")
EDGES = {
    int(Edge.RISING): "rising", int(Edge.FALLING): "falling", int(Edge.ABOVE): "above",
    int(Edge.CHANGE): "any change",
}
RUNS = {int(Run.ROLL): "Roll", int(Run.NORMAL): "Normal", int(Run.SINGLE): "Single"}


class Plot(Element, component=STATIC / "scope.js", esm={"uplot": str(STATIC / "uplot")}):
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
        offered = desk.bench.channels()
        with div("columns scope-columns"):
            with card("Scope", "scope"):
                self._plot()
            with div("stack"):
                self._channels(offered)
                self._triggers(offered)
                if desk.bench.beside is not None:
                    with card("Twin"), div("cluster"):
                        self.twin = Tag("span", "", data_test="twin-state").classes("prose")
                        button("Align", lambda: desk.do(lambda s: s.beside.align()), "align-twin",
                               props='title="Place the twin where the axis stands, in its mode"')
                with card("Set-up"), div("cluster"):
                    button("Save …", self._save, "save-set-up")
                    file_button("Load …", self._load, "load-set-up")
                self._time()

    def _plot(self) -> None:
        with div("cluster scope-bar"):
            self.state = note("", "scope-state", "chip")
            self.freeze = button(
                "Freeze", lambda: self.desk.do(lambda s: s.scope.freeze(not s.scope.frozen)),
                "freeze", "main",
            )
            button("Zoom out", lambda: self.plot.run_method("unzoom"))
            button("Cursor A", lambda: self.plot.run_method("mark", "a"))
            button("Cursor B", lambda: self.plot.run_method("mark", "b"))
            button("No cursors", lambda: self.plot.run_method("unmark"))
            ui.space()
            self.physical = ui.switch("mm, mm/s, %", value=True, on_change=self._units)
            self.physical.props("dense data-test=physical")
            self.physical.props('title="Physical units, or those of the drive"')
            button("CSV", self._csv, "csv")
            button("PNG", lambda: self.plot.run_method("png", self.desk.bench.title), "png")
        self.plot = Plot()
        self.plot.on("ready", self._ready, [])
        note("Drag to zoom, double-click to zoom out. Keys a and b set cursors at the pointer, "
             "← and → move the last one, Delete removes them.")

    def _channels(self, offered: list[str]) -> None:
        bench = self.desk.bench
        with card("Channels"):
            self.chosen = box(ui.select(
                offered, multiple=True, value=list(bench.scope.channels),
                label="Objects, or fields of the record" if bench.fields() else "Objects",
                with_input=True, on_change=self._choose,
            ), "channels", "wide", "use-chips")

    def _triggers(self, offered: list[str]) -> None:
        scope, change = self.desk.bench.scope, self._trigger
        trigger = scope.trigger or Trigger(scope.channels[0], Edge.RISING, 0.0)
        with card("Trigger"):
            self.run = toggle(RUNS, int(scope.run), change, "trigger-run", "spread")
            self.channel = box(ui.select(
                offered, label="Channel", with_input=True, value=trigger.channel, on_change=change
            ), "trigger-channel", "wide")
            with div("cluster"):
                self.edge = box(ui.select(
                    EDGES, label="Edge", value=int(trigger.edge), on_change=change
                ), "trigger-edge")
                self.level = Entry("Level", "", -1e12, 1e12, trigger.level, self._level,
                                   test="trigger-level")
            button("Arm", change, "arm", "main")

    def _time(self) -> None:
        bench, scope = self.desk.bench, self.desk.bench.scope
        longest = scope.depth * scope.period
        with card("Time"), div("cluster"):
            self.span = Entry("Window", "s", 10 * scope.period, longest, scope.span, self._window,
                              test="window")
            self.before = Entry("Pre-trigger", "%", 0, 95, scope.before * 100, self._window,
                                test="pre-trigger")
        sampling = bench.sampling.format(rate=f"{1 / scope.period:g}")
        note(f"{sampling} The trigger evaluates every sample; the last {longest:g} s are kept.")

    def _shown(self, channel: str) -> tuple[float, str]:
        """Factor by which the values of a channel are displayed, and the resulting unit."""
        bench = self.desk.bench
        axis, name = bench.found(channel)
        row = next((row for row in bench.rows(axis) if row.name == name), None)
        factor, unit = bench.physical(axis, row) if self.physical.value and row else (0.0, "")
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
        await self.desk.do(lambda session: session.scope.use(json.loads(content)))
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
        if tuple(names) == self.desk.bench.scope.channels:
            return
        if not 1 <= len(names) <= MOST_CHANNELS:
            self.chosen.props(f'error error-message="choose 1..{MOST_CHANNELS} channels"')
            return
        self.chosen.props(remove="error error-message")
        await self.desk.do(lambda session: session.scope.choose(names))

    async def _trigger(self) -> None:
        level = self.level.number()
        if level is not None:
            await self._level(level)

    async def _level(self, level: float) -> Any:
        run, channel, edge = Run(self.run.value), str(self.channel.value), Edge(self.edge.value)
        factor, _ = self._shown(channel)
        return await self.desk.command(
            lambda session: session.scope.set_trigger(run, channel, edge, level / factor)
        )

    async def _window(self, _: float) -> Any:
        span, before = self.span.number(), self.before.number()

        def set_window(session: Bench) -> None:  # an invalid field leaves its value as it is
            scope = session.scope
            ahead = scope.before if before is None else before / 100
            scope.set_window(scope.span if span is None else span, ahead)

        return await self.desk.command(set_window)

    async def _csv(self) -> None:
        shown = {name: self._shown(name) for name in self.channels}
        text = await self.desk.ask(lambda session: session.scope.csv(shown))
        ui.download.content(text.encode(), "scope.csv", "text/csv")

    async def show(self) -> None:
        """Show the present picture."""
        scope = self.desk.bench.scope
        self.state.set_text(scope.state)
        self.freeze.set_text("Go on" if scope.frozen else "Freeze")
        if self.desk.bench.beside is not None:
            self.twin.say(self.desk.shown["twin"])
        if not self._plotted:
            return
        if self.channels != scope.channels:
            self.channels, self._last = scope.channels, (-1, "")
            shown = [self._shown(name) for name in self.channels]
            self._factors = np.array([[factor] for factor, _ in shown])
            self.plot.configure([
                {
                    "name": name, "unit": unit, "colour": colour,
                    "axis": ":".join(self.desk.bench.found(name)) if "following_error" in name
                    else unit,
                    "grain": 1e-3 if "axis." in name else factor,
                }
                for name, (factor, unit), colour in zip(self.channels, shown, COLOURS, strict=False)
            ])
            self.chosen.set_value(list(self.channels))
        await self._draw()

    async def _draw(self) -> None:
        def look(session: Bench) -> tuple[Window, dict[str, Any], tuple[str, ...]]:
            scope, trigger = session.scope, session.scope.trigger
            ahead = scope.before if trigger else 1.0
            info: dict[str, Any] = {
                "from": -ahead * scope.span, "to": (1 - ahead) * scope.span,
                "trigger": trigger and {
                    "channel": trigger.channel,
                    "level": trigger.level * self._shown(trigger.channel)[0],
                },
            }
            return scope.view(), info, scope.channels

        window, info, channels = await self.desk.ask(look)
        if (window.number, window.state) == self._last or channels != self.channels:
            return
        self._last = window.number, window.state
        self.plot.draw(window._replace(values=window.values * self._factors), info)
