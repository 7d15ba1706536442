"""The display of a serving command: a status line while it runs, figures at its end."""

import time
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

STYLE = {"OPERATION_ENABLED": "green", "FAULT": "red", "FAULT_REACTION_ACTIVE": "red"}
AL_STATES = {1: "INIT", 2: "PRE_OP", 3: "BOOT", 4: "SAFE_OP", 8: "OP"}


def of(server: Any) -> "Line | Slaves":
    """The display for a `Server`, a `LockStep` or an `EtherCatServer`."""
    return Slaves(server) if hasattr(server, "ports") else Line(server)


class Line:
    """The nodes of a CAN bus: states, frames per second, the last SDO request."""

    def __init__(self, server: Any):
        from ...drive.canopen.decode import Decoder

        self._server = server
        self._decoders = {n.node_id: Decoder(n.drive.model, [n.node_id]) for n in server.nodes}
        self._then, self._count = 0.0, 0

    def text(self, now: float) -> Text:
        """The status line at the time `now` (s)."""
        from ...drive.canopen.frame import Base

        line = Text(no_wrap=True, overflow="ellipsis")
        for node in self._server.nodes:
            drive = node.drive
            style = STYLE.get(drive.state.name, "")
            line.append(f"{node.node_id} {drive.state.name}", style)
            mode = drive.model.mode_name(drive.mode)
            line.append(f" {drive.fault or mode}  " if drive.fault or mode else "  ")
        s = getattr(self._server, "statistics", None)
        if s is None:  # in lock-step the master determines the time
            return line.append(f"{1e-6 * self._server.time:.3f} s")
        frames = s.received + s.sent
        rate = (frames - self._count) / max(now - self._then, 1e-9) if self._then else 0.0
        self._then, self._count = now, frames
        line.append(f"{rate:.0f} frames/s")
        if s.missed:
            line.append(f", {s.missed} deadlines missed", "yellow")
        if s.last_sdo is not None:
            node_id = s.last_sdo.id - Base.SDO_REQUEST
            if node_id in self._decoders:
                line.append(f"  {self._decoders[node_id].decode(s.last_sdo)}")
        return line

    def now(self) -> RenderableType:
        """The present display."""
        return self.text(time.monotonic())

    def end(self) -> str:
        """The figures at the end."""
        s = getattr(self._server, "statistics", None)
        if s is None:
            return f"{1e-6 * self._server.time:g} s have passed with the SYNCs of the master"
        bus = self._server.adapter
        trouble = f", {bus.failed} bus errors, {bus.lost} frames lost" if bus.failed else ""
        return (
            f"{s.received} frames received, {s.sent} sent, {s.cycles} position cycles, "
            f"{s.missed} deadlines missed{trouble}"
        )


class Slaves:
    """The slaves of an EtherCAT segment: cycles per second, AL states and device control."""

    def __init__(self, server: Any):
        self._server, self._before = server, (server.now, 0)

    def now(self) -> RenderableType:
        """The present display."""
        bus, now = self._server.bus, self._server.now
        s, (then, cycles) = bus.statistics, self._before
        rate = (s.cycles - cycles) / max(now - then, 1) * 1e9
        self._before = now, s.cycles
        table = Table(
            title=f"{s.cycles} cycles, {rate:.0f}/s, working counter "
            f"{self._server.working_counter}, {s.missed} missed"
        )
        for column in ("slave", "drive", "AL state", "status", "device control"):
            table.add_column(column)
        for i, station in enumerate(bus.segment.stations):
            pdi = bus.segment.pdis[i]
            status, code = pdi.get(0x0130, 2), pdi.get(0x0134, 2)
            table.add_row(
                str(i), station.drive.model.name, AL_STATES.get(status & 0x0F, f"{status:02X}h"),
                f"{code:04X}h" if status & 0x10 else "", station.drive.state.name,
            )
        return table

    def end(self) -> str:
        """The figures at the end."""
        s = self._server.bus.statistics
        return (
            f"{s.frames} frames received, {s.answered} answered, {s.cycles} cycles of process "
            f"data, {s.missed} deadlines missed"
        )
