"""Compares parameters of the drive with factory and file, and writes them back on request."""

from nicegui import events

from ....drive.model.rows import Object
from ..comparison import Difference, compare, of_file, write_back
from .desk import Desk, Refusal, refuse
from .widgets import button, card, div, file_button, hexadecimal, note, sure, table

FACTORY, FILE = "factory", "file"
COLUMNS = ("object", "drive", FACTORY, FILE)


class CompareCard:
    """Card of the objects page that compares parameter sets."""

    def __init__(self, desk: Desk):
        self.desk = desk
        self.file: dict[str, float] | None = None
        self.found: list[Difference] = []
        with card("Compare parameters", "compare-parameters"):
            self.said = note("Compares the drive with the factory and a file.", "compared")
            with div("cluster"):
                button("Compare", self._compare, "compare", "main")
                file_button("With a file …", self._load, "compare-file")
                button("Write the factory's …", lambda: self._ask(FACTORY), "write-factory")
                button("Write the file's …", lambda: self._ask(FILE), "write-file")
            self.table = table(COLUMNS, "object", "differences")
            self.table.set_visibility(False)

    async def _load(self, event: events.UploadEventArguments) -> None:
        try:
            model = self.desk.bench.model(self.desk.axis).name
            self.file = of_file(await event.file.read(), model)
        except ValueError as error:
            self.file = None
            refuse(f"{event.file.name}: {error}")
            return
        await self._compare()

    async def _compare(self) -> None:
        axis, file = self.desk.axis, self.file
        found = await self.desk.tried(self.desk.clock.ask(lambda s: compare(s, axis, file)))
        if isinstance(found, Refusal):
            refuse(found)
            return
        self.found = found
        self.said.set_text(
            f"{len(found)} parameters differ." if found else "All parameters are the same."
        )
        self.table.rows = [_row(each) for each in found]
        self.table.set_visibility(bool(found))

    async def _ask(self, source: str) -> None:
        """Show what would be written, and write it if the user agrees."""
        await self._compare()
        wanted: dict[Object, float] = {
            each.row: value for each in self.found
            if (value := getattr(each, source)) is not None and value != each.node
        }
        if not wanted:
            refuse(f"nothing differs from the {source}" if source == FACTORY or self.file
                   else "load a file first")
            return
        names = ", ".join(row.name for row in list(wanted)[:8]) + " …" * (len(wanted) > 8)
        question = f"Write {len(wanted)} values of the {source} to the drive?"
        if not await sure(question, names, yes="Write", no="Leave it"):
            return
        axis = self.desk.axis
        wrong = await self.desk.command(lambda session: write_back(session, axis, wanted))
        refuse(wrong if isinstance(wrong, str) else "; ".join(wrong))
        await self._compare()


def _row(each: Difference) -> dict[str, str]:
    def shown(value: float | None) -> str:
        return "–" if value is None else f"{value:.10g} {hexadecimal(value, each.row)}".strip()

    return {
        "object": f"{each.row.address} {each.row.name.replace('_', ' ')}",
        "drive": shown(each.node), FACTORY: shown(each.factory), FILE: shown(each.file),
    }
