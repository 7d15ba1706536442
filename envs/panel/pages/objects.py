"""Objects: the whole dictionary with live values, a field to write, parameter sets."""

from nicegui import events, ui

from ....drive.model.rows import Object
from .comparing import CompareCard
from .desk import Desk
from .widgets import Entry, button, card, file_button, hexadecimal

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
            self.rows[f"{row.index:04X}h:{row.subindex:02X}"] = row
        self._count = 0
        self._values: dict[str, str] = {}
        self.chosen: str | None = None
        with ui.element("div").classes("columns objects-columns"):
            with card("Object dictionary"):
                with ui.element("div").classes("cluster"):
                    self.search = (
                        ui.input("Search by name, index or unit", on_change=lambda: self._filter())
                        .props("dense outlined clearable data-test=search")
                        .classes("entry grow")
                    )
                    self.search.on("keydown.enter", self._choose_first)
                    self.found = ui.label("").classes("quiet")
                columns = [
                    {"name": n, "field": n, "label": text, "align": side, "sortable": n != "value"}
                    for n, text, side in COLUMNS
                ]
                self.table = ui.table(
                    rows=[], columns=columns, row_key="address", pagination=0
                ).classes("objects").props(
                    'virtual-scroll dense flat hide-bottom data-test=objects '
                    'virtual-scroll-sticky-size-start=32'
                )
                self.table.on("rowClick", self._choose, [[], ["address"], []])
            with ui.element("div").classes("stack"):
                with card("Object", "object-card"):
                    self.head = ui.label("Choose an object.").classes("verdict")
                    self.head.props("data-test=object")
                    self.about = ui.label("").classes("prose quiet")
                    self.live = ui.label("").classes("readout-value").props("data-test=live")
                    self.hexadecimal = ui.label("").classes("mono quiet").props("data-test=hex")
                    self.entry = Entry("New value", send=self._write, test="object-value")
                    self.write = button("Write", lambda: self.entry.apply(), "write", "main")
                    self.entry.field.set_visibility(False)
                    self.write.set_visibility(False)
                if desk.bench.commands:
                    CompareCard(desk)
                with card("Parameter set"):
                    self.loaded = ui.label("").classes("prose").props("data-test=loaded")
                    if why := desk.bench.absent.get("parameters"):
                        self.loaded.set_text(why)
                        self.loaded.classes("quiet")
                        self._filter()
                        return
                    ui.label(
                        "All storable objects as one file, with the model and a checksum."
                    ).classes("prose quiet")
                    button("Save to a file", self._save, "save-parameters")
                    file_button("Load a file …", self._load, "load-parameters")
                    self.loaded.move(target_index=-1)
        self._filter()

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
        row = self.rows[self.chosen]
        self.head.set_text(f"{self.chosen} {row.name.replace('_', ' ')}")
        default = f"default {row.default}" if row.format else ""
        parts = (row.data_type, row.access, row.unit, _range(row), default,
                 "stored by 1010h" if row.storable else "", row.section, row.note)
        self.about.set_text(" · ".join(part for part in parts if part))
        writable = row.access not in ("ro", "const") and bool(row.format)
        self.entry.low, self.entry.high = row.minimum, row.maximum
        self.entry.unit, self.entry.whole = row.unit, not row.real
        self.entry.field.value, self.entry.field.error = "", None
        self.entry.field.set_visibility(writable)
        self.write.set_visibility(writable)

    async def _write(self, value: float) -> str:
        axis = self.desk.axis
        if self.chosen is None:
            return "choose an object first"
        row = self.rows[self.chosen]
        words = await self.desk.command(lambda s: s.command(axis, row.index, row.subindex, value))
        if not words:
            self.entry.field.value, self.entry.field.error = "", None
            self._count = 0  # the table shows it with the next picture
        return str(words or "")

    async def _save(self) -> None:
        axis = self.desk.axis
        content = await self.desk.ask(lambda session: session.save_parameters(axis))
        model = self.desk.machine.drives[axis].model.name
        ui.download.content(content, f"{model}_{axis}.json", "application/json")

    async def _load(self, event: events.UploadEventArguments) -> None:
        axis, content = self.desk.axis, await event.file.read()
        words = await self.desk.motion(lambda session: session.load_parameters(axis, content))
        self.loaded.set_text(str(words) if words else f"{event.file.name} is in force.")
        self.loaded.classes(**({"add": "bad"} if words else {"remove": "bad"}))

    async def show(self) -> None:
        """The present; all values now and then, that of the chosen object always."""
        axis = self.desk.axis
        if self._count % EVERY == 0:
            shown = [*self.table.rows]
            rows = [self.rows[row["address"]] for row in shown]
            texts = await self.desk.ask(lambda bench: bench.texts(axis, rows))
            changed = False
            for row, text in zip(shown, texts, strict=True):
                changed = changed or row["value"] != text
                row["value"] = self._values[row["address"]] = text
            if shown != [*self.table.rows]:  # somebody has searched meanwhile
                return
            if changed:
                self.table.update()
        elif chosen := self.chosen:
            its = self.rows[chosen]
            (self._values[chosen],) = await self.desk.ask(lambda s: s.texts(axis, [its]))
        self._count += 1
        if self.chosen:
            its = self.rows[self.chosen]
            value = self._values.get(self.chosen, "")
            self.live.set_text(f"{value} {its.unit}".strip())
            self.hexadecimal.set_text(hexadecimal(value, its))
