"""Objects: the whole dictionary with live values, a field to write, parameter sets."""

from typing import Any

from nicegui import events, ui

from ....drive.model.rows import Object
from .comparing import CompareCard
from .desk import Desk
from .widgets import Entry, box, button, card, div, file_button, hexadecimal, lit, note

EVERY = 12  # pictures between two readings of all values
COLUMNS = (
    ("address", "Object", "left"), ("name", "Name", "left"), ("value", "Value", "right"),
    ("unit", "Unit", "left"), ("range", "Range", "left"), ("access", "Access", "left"),
)


def _range(row: Object) -> str:
    if row.allowed is not None:
        return "one of " + ", ".join(map(str, sorted(row.allowed)[:12]))
    if not row.format or row.access in ("ro", "const"):
        return ""
    return f"{row.minimum:.0f}..{row.maximum:.0f}"


class ObjectsPage:
    """The object browser."""

    name, title, icon = "objects", "Objects", "list_alt"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.rows: dict[str, Object] = {}
        for row in sorted(desk.bench.rows(desk.axis), key=lambda row: (row.index, row.subindex)):
            self.rows[row.address] = row
        self._count = 0
        self._values: dict[str, str] = {}
        self.chosen: str | None = None
        with div("columns objects-columns"):
            with card("Object dictionary"):
                self._dictionary()
            with div("stack"):
                self._object()
                if desk.bench.commands:
                    CompareCard(desk)
                self._parameters()
        self._filter()

    def _dictionary(self) -> None:
        with div("cluster"):
            self.search = box(
                ui.input("Search by name, index or unit", on_change=self._filter), "search",
                props="clearable",
            )
            self.search.on("keydown.enter", self._choose_first)
            self.found = note("", kind="quiet")
        columns = [
            {"name": n, "field": n, "label": text, "align": side, "sortable": n != "value"}
            for n, text, side in COLUMNS
        ]
        self.table = ui.table(rows=[], columns=columns, row_key="address", pagination=0)
        self.table.classes("objects").props(
            "virtual-scroll dense flat hide-bottom data-test=objects "
            "virtual-scroll-sticky-size-start=32"
        )
        self.table.on("rowClick", self._choose, [[], ["address"], []])

    def _object(self) -> None:
        with card("Object", "object-card"):
            self.head = note("Choose an object.", "object", "verdict")
            self.about = note("")
            self.live = note("", "live", "readout-value")
            self.hexadecimal = note("", "hex", "mono quiet")
            self.entry = Entry("New value", send=self._write, test="object-value")
            self.write = button("Write", lambda: self.entry.apply(), "write", "main")
            self.entry.field.set_visibility(False)
            self.write.set_visibility(False)

    def _parameters(self) -> None:
        with card("Parameter set"):
            if why := self.desk.bench.absent.get("parameters"):
                note(why, "loaded")
                return
            note("All storable objects as one file, with the model and a checksum.")
            button("Save to a file", self._save, "save-parameters")
            file_button("Load a file …", self._load, "load-parameters")
            self.loaded = note("", "loaded", "prose")

    def _filter(self) -> None:
        words = str(self.search.value or "").lower().split()
        rows = []
        for address, row in self.rows.items():
            text = f"{address} {row.name} {row.name.replace('_', ' ')} {row.unit}".lower()
            if all(word in text for word in words):
                rows.append(
                    {
                        "address": address, "name": row.name.replace("_", " "), "unit": row.unit,
                        "range": _range(row), "access": row.access,
                        "value": self._values.get(address, ""),
                    }
                )
        self.table.rows = rows
        self.found.set_text(f"{len(rows)} of {len(self.rows)}")
        self._count = 0

    def _choose(self, event: events.GenericEventArguments) -> None:
        address = str(event.args[1]["address"])
        if address in self.rows:
            self._take(address)

    def _choose_first(self) -> None:
        if self.table.rows:
            self._take(self.table.rows[0]["address"])

    def _take(self, address: str) -> None:
        self.chosen = address
        row = self.rows[address]
        self.head.set_text(f"{address} {row.name.replace('_', ' ')}")
        default = f"default {row.default}" if row.format else ""
        parts = (row.data_type, row.access, row.unit, _range(row), default,
                 "stored by 1010h" if row.storable else "", row.section, row.note)
        self.about.set_text(" · ".join(part for part in parts if part))
        writable = row.access not in ("ro", "const") and bool(row.format)
        self.entry.low, self.entry.high = row.minimum, row.maximum
        self.entry.unit, self.entry.whole = row.unit, not row.real
        self.entry.empty()
        self.entry.field.set_visibility(writable)
        self.write.set_visibility(writable)

    async def _write(self, value: float) -> Any:
        axis = self.desk.axis
        if self.chosen is None:
            return "choose an object first"
        row = self.rows[self.chosen]
        words = await self.desk.command(lambda s: s.command(axis, row.index, row.subindex, value))
        if not words:
            self.entry.empty()
            self._count = 0  # the table shows it with the next picture
        return words

    async def _save(self) -> None:
        axis = self.desk.axis
        content = await self.desk.ask(lambda session: session.save_parameters(axis))
        model = self.desk.bench.model(axis).name
        ui.download.content(content, f"{model}_{axis}.json", "application/json")

    async def _load(self, event: events.UploadEventArguments) -> None:
        axis, content = self.desk.axis, await event.file.read()
        words = await self.desk.motion(lambda session: session.load_parameters(axis, content))
        self.loaded.set_text(str(words) if words else f"{event.file.name} is in force.")
        lit(self.loaded, "bad", bool(words))

    def opened(self) -> None:
        """Measure the table, whose rows were counted while it was hidden and had no height."""
        self.table.run_method("resetVirtualScroll")

    async def show(self) -> None:
        """Show the present values: of all objects now and then, of the chosen object always."""
        axis = self.desk.axis
        if self._count % EVERY == 0:
            shown = [*self.table.rows]
            rows = [self.rows[line["address"]] for line in shown]
            texts = await self.desk.ask(lambda bench: bench.texts(axis, rows))
            changed = False
            for line, text in zip(shown, texts, strict=True):
                changed = changed or line["value"] != text
                line["value"] = self._values[line["address"]] = text
            if shown != [*self.table.rows]:  # the user has searched meanwhile
                return
            if changed:
                self.table.update()
        elif chosen := self.chosen:
            row = self.rows[chosen]
            (self._values[chosen],) = await self.desk.ask(lambda s: s.texts(axis, [row]))
        self._count += 1
        if self.chosen:
            row = self.rows[self.chosen]
            value = self._values.get(self.chosen, "")
            self.live.set_text(f"{value} {row.unit}".strip())
            self.hexadecimal.set_text(hexadecimal(value, row))
