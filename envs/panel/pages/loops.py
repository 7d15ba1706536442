"""Loops: the Bode plot of a drive's loops, measured on a copy of the machine, with margins."""

import asyncio
import copy
from typing import Any

import numpy as np
from nicegui import ui

from ...autotune.bode import bode
from ...autotune.response import Response
from .desk import Desk
from .widgets import Entry, Tag, button, card

COLOURS = {"velocity loop": "#3987e5", "position loop": "#e0762b", "plant": "#8a94a3"}


class LoopsPage:
    """What the gains are worth."""

    name, title, icon = "loops", "Loops", "ssid_chart"

    def __init__(self, desk: Desk):
        self.desk = desk
        with ui.element("div").classes("columns scope-columns"):
            with card("Open loops, measured", "bode"):
                self.chart = ui.echart(_chart(None)).classes("chart tall")
            with ui.element("div").classes("stack"):
                with card("Measurement"):
                    self.amplitude = Entry("Amplitude", "% rated", 0.5, 100, 10, test="amplitude")
                    self.measure = button("Measure", self._measure, "measure", "main")
                    ui.label(
                        "A multisine is added to the torque while the axis travels to and fro, on "
                        "a copy of the machine with the present gains. It takes some seconds."
                    ).classes("prose quiet")
                    self.wrong = ui.label("").classes("bad").props("data-test=bode-wrong")
                with card("Margins"):
                    self.margins = ui.element("div").classes("results margins")
                    self.margins.props("data-test=margins")

    async def _measure(self) -> None:
        amplitude = self.amplitude.number()
        if amplitude is None:
            return
        axis = self.desk.axis
        self.wrong.set_text("")
        self.measure.props("loading")
        try:
            twin = await self.desk.ask(lambda session: copy.deepcopy(session.machine))
            response = await asyncio.to_thread(bode, twin, axis, amplitude=amplitude / 100)
        except (ValueError, RuntimeError, ImportError) as error:
            self.wrong.set_text(str(error))
            return
        finally:
            self.measure.props(remove="loading")
        self.chart.options.clear()
        self.chart.options.update(_chart(response))
        self.chart.update()
        self.margins.clear()
        with self.margins:
            for text in ("loop", "crossover", "phase margin", "gain margin"):
                Tag("b", text)
            for name, margins in (("velocity", response.velocity_margins),
                                  ("position", response.position_margins)):  # fmt: skip
                Tag("span", name)
                Tag("span", f"{margins.crossover:.1f} Hz")
                Tag("span", f"{margins.phase:.0f}°")
                Tag("span", f"{margins.gain:.1f} dB")
        if response.note:
            self.wrong.set_text(response.note)

    def show(self) -> None:
        """Nothing changes by itself."""


def _chart(response: Response | None) -> dict[str, Any]:
    """Magnitude and phase over frequency."""
    quiet = "#8a94a3"
    series = []
    if response is not None:
        for name, loop in (("velocity loop", response.velocity_loop),
                           ("position loop", response.position_loop)):  # fmt: skip
            magnitude = 20 * np.log10(np.abs(loop))
            phase = np.degrees(np.unwrap(np.angle(loop)))
            phase -= 360 * np.round((phase[0] + 90) / 360)
            for grid, values in ((0, magnitude), (1, phase)):
                points = np.stack((response.frequencies, values), axis=1).round(3).tolist()
                series.append(
                    {
                        "name": name, "type": "line", "showSymbol": False, "data": points,
                        "xAxisIndex": grid, "yAxisIndex": grid, "color": COLOURS[name],
                        "lineStyle": {"width": 2}, "animation": False,
                    }
                )  # fmt: skip
    axis = {"axisLabel": {"color": quiet}, "nameTextStyle": {"color": quiet},
            "splitLine": {"lineStyle": {"color": "#8a94a333"}}}  # fmt: skip
    frequency = axis | {"type": "log", "min": 2, "minorSplitLine": {"show": False}}
    return {
        "grid": [{"left": 60, "right": 20, "top": 40, "height": "40%"},
                 {"left": 60, "right": 20, "bottom": 45, "height": "36%"}],
        "legend": {"top": 0, "textStyle": {"color": quiet}},
        "tooltip": {"trigger": "axis"},
        "xAxis": [frequency | {"gridIndex": 0}, frequency | {"gridIndex": 1, "name": "Hz"}],
        "yAxis": [axis | {"type": "value", "gridIndex": 0, "name": "magnitude (dB)"},
                  axis | {"type": "value", "gridIndex": 1, "name": "phase (°)"}],
        "series": series,
    }  # fmt: skip
