"""Building blocks of the pages: cards, fields, readouts, tables, buttons, questions."""

import math
from collections.abc import Awaitable, Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from nicegui import ui
from nicegui.element import Element

from ....drive.diagrams import Bit
from ....drive.model.rows import Object
from .. import entry
from ..guard import LARGEST
from .desk import over, refuse

DARK_OR_LIGHT = "icon=contrast aria-label='Dark or light'"  # properties of that button
STYLE = Path(__file__).parents[1] / "static" / "panel.css"
_PENDING: dict[str, dict[str, str]] = {}
Made = TypeVar("Made", bound=Element)


def styled(dark: bool = False) -> ui.dark_mode:
    """Give a tab the style of the panel; -> its theme."""
    ui.add_css(STYLE.read_text(encoding="utf-8"))
    return ui.dark_mode(dark)


def named(made: Made, test: str) -> Made:
    """Give an element the name by which tests find it; an empty name changes nothing."""
    if test:
        made._props["data-test"] = test  # not by props(): the name may contain what a user typed
    return made


def lit(made: Element, name: str, on: bool) -> None:
    """Add or remove a CSS class."""
    made.classes(**{"add" if on else "remove": name})


def div(classes: str, test: str = "") -> ui.element:
    """A plain container."""
    return named(ui.element("div").classes(classes), test)


def note(text: str, test: str = "", kind: str = "prose quiet") -> ui.label:
    """A text that explains or reports something; `kind` is its CSS classes."""
    return named(ui.label(text).classes(kind), test)


def card(title: str, test: str = "") -> ui.column:
    """A framed part of a page with its title."""
    with named(ui.element("section").classes("card"), test):
        ui.label(title).classes("card-title")
        return ui.column().classes("card-body")


def box(made: Made, test: str = "", kind: str = "grow", props: str = "") -> Made:
    """Give a list or a text field the look of the panel; `kind` is grow, wide or empty."""
    made.props(f"dense outlined {props}").classes(f"entry {kind}")
    return named(made, test)


def toggle(
    options: dict | list, value: Any, change: Callable[..., Any], test: str, props: str = ""
) -> ui.toggle:
    """A choice between a few values."""
    made = ui.toggle(options, value=value, on_change=change)
    # white text on the accent would not be legible in the dark theme; the text has our colour
    return named(made.props(f"no-caps unelevated toggle-text-color=ours {props}"), test)


def table(columns: Iterable[str], key: str, test: str) -> ui.table:
    """A table without pages, each column under its own name."""
    made = ui.table(
        columns=[{"name": n, "label": n, "field": n, "align": "left"} for n in columns],
        rows=[], row_key=key, pagination=0,
    )
    return named(made.props("dense flat wrap-cells hide-bottom"), test)


class Tag(Element):
    """Any HTML or SVG tag with attributes and text."""

    def __init__(self, tag: str, text: str = "", **attributes: Any):
        super().__init__(tag)
        for name, value in attributes.items():
            self._props[name.rstrip("_").replace("_", "-")] = value
        if text:
            self._text = text

    def say(self, text: str) -> None:
        """Set the text."""
        if text != self._text:
            self._text = text
            self.update()


def live(label: ui.label, text: str) -> None:
    """Set the text of a label that changes with each picture.

    The text is sent to the browser with the next `pending`. A regular update of the element would
    make the browser visit all elements of all pages, which takes longer than a picture lasts.
    """
    if text == label._text:
        return
    if not (text and label._text):  # there has to be a text node
        label.set_text(text)
        return
    label._text = text
    _PENDING.setdefault(label.client.id, {})[label.html_id] = text


def pending(client_id: str) -> dict[str, str]:
    """Return and clear the texts not yet sent to this browser, by the id of their element."""
    return _PENDING.pop(client_id, {})


class Readout:
    """A name, a live number, a unit."""

    def __init__(self, name: str, unit: str = "", test: str = ""):
        with div("readout"):
            ui.label(name).classes("readout-name")
            with div("readout-line"):
                self._value = note("–", test, "readout-value")
                self._unit = ui.label(unit).classes("readout-unit")

    def show(self, value: float | str, unit: str | None = None) -> None:
        """Show the present value."""
        live(self._value, value if isinstance(value, str) else formatted(value))
        if unit is not None:
            self._unit.set_text(unit)


def formatted(value: float, digits: int = 3) -> str:
    """Format a number with constant width."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{digits}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("-")


def hexadecimal(value: object, row: Object) -> str:
    """Format an integer of an object like ``0B54h``; an empty text for other types."""
    try:
        number = int(str(value))
    except ValueError:
        return ""
    if row.real or not row.size:
        return ""
    return f"{number & (1 << 8 * row.size) - 1:0{2 * row.size}X}h"


class Entry:
    """A field for a number. An invalid number is explained beside it, and nothing is sent.

    Args:
        name: label of the field; empty if `spoken` replaces it.
        unit: unit of the number.
        low, high: range.
        value: initial value.
        send: called with the number on Enter; returns the reason of a refusal.
        whole: whether the number has to be an integer.
        test: name for tests.
        spoken: label for screen readers. Such a field empties itself when its number was accepted.
    """

    def __init__(
        self, name: str, unit: str = "", low: float = -math.inf, high: float = math.inf,
        value: float | None = None, send: Callable[[float], Awaitable[Any]] | None = None, *,
        whole: bool = False, test: str = "", spoken: str = "",
    ):
        self.low, self.high, self.whole = low, high, whole
        self._send, self._empties = send, bool(spoken)
        text = "" if value is None else f"{value:g}"
        self.field = box(
            ui.input(name, value=text, validation=self._wrong), test, "says",
            "hide-bottom-space stack-label autocomplete=off",
        )
        self.field.without_auto_validation()
        self.show_unit(unit)
        if spoken:
            self.field.props(f'aria-label="{spoken}"')
        self.field.on("keydown.enter", self.apply)
        self.field.on_value_change(lambda: self.field.validate())

    def show_unit(self, unit: str) -> None:
        """Change the unit of the number."""
        self.unit = unit
        if unit:
            self.field.props(f'suffix="{unit}"')

    def _parsed(self, text: str) -> float:
        return entry.number(text, self.low, self.high, self.unit, whole=self.whole)

    def _wrong(self, text: str) -> str | None:
        try:
            self._parsed(text)
        except ValueError as error:
            return str(error)
        return None

    def number(self) -> float | None:
        """The number; None if it is invalid, which is then explained beside the field."""
        return self._parsed(self.field.value) if self.field.validate() else None

    def refuse(self, words: Any) -> None:
        """Show the reason of a refusal beside the field and the remedy in a message.

        A motion that another command has ended needs no message, and the shell reports faults.
        """
        if not words or over(words):
            return
        reason, _, remedy = str(words).partition("; ")
        self.field.error = reason
        if remedy and not reason.startswith("FAULT"):
            refuse(words)

    def empty(self) -> None:
        """Remove the number and the message beside it."""
        self.field.value, self.field.error = "", None

    async def apply(self) -> None:
        """Send the number."""
        value = self.number()
        if value is None or self._send is None:
            return
        words = await self._send(value)
        if not words and self._empties:
            self.empty()
        self.refuse(words)


class Bits:
    """The sixteen bits of a word by name, one per row; `click` is called with the mask of a bit."""

    def __init__(self, name: str, click: Callable[[int], Any], test: str):
        self._names: tuple[str, ...] = ()
        with div("bits", test):
            with div("bits-head"):
                ui.label(name).classes("bits-name")
                self._word = note("0000h", f"{test}-word", "bits-word")
            self._rows = []
            for n in reversed(range(16)):
                row = Tag("button", type="button", data_bit=n, data_test=f"{test}-{n}")
                row.classes("bit").on("click", lambda _, mask=1 << n: click(mask))
                with row:
                    Tag("span", f"{n}").classes("bit-number")
                    lamp = Tag("span", "0").classes("bit-lamp")
                    label = Tag("span", "").classes("bit-name")
                self._rows.append((n, row, lamp, label))
        self._shown = -1

    def show(self, word: int, bits: Sequence[Bit]) -> None:
        """Show the present word with the names of its bits."""
        names = tuple(bit.name for bit in bits)
        if word == self._shown and names == self._names:
            return
        changed = word ^ self._shown if self._shown >= 0 else 0xFFFF
        for n, row, lamp, label in self._rows:
            if changed >> n & 1:
                on = bool(word >> n & 1)
                lit(row, "on", on)
                row._props["aria-pressed"] = str(on).lower()
                lamp.say(str(int(on)))
                row.update()
            if names != self._names:
                label.say(bits[n].name.replace("_", " "))
                lit(row, "quiet", bits[n].name.startswith(("bit ", "manufacturer")))
                if bits[n].meaning:
                    row._props["title"] = bits[n].meaning
        self._word.set_text(f"{word:04X}h")
        self._shown, self._names = word, names


def button(
    text: str, click: Callable[..., Any] | None, test: str = "", kind: str = "", props: str = ""
) -> ui.button:
    """A button of the panel; `kind` is main, stop, icon or empty."""
    made = ui.button(text, on_click=click, color=None).props(f"no-caps unelevated {props}")
    return named(made.classes(f"btn {kind}"), test)


def file_button(text: str, load: Callable[..., Any], test: str) -> ui.button:
    """A button that asks for a file and calls `load` with it; Quasar's own box is hidden."""
    loader = ui.upload(auto_upload=True, max_file_size=LARGEST, on_upload=load,
                       on_rejected=lambda: ui.notify(f"{text}: the file is too large"))
    named(loader, test).classes("out-of-sight")
    return button(text, lambda: loader.run_method("pickFiles"), f"{test}-pick")


def two_sided(
    text: str, press: Callable[[str], Any], test: str = "", kind: str = "", props: str = ""
) -> ui.button:
    """A button with two texts; `press` is called with the text shown when it was pressed.

    The text may have changed since, and the user must not trigger the other action.
    """
    made = button(text, None, test, kind, props)
    shown = "(event) => emit(event.currentTarget.textContent.trim())"
    return made.on("click", lambda event: press(event.args), js_handler=shown)


async def sure(*question: str, yes: str = "Yes", no: str = "No") -> bool:
    """Ask a question in a dialog; False as well if the page has gone meanwhile."""
    with ui.dialog() as dialog, ui.card():
        for line in question:
            ui.label(line)
        with div("cluster"):
            button(yes, lambda: dialog.submit(True), "yes", "main")
            button(no, lambda: dialog.submit(False), "no")
    answer = await dialog
    if dialog.is_deleted or dialog.client.id not in dialog.client.instances:
        return False
    dialog.delete()
    return bool(answer)
