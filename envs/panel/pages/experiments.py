"""Experiments: faults, disturbances, snapshots, policies that take over or are compared."""

import copy
from collections.abc import Awaitable, Callable
from functools import partial
from textwrap import shorten
from typing import Any

from nicegui import ui

from ...engine.machine import Machine
from ..disturbances import DISTURBANCES, Disturbance, clear, disturb, inject, unit_at
from .charts import course_chart
from .desk import Desk, beside, refuse
from .widgets import Entry, Tag, box, button, card, div, note

CAUSES = (  # offered first, where a model has them
    "encoder_loss", "overvoltage", "undervoltage", "following_error", "motor_temperature",
    "drive_temperature", "i2t", "short_circuit", "index_missing", "external",
)
MOST = 4  # policies that are compared
LONGEST = 400  # characters of an error message of a policy


class ExperimentsPage:
    """Page with faults, disturbances, snapshots and policies."""

    name, title, icon = "experiments", "Experiments", "science"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.laboratory: Any = desk.clock.session.laboratory
        with div("columns experiment-columns"):
            with div("stack"):
                self._faults()
                self._disturbances()
                self._snapshots()
            with div("stack"):
                if self.laboratory is None:
                    with card("Policy takes over", "policies"):
                        note(desk.bench.no_policies, "no-policies", "prose")
                else:
                    self._policies()

    # --------------------------------------------------------- what can be done

    def _faults(self) -> None:
        causes = self.desk.bench.machine.drives[self.desk.axis].injectable
        first = [cause for cause in CAUSES if cause in causes]
        with card("Faults"):
            with div("cluster"):
                for cause in first:
                    text = cause.replace("_", " ").replace("i2t", "I²t")
                    button(text, lambda _, cause=cause: self._inject(cause), f"inject-{cause}")
            with div("cluster"):
                self.other = box(ui.select(
                    [cause for cause in causes if cause not in first], label="Another cause",
                    with_input=True,
                ))
                button("Inject", lambda: self._inject(str(self.other.value or "")))
                button("Take all away", self._clear, "clear-injected", "main")
            self.injected = note("Nothing is injected.", "injected")

    def _disturbances(self) -> None:
        session: Any = self.desk.bench
        self.values: dict[Disturbance, ui.label] = {}
        with card("Disturbances"), div("parameters"):
            for row in DISTURBANCES:
                unit = unit_at(session, row, self.desk.axis)
                with div("parameter"):
                    ui.label(f"{row.name}, {unit}")
                    self.values[row] = note("", kind="parameter-value")
                    entry = Entry(
                        "", "", 0.0, row.most, send=partial(self._disturb, row),
                        test=f"disturb-{row.name.split()[0]}", spoken=f"{row.name}, {unit}",
                    )
                    entry.unit = unit

    def _snapshots(self) -> None:
        with card("Snapshots"):
            with div("cluster"):
                self.label = box(ui.input(
                    "Name", value="A", validation={"give it a name": lambda t: bool(t.strip())}
                ), "snapshot-name", "says grow", "hide-bottom-space maxlength=24")
                button("Keep", self._keep, "keep", "main")
            self.kept = div("cluster")
            self._names: list[str] | None = None
            note("A snapshot holds everything: the machine, the drives and their memory.")

    def _policies(self) -> None:
        fitting = self.laboratory.fitting(self.desk.axis)
        goal, offered = fitting.goal, list(fitting.names)
        with card("Policy takes over", "policies"):
            with div("cluster"):
                self.policy = box(
                    ui.input("Policy", value=offered[0], autocomplete=offered), "policy"
                )
                self.goal = Entry(goal.name, goal.unit, goal.low, goal.high, goal.value,
                                  test="goal")
                self.take = button("Hand over", self._hand_over, "hand-over", "main")
            own = ", FILE.py:name or the folder of a training" * (not self.laboratory.shipped_only)
            note(f"{fitting.what} Choose {', '.join(offered)}{own}.")
            self.wrong = note("", "policy-wrong", "bad")
        with card("Side by side", "compare"):
            with div("cluster"):
                chosen = [name for name in offered if name in (offered[0], "proportional")]
                self.others = box(ui.select(
                    offered, multiple=True, value=chosen if len(chosen) > 1 else offered[:2],
                    label="Policies, on copies of this machine, to the same goal",
                    new_value_mode="add-unique",
                ), props="use-chips")
                self.compare = button("Compare", self._compare, "run-compare", "main")
            self.chart = ui.echart(course_chart([], fitting.shown)).classes("chart")
            self.chart.set_visibility(False)
            self.table = div("results", "courses")

    # ----------------------------------------------------------------- what is done

    async def _disturb(self, row: Disturbance, value: float) -> Any:
        axis = self.desk.axis
        return await self.desk.command(lambda session: disturb(session, axis, row, value))

    async def _inject(self, cause: str) -> None:
        axis = self.desk.axis
        if not cause:
            refuse("choose another cause first")
            return
        await self.desk.do(lambda session: inject(session, axis, cause))

    async def _clear(self) -> None:
        axis = self.desk.axis
        await self.desk.do(lambda session: clear(session, axis))

    async def _keep(self) -> None:
        if self.label.validate():
            name = str(self.label.value).strip()[:24]
            await self.desk.do(lambda session: session.keep(name))

    async def _back(self, name: str) -> None:
        refuse(await self.desk.motion(lambda session: session.back(name)))

    async def _on_a_copy(
        self, made: ui.button, work: Callable[[Machine, str], Awaitable[Any]]
    ) -> Any:
        """Return the result of some work on a copy of the machine; None if it fails.

        The reason is shown. A policy is foreign code, so that it may raise anything.
        """
        self.wrong.set_text("")
        made.props("loading")
        try:
            twin = await self.desk.ask(lambda session: copy.deepcopy(session.machine))
            return await work(twin, self.desk.axis)
        except Exception as error:
            self._say(error)
            return None
        finally:
            made.props(remove="loading")

    def _say(self, wrong: Any) -> None:
        self.wrong.set_text(shorten(str(wrong or ""), LONGEST, placeholder=" …"))

    async def _hand_over(self) -> None:
        goal, name = self.goal.number(), str(self.policy.value or "").strip()
        if goal is None:
            return
        if not name:
            self._say("name a policy, a FILE.py:name or the folder of a training")
            return
        if barred := await self.desk.barred():
            self._say("")
            refuse(barred)
            return

        async def hand_over(twin: Machine, axis: str) -> Any:
            await beside(self.laboratory.prepare, twin, axis, name, goal)
            return await self.desk.motion(
                lambda s: s.hand_over(self.laboratory.agent(s, axis, name, goal))
            )

        if words := await self._on_a_copy(self.take, hand_over):
            self._say(words)

    async def _compare(self) -> None:
        names, goal = list(self.others.value or [])[:MOST], self.goal.number()
        if goal is None or not names:
            self._say("" if names else "choose at least one policy")
            return
        courses = await self._on_a_copy(
            self.compare,
            lambda twin, axis: beside(self.laboratory.compare, twin, axis, names, goal),
        )
        if courses is None:
            return
        chart = course_chart(courses, self.laboratory.fitting(self.desk.axis).shown)
        self.chart.options.clear()
        self.chart.options.update(chart)
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
        session: Any = self.desk.bench
        place = session.axes.index(self.desk.axis)
        for row, label in self.values.items():
            label.set_text(f"{row.read(session, place) / row.scale:.4g}")
        self.injected.set_text(
            "Injected and still present." if self.desk.status["injected"]
            else "Nothing is injected."
        )
        names = self.desk.shown["kept"]
        if names != self._names:
            self._names = names
            self.kept.clear()
            with self.kept:
                for name in names:
                    button(f"Back to {name}", partial(self._back, name), f"back-{name}")
