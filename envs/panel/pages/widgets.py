"""Small parts of the pages: cards, readouts, entries that refuse in words, bits."""

import math
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from nicegui import ui
from nicegui.element import Element

from ....drive.diagrams import Bit
from ....drive.model.rows import Object
from .. import entry
from ..guard import LARGEST
from .desk import refuse

# white text on the accent is not to be read in the dark theme; the text has the colour of ours
TOGGLE = "no-caps unelevated toggle-text-color=ours"
_PENDING: dict[str, dict[str, str]] = {}


def card(title: str, name: str = "") -> ui.column:
    """A framed part of a page with its title."""
    with ui.element("section").classes("card") as frame:
        if name:
            frame.props(f"data-test={name}")
        ui.label(title).classes("card-title")
        return ui.column().classes("card-body")


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

    def lit(self, name: str, on: bool) -> None:
        """Add or remove a CSS class."""
        if (name in self._classes) != on:
            self.classes(name) if on else self.classes(remove=name)


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
        with ui.element("div").classes("readout"):
            ui.label(name).classes("readout-name")
            with ui.element("div").classes("readout-line"):
                self._value = ui.label("–").classes("readout-value")
                if test:
                    self._value.props(f"data-test={test}")
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
        name: label of the field.
        unit: unit of the number.
        low, high: range.
        value: initial value.
        send: called with the number on Enter; returns the reason of a refusal.
        whole: whether the number has to be an integer.
        test: name for tests.
        spoken: label for screen readers if no name is shown.
    """

    def __init__(
        self,
        name: str,
        unit: str = "",
        low: float = -math.inf,
        high: float = math.inf,
        value: float | None = None,
        send: Callable[[float], Awaitable[Any]] | None = None,
        *,
        whole: bool = False,
        test: str = "",
        spoken: str = "",
    ):
        self.unit, self.low, self.high, self.whole = unit, low, high, whole
        self._send = send
        self.field = (
            ui.input(name, value="" if value is None else f"{value:g}", validation=self._wrong)
            .props("dense outlined hide-bottom-space stack-label autocomplete=off")
            .classes("entry says")
        )
        self.field.without_auto_validation()
        if unit:
            self.field.props(f'suffix="{unit}"')
        if spoken:
            self.field.props(f'aria-label="{spoken}"')
        if test:
            self.field.props(f"data-test={test}")
        self.field.on("keydown.enter", self.apply)
        self.field.on_value_change(lambda: self.field.validate())

    def _wrong(self, text: str) -> str | None:
        try:
            entry.number(text, self.low, self.high, self.unit, whole=self.whole)
        except ValueError as error:
            return str(error)
        return None

    def number(self) -> float | None:
        """The number; None if it is invalid, which is then shown beside the field."""
        if not self.field.validate():
            return None
        return entry.number(self.field.value, self.low, self.high, self.unit, whole=self.whole)

    def refuse(self, words: str) -> None:
        """Say why the number was refused: the reason beside the field, and what to do in a message.

        A fault and its remedy are told by the shell, whatever has caused it.
        """
        reason, _, remedy = words.partition("; ")
        self.field.error = reason
        if remedy and not reason.startswith("FAULT"):
            refuse(words)

    def send_to(self, send: Callable[[float], Awaitable[Any]]) -> None:
        """Set the function that is called with the number on Enter."""
        self._send = send

    async def apply(self) -> None:
        """Send the number."""
        value = self.number()
        if value is None or self._send is None:
            return
        words = await self._send(value)
        if words:
            self.refuse(str(words))


class Bits:
    """The sixteen bits of a word by name, one per row; `click` is called with the mask of a bit."""

    def __init__(self, name: str, click: Callable[[int], Any], test: str):
        self._names: tuple[str, ...] = ()
        with ui.element("div").classes("bits").props(f"data-test={test}"):
            with ui.element("div").classes("bits-head"):
                ui.label(name).classes("bits-name")
                self._word = ui.label("0000h").classes("bits-word").props(f"data-test={test}-word")
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
                row.lit("on", on)
                row._props["aria-pressed"] = str(on).lower()
                lamp.say(str(int(on)))
                row.update()
            if names != self._names:
                label.say(bits[n].name.replace("_", " "))
                row.lit("quiet", bits[n].name.startswith(("bit ", "manufacturer")))
                if bits[n].meaning:
                    row._props["title"] = bits[n].meaning
        self._word.set_text(f"{word:04X}h")
        self._shown, self._names = word, names


def button(
    text: str, click: Callable[..., Any] | None, test: str = "", kind: str = ""
) -> ui.button:
    """A button of the panel; `kind` is main, stop or quiet."""
    made = ui.button(text, on_click=click, color=None).props("no-caps unelevated")
    made.classes(f"btn {kind}")
    if test:
        made._props["data-test"] = test  # it may be what somebody has typed
    return made


def file_button(text: str, load: Callable[..., Any], test: str) -> ui.button:
    """A button that asks for a file and calls `load` with it; Quasar's own box is hidden."""
    loader = ui.upload(auto_upload=True, max_file_size=LARGEST, on_upload=load,
                       on_rejected=lambda: ui.notify(f"{text}: the file is too large"))
    loader.props(f"data-test={test}").classes("out-of-sight")
    return button(text, lambda: loader.run_method("pickFiles"), f"{test}-pick")


def two_sided(text: str, press: Callable[[str], Any], test: str = "", kind: str = "") -> ui.button:
    """A button with two texts; `press` is called with the text shown when it was pressed.

    The text may have changed since, and the user must not trigger the other action.
    """
    made = button(text, None, test, kind)
    shown = "(event) => emit(event.currentTarget.textContent.trim())"
    return made.on("click", lambda event: press(event.args), js_handler=shown)


async def answer_to(dialog: ui.dialog) -> Any:
    """What somebody says to a dialog, which goes then; None where the page has gone meanwhile."""
    said = await dialog
    if not dialog.is_deleted and dialog.client.id in dialog.client.instances:
        dialog.delete()
        return said
    return None
