"""The state diagram of CiA 402 as SVG: the present state is lit, possible commands are buttons."""

from collections.abc import Awaitable, Callable

from nicegui import ui

from ....drive.diagrams import State, Transition, transitions
from .widgets import Tag, div, lit

WIDTH, HEIGHT = 196, 46
PLACES = {  # left, top
    State.NOT_READY_TO_SWITCH_ON: (70, 8),
    State.SWITCH_ON_DISABLED: (70, 100),
    State.READY_TO_SWITCH_ON: (70, 212),
    State.SWITCHED_ON: (70, 324),
    State.OPERATION_ENABLED: (70, 436),
    State.QUICK_STOP_ACTIVE: (350, 436),
    State.FAULT_REACTION_ACTIVE: (350, 8),
    State.FAULT: (350, 100),
}
# number: path, place of its number
ARROWS = {
    1: ("M168 54 V100", (168, 76)),
    2: ("M130 146 V212", (130, 178)),
    7: ("M206 212 V146", (206, 178)),
    3: ("M130 258 V324", (130, 290)),
    6: ("M206 324 V258", (206, 290)),
    4: ("M130 370 V436", (130, 402)),
    5: ("M206 436 V370", (206, 402)),
    8: ("M70 470 H40 V235 H70", (40, 352)),
    9: ("M70 448 H20 V123 H70", (20, 290)),
    10: ("M266 347 H300 V135 H266", (300, 290)),
    11: ("M266 448 H350", (308, 448)),
    16: ("M350 470 H266", (308, 470)),
    12: ("M448 436 V200 H322 V120 H266", (448, 318)),
    13: ("M290 31 H350", (312, 31)),
    14: ("M448 54 V100", (448, 76)),
    15: ("M350 112 H266", (322, 108)),
}


class StateDiagram:
    """The diagram; `command` is called with the transition that was clicked."""

    def __init__(self, command: Callable[[Transition], Awaitable[None]]):
        self._rows = transitions()
        # where several commands have one number, the first of the standard is offered
        self._commands = {row.number: row for row in reversed(self._rows)
                          if row.controlword is not None}
        self._boxes: dict[State, Tag] = {}
        self._arrows: dict[int, Tag] = {}
        with Tag(
            "svg", viewBox="0 0 560 492", role="img", aria_label="States of the device control"
        ).classes("diagram"):
            with Tag("defs"):
                for name in ("quiet", "ready"):
                    with Tag(
                        "marker", id=f"tip-{name}", viewBox="0 0 8 8", refX=7, refY=4,
                        markerWidth=7, markerHeight=7, orient="auto",
                    ):
                        Tag("path", d="M0 0 L8 4 L0 8 z").classes(f"tip-{name}")
            Tag("text", "any state", x=308, y=14).classes("arrow-from")
            for number, (path, (x, y)) in ARROWS.items():
                group = Tag("g", data_test=f"transition-{number}").classes("arrow")
                with group:
                    Tag("path", d=path).classes("arrow-line")
                    Tag("circle", cx=x, cy=y, r=11)
                    Tag("text", str(number), x=x, y=y + 4).classes("arrow-number")
                    if row := self._commands.get(number):
                        Tag("title", f"{number}: {row.command}")
                group.on("click", lambda _, n=number: self._click(n))
                self._arrows[number] = group
            for state, (x, y) in PLACES.items():
                box = Tag("g", data_test=f"state-{state.name.lower()}").classes("state")
                lit(box, "bad", state in (State.FAULT, State.FAULT_REACTION_ACTIVE))
                with box:
                    Tag("rect", x=x, y=y, width=WIDTH, height=HEIGHT, rx=8)
                    Tag(
                        "text", state.name.replace("_", " ").capitalize(),
                        x=x + WIDTH / 2, y=y + HEIGHT / 2 + 5,
                    )
                self._boxes[state] = box
        self._command = command
        self._state: State | None = None
        self._shown: int | None = None
        with div("possible"):
            self._buttons = {}
            for number, row in sorted(self._commands.items()):
                made = ui.button(color=None, on_click=lambda _, row=row: command(row))
                made.props(f"no-caps unelevated data-test=command-{number}").classes("btn next")
                with made, ui.element("span").classes("next-text"):
                    Tag("b", f"{row.number}")
                    Tag("span", row.command)
                    Tag("code", f"{row.controlword:04X}h")
                made.set_visibility(False)
                self._buttons[number] = made

    async def _click(self, number: int) -> None:
        row = self._commands.get(number)
        if row is not None and row.source is self._state:
            await self._command(row)

    def show(self, state: int) -> None:
        """Show the present state; -1 if it is unknown."""
        if state == self._shown:
            return
        self._shown = state
        self._state = State(state) if state >= 0 else None
        for other, box in self._boxes.items():
            lit(box, "now", other is self._state)
        numbers = {n for n, row in self._commands.items() if row.source is self._state}
        for number, arrow in self._arrows.items():
            lit(arrow, "ready", number in numbers)
        for number, made in self._buttons.items():
            made.set_visibility(number in numbers)
