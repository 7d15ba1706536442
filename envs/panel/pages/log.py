"""Log: each command, refusal, fault and stop, with time, reason and remedy."""

from nicegui import ui

from ..log import KINDS, Event
from .desk import Desk
from .widgets import button, card

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
            with ui.element("div").classes("cluster"):
                self.kind = ui.select([ALL, *KINDS], value=ALL, label="Show")
                self.kind.props("dense outlined data-test=log-kind").classes("entry")
                ui.space()
                button("CSV", self._csv, "log-csv")
            self.table = ui.table(
                columns=[{"name": n, "label": n, "field": n, "align": "left"} for n in COLUMNS],
                rows=[], row_key="number", pagination=0,
            )
            self.table.props("dense flat wrap-cells hide-bottom data-test=events").classes("events")
            ui.label(
                f"The latest {SHOWN} events, newest first; the file has all of them. Times are "
                "seconds of machine time since the panel started."
            ).classes("prose quiet")

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
