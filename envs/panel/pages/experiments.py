"""Experiments: snapshots, faults, disturbances; policies that take over, and side by side."""

import copy
from textwrap import shorten
from typing import Any

from nicegui import ui

from ..disturbances import DISTURBANCES, Disturbance, clear, disturb, inject, unit_at
from .charts import course_chart
from .desk import Desk, beside, refuse
from .widgets import Entry, Tag, button, card

CAUSES = (  # offered first, where a model has them
    "encoder_loss", "overvoltage", "undervoltage", "following_error", "motor_temperature",
    "drive_temperature", "i2t", "short_circuit", "index_missing", "external",
)
MOST = 4  # policies side by side
LONGEST = 400  # characters of what is wrong with a policy


class ExperimentsPage:
    """Page with faults, disturbances, snapshots and policies."""

    name, title, icon = "experiments", "Experiments", "science"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.laboratory: Any = desk.clock.session.laboratory
        with ui.element("div").classes("columns experiment-columns"):
            with ui.element("div").classes("stack"):
                self._faults()
                self._disturbances()
                self._snapshots()
            with ui.element("div").classes("stack"):
                self._policies()

    # ------------------------------------------------------------- what is there

    def _faults(self) -> None:
        drive = self.desk.machine.drives[self.desk.axis]
        known = drive.injectable
        first = [cause for cause in CAUSES if cause in known]
        with card("Faults"):
            with ui.element("div").classes("cluster"):
                for cause in first:
                    text = cause.replace("_", " ").replace("i2t", "I²t")
                    button(text, lambda _, cause=cause: self._inject(cause), f"inject-{cause}")
            with ui.element("div").classes("cluster"):
                self.other = ui.select(
                    [cause for cause in known if cause not in first], label="Another cause",
                    with_input=True,
                ).props("dense outlined").classes("entry grow")
                button("Inject", lambda: self._inject(str(self.other.value or "")))
                button("Take all away", self._clear, "clear-injected", "main")
            self.injected = ui.label("Nothing is injected.").props("data-test=injected")
            self.injected.classes("prose quiet")

    def _disturbances(self) -> None:
        session: Any = self.desk.clock.session
        place = session.axes.index(self.desk.axis)
        self.rows: list[tuple[Disturbance, ui.label, int]] = []
        with card("Disturbances"), ui.element("div").classes("parameters"):
            for row in DISTURBANCES:
                unit = unit_at(session, row, self.desk.axis)
                with ui.element("div").classes("parameter"):
                    ui.label(f"{row.name}, {unit}")
                    value = ui.label("").classes("parameter-value")
                    entry = Entry("", "", 0.0, row.most, test=f"disturb-{row.name.split()[0]}",
                                  spoken=f"{row.name}, {unit}")
                    entry.unit = unit
                    entry.send_to(self._sender(row, entry))
                self.rows.append((row, value, place))

    def _sender(self, row: Disturbance, entry: Entry) -> Any:
        async def send(value: float) -> str:
            axis = self.desk.axis
            words = await self.desk.command(lambda s: disturb(s, axis, row, value))
            if not words:
                entry.field.value, entry.field.error = "", None
            return str(words or "")

        return send

    def _snapshots(self) -> None:
        with card("Snapshots"):
            with ui.element("div").classes("cluster"):
                self.label = ui.input(
                    "Name", value="A", validation={"give it a name": lambda t: bool(t.strip())}
                ).props(
                    "dense outlined hide-bottom-space maxlength=24 data-test=snapshot-name"
                ).classes("entry says grow")
                button("Keep", self._keep, "keep", "main")
            self.kept = ui.element("div").classes("cluster")
            self._names: list[str] | None = None
            ui.label(
                "A snapshot holds everything: the machine, the drives and their memory."
            ).classes("prose quiet")

    def _policies(self) -> None:
        with card("Policy takes over", "policies"):
            if self.laboratory is None:
                ui.label(self.desk.bench.no_policies).classes("prose").props(
                    "data-test=no-policies"
                )
                return
            fitting = self.laboratory.fitting(self.desk.axis)
            goal = fitting.goal
            with ui.element("div").classes("cluster"):
                self.policy = ui.input(
                    "Policy", value=fitting.names[0], autocomplete=list(fitting.names)
                ).props("dense outlined data-test=policy").classes("entry grow")
                self.goal = Entry(goal.name, goal.unit, goal.low, goal.high, goal.value,
                                  test="goal")
                self.take = button("Hand over", self._hand_over, "hand-over", "main")
            ui.label(
                f"{fitting.what} {', '.join(fitting.names)}"
                + (
                    "."
                    if self.laboratory.shipped_only
                    else "; FILE.py:name, or the folder of a training."
                )
            ).classes("prose quiet")
            self.wrong = ui.label("").classes("bad").props("data-test=policy-wrong")
        with card("Side by side", "compare"):
            with ui.element("div").classes("cluster"):
                offered = list(fitting.names)
                chosen = [name for name in offered if name in (offered[0], "proportional")]
                self.others = ui.select(
                    offered, multiple=True, value=chosen if len(chosen) > 1 else offered[:2],
                    label="Policies, on copies of this machine, to the same goal",
                    new_value_mode="add-unique",
                ).props("dense outlined use-chips").classes("entry grow")
                self.compare = button("Compare", self._compare, "run-compare", "main")
            self.chart = ui.echart(course_chart([], fitting.shown)).classes("chart")
            self.chart.set_visibility(False)
            self.table = ui.element("div").classes("results").props("data-test=courses")

    # ----------------------------------------------------------------- what is done

    async def _inject(self, cause: str) -> None:
        axis = self.desk.axis
        if not cause:
            refuse("choose another cause first")
            return
        refuse(await self.desk.command(lambda session: inject(session, axis, cause)))

    async def _clear(self) -> None:
        axis = self.desk.axis
        refuse(await self.desk.command(lambda session: clear(session, axis)))

    async def _keep(self) -> None:
        name = str(self.label.value or "").strip()[:24]
        if not self.label.validate():
            return
        refuse(await self.desk.command(lambda session: session.keep(name)))

    async def _back(self, name: str) -> None:
        refuse(await self.desk.motion(lambda session: session.back(name)))

    async def _hand_over(self) -> None:
        goal, name = self.goal.number(), str(self.policy.value or "").strip()
        if goal is None:
            return
        if not name:
            self.wrong.set_text("name a policy, a FILE.py:name or the folder of a training")
            return
        self.wrong.set_text("")
        if barred := await self.desk.barred():
            refuse(barred)
            return
        self.take.props("loading")
        try:
            twin = await self.desk.ask(lambda s: copy.deepcopy(s.machine))
            axis = self.desk.axis
            await beside(self.laboratory.prepare, twin, axis, name, goal)
            words = await self.desk.motion(
                lambda s: s.hand_over(self.laboratory.agent(s, axis, name, goal))
            )
        except Exception as error:  # a policy is a stranger's code
            words = str(error)
        finally:
            self.take.props(remove="loading")
        self.wrong.set_text(shorten(str(words or ""), LONGEST, placeholder=" …"))

    async def _compare(self) -> None:
        names, goal = list(self.others.value or [])[:MOST], self.goal.number()
        if goal is None or not names:
            self.wrong.set_text("" if names else "choose at least one policy")
            return
        self.wrong.set_text("")
        self.compare.props("loading")
        try:
            twin = await self.desk.ask(lambda s: copy.deepcopy(s.machine))
            axis = self.desk.axis
            courses = await beside(self.laboratory.compare, twin, axis, names, goal)
        except Exception as error:
            self.wrong.set_text(shorten(str(error), LONGEST, placeholder=" …"))
            return
        finally:
            self.compare.props(remove="loading")
        self.chart.options.clear()
        self.chart.options.update(course_chart(courses, self.laboratory.fitting(axis).shown))
        self.chart.set_visibility(True)
        self.chart.update()
        self.table.clear()
        with self.table:
            for text in ("policy", *courses[0].figures, "fault"):
                Tag("b", text)
            for course in courses:
                for text in (course.policy, *course.figures.values(), course.fault or "none"):
                    Tag("span", text)

    def show(self) -> None:
        """Show the present state."""
        session: Any = self.desk.clock.session
        for row, value, place in self.rows:
            value.set_text(f"{row.read(session, place) / row.scale:.4g}")
        injected = self.desk.status["injected"]
        self.injected.set_text(
            "Injected and still present." if injected else "Nothing is injected."
        )
        names = self.desk.shown["kept"]
        if names != self._names:
            self._names = names
            self.kept.clear()
            with self.kept:
                for name in names:
                    button(f"Back to {name}", lambda _, name=name: self._back(name), f"back-{name}")
