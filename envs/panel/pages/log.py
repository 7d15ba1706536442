"""Log: each command, refusal, fault and stop, with time, reason and remedy."""

from nicegui import ui

from ..log import KINDS, Event
from .desk import Desk
from .widgets import box, button, card, div, note, table

SHOWN = 200  # rows
ALL = "everything"
COLUMNS = ("time", "kind", "by", "event", "remedy")


class LogPage:
    """Page with the log of events."""

    name, title, icon = "log", "Log", "receipt_long"

    def __init__(self, desk: Desk):
        self.desk = desk
        self._last: tuple[int, str] = (-1, "")
        with card("Log", "log"):
            with div("cluster"):
                self.kind = box(ui.select([ALL, *KINDS], value=ALL, label="Show"), "log-kind", "")
                ui.space()
                button("CSV", self._csv, "log-csv")
            self.table = table(COLUMNS, "number", "events").classes("events")
            note(f"The latest {SHOWN} events, newest first; the CSV file contains all of them. "
                 "Times are seconds of machine time since the panel started.")

    async def _csv(self) -> None:
        text = await self.desk.ask(lambda session: session.log.csv())
        ui.download.content(text.encode(), "log.csv", "text/csv")

    def show(self) -> None:
        """Show the newest events."""
        events, kind = self.desk.bench.log.events, str(self.kind.value)
        now = (events[-1].number if events else 0, kind)
        if now == self._last:
            return
        self._last = now
        chosen = [event for event in events if kind in (ALL, event.kind)]
        self.table.rows = [_row(event) for event in reversed(chosen[-SHOWN:])]


def _row(event: Event) -> dict[str, str | int]:
    return {"number": event.number, "time": f"{event.time:.3f} s", "kind": event.kind,
            "by": event.window, "event": event.text, "remedy": event.remedy}
