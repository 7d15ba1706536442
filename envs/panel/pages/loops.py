"""Loops: Bode plot with margins, measured on a copy of the machine; autotuning."""

import asyncio
import copy
import math
from collections.abc import Callable
from typing import Any

from nicegui import ui

from ....drive.advice import remedy
from ...autotune.bode import bode
from ...autotune.margins import Margins
from ...autotune.response import Response
from ...autotune.trial import Trial
from ...autotune.tune import Tuned, tune
from ...engine.machine import Machine
from .charts import SMALL, bode_chart, move_chart, step_chart
from .desk import Desk, Refusal, beside, refuse
from .widgets import Entry, Tag, button, card, div, note, toggle, two_sided

TAKE_OVER, PUT_BACK = "Take over", "Put back"
VIEWS = {"bode": "Bode", "step": "Step", "move": "Move"}


class LoopsPage:
    """Page with Bode plots and autotuning."""

    name, title, icon = "loops", "Loops", "ssid_chart"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.responses: list[Response] = []
        self.tuned: Tuned | None = None
        self.taken: dict[str, int] | None = None  # the gains that the drive had before
        self._taking = asyncio.Lock()
        with div("columns loop-columns"):
            with card("Open loops, measured", "bode"):
                self.view = toggle(VIEWS, "bode", self._draw, "loop-view")
                self.view.set_visibility(False)
                self.hint = note("Measure the loops, or tune a copy.")
                self.chart = ui.echart(bode_chart([])).classes("chart tall")
                self.chart.set_visibility(False)
            with div("stack"):
                self._measurement()
                self._tuning()
                with card("Margins"):
                    self.margins = div("results margins", "margins")
                    with self.margins:
                        Tag("span", "Nothing has been measured yet.").classes("whole quiet")

    def _measurement(self) -> None:
        with card("Measurement"):
            with div("cluster"):
                self.amplitude = Entry("Amplitude", "% rated", 0.5, 100, 10, test="amplitude")
                self.measure = button("Measure", self._measure, "measure", "main")
            note("A multisine is added to the torque while the axis travels to and fro, on a copy "
                 "of the machine with the present gains.")
            self.wrong = note("", "bode-wrong", "bad")

    def _tuning(self) -> None:
        with card("Autotuning", "tuning"):
            with div("cluster"):
                self.gain = Entry("Gain margin", "dB", 2, 40, 6, test="gain-margin")
                self.phase = Entry("Phase margin", "°", 10, 80, 35, test="phase-margin")
                self.tune = button("Tune a copy", self._tune, "tune", "main")
            note("Measures the plant and fits gains that keep these margins. Take over writes the "
                 "gains to the drive.")
            self.verdict = note("", "tune-verdict", "prose")
            self.gains = div("results gains", "gains")
            with div("cluster"):
                self.take = two_sided(TAKE_OVER, self._take, "take-gains", "main")
                self.discard = button("Discard", self._discard, "discard-gains")
            self._buttons()

    # --------------------------------------------------------------- on a copy

    async def _on_a_copy(self, made: ui.button, work: Callable[[Machine], Any]) -> Any:
        """Return the result of some work on a copy; None where it fails, and show the reason."""
        axis, bench = self.desk.axis, self.desk.bench
        self.wrong.set_text("")
        if said := faulty(axis, *bench.fault_of(axis)):
            self.wrong.set_text(said)
            return None
        made.props("loading")
        twin = await self.desk.ask(lambda session: copy.deepcopy(session.machine))
        done = await self.desk.tried(beside(work, twin))
        made.props(remove="loading")
        if not isinstance(done, Refusal):
            return done
        drive = twin.drives[axis]
        self.wrong.set_text(faulty(axis, drive.fault, remedy(drive.axis), "the copy") or done)
        return None

    async def _measure(self) -> None:
        amplitude, axis = self.amplitude.number(), self.desk.axis
        if amplitude is None:
            return
        response = await self._on_a_copy(
            self.measure, lambda twin: bode(twin, axis, amplitude=amplitude / 100)
        )
        if response is not None:
            self._show_response([response])
            self.wrong.set_text(response.note)

    async def _tune(self) -> None:
        amplitude, axis = self.amplitude.number(), self.desk.axis
        gain, phase = self.gain.number(), self.phase.number()
        if amplitude is None or gain is None or phase is None:
            return
        tuned = await self._on_a_copy(
            self.tune,
            lambda twin: tune(
                twin, axis, gain_margin=gain, phase_margin=phase, amplitude=amplitude / 100
            ),
        )
        if tuned is None:
            return
        self.tuned, self.taken = tuned, None
        self._show_response([tuned.before, tuned.after], tuned)
        self.verdict.set_text(
            "The margins are reached." if tuned.reached
            else f"The margins are not reached: {tuned.reason}"
        )
        before = await self.desk.ask(lambda s: s.gains(axis, tuned.objects))
        self.gains.clear()
        with self.gains:
            for text in ("object", "now", "tuned", "unit"):
                Tag("b", text)
            for address, name, value, unit in tuned.table:
                short = name.partition(" (")[0]
                Tag("span", short.replace("_", " "), title=address)
                Tag("span", f"{before.get(short, 0)}")
                Tag("span", f"{value}").classes("strong")
                Tag("span", unit).classes("quiet")
        self._buttons()

    # ------------------------------------------------------ taken over, or not

    async def _take(self, shown: str) -> None:
        async with self._taking:  # two presses take over once
            tuned, gains, taken, axis = self.tuned, self.taken, None, self.desk.axis
            if tuned is None or shown != self.take.text:
                return
            if gains is None:
                gains = tuned.objects
                taken = await self.desk.ask(lambda s: s.gains(axis, tuned.objects))
            if words := await self.desk.command(lambda s: s.commission(axis, gains)):
                refuse(words)
                return
            self.taken = taken
        self.verdict.set_text(
            "The drive has the gains; 1010h stores them." if taken
            else "The drive has the gains it had before."
        )
        self._buttons()

    def _discard(self) -> None:
        self.tuned = self.taken = None
        self.verdict.set_text("")
        self.gains.clear()
        self._show_response(self.responses[:1])
        self._buttons()

    def _buttons(self) -> None:
        self.take.set_visibility(self.tuned is not None)
        self.discard.set_visibility(self.tuned is not None and self.taken is None)
        self.take.set_text(PUT_BACK if self.taken else TAKE_OVER)
        self.view.set_visibility(self.tuned is not None)
        if self.tuned is None:
            self.view.set_value("bode")

    # ----------------------------------------------------------------- drawing

    def _show_response(self, responses: list[Response], tuned: Tuned | None = None) -> None:
        self.responses = responses
        self.hint.set_visibility(False)
        self.chart.set_visibility(True)
        self._draw()
        self.margins.clear()
        with self.margins:
            for text in ("loop", "crossover", "phase margin", "gain margin"):
                Tag("b", text)
            for number, response in enumerate(responses):
                when = ("", " before")[number == 0] if len(responses) > 1 else ""
                for name, margins in (("velocity", response.velocity_margins),
                                      ("position", response.position_margins)):
                    self._margin_row(f"{name}{when}", margins)
            if tuned is not None:
                for text in ("greatest following error", "before", "after"):
                    Tag("b", text).classes("pair" if "greatest" in text else "")
                Tag("span", "on a move").classes("pair")
                for trial in (tuned.trial_before, tuned.trial_after):
                    Tag("span", _error(trial, tuned.unit))

    def _margin_row(self, name: str, margins: Margins) -> None:
        Tag("span", name)
        Tag("span", f"{margins.crossover:.1f} Hz" if margins.measured else "–")
        if margins.stable:
            Tag("span", f"{margins.phase:.0f}°" if margins.measured else "–")
            Tag("span", f"{margins.gain:.1f} dB")
        else:
            Tag("span", "unstable").classes("bad")
            Tag("span", "")

    def _draw(self) -> None:
        view, tuned = self.view.value, self.tuned
        if view == "bode" or tuned is None:
            chart = bode_chart(self.responses)
        elif view == "step":
            chart = step_chart(tuned.trial_before, tuned.trial_after)
        else:
            chart = move_chart(tuned.trial_before, tuned.trial_after, tuned.unit)
        self.chart.options.clear()
        self.chart.options.update(chart)
        self.chart.update()

    def show(self) -> None:
        """Do nothing: this page changes only when a button is pressed."""


def faulty(axis: str, fault: str, remedy: str, what: str = "it") -> str:
    """The reason why nothing can be measured on a drive in fault; empty without a fault."""
    return f"{axis}: {what} is in FAULT, {fault}; {remedy}" if fault else ""


def _error(trial: Trial, unit: str) -> str:
    small, scale = SMALL[unit]
    if not math.isfinite(trial.following_error):
        return "not moved"
    return f"{trial.following_error * scale:.3g} {small}"
