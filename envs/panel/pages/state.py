"""State: the diagram, both words bit by bit, faults in words, the bytes of the process data."""

from nicegui import ui

from ....drive.diagrams import Transition, controlword_bits, statusword_bits
from ....drive.model.rows import Object
from .desk import Desk
from .state_diagram import StateDiagram
from .widgets import Bits, button, card, div, lit, note


class StatePage:
    """Page with state diagram, statusword, controlword and process data."""

    name, title, icon = "state", "State", "account_tree"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.own_modes = desk.bench.model(desk.axis).own_modes
        with div("columns state-columns"):
            with card("Device control · CiA 402", "diagram"):
                self.diagram = StateDiagram(self._transition)
            with div("stack"):
                with card("Words"), div("words"):
                    self.controlword = Bits("Controlword 6040h", self._toggle, "controlword")
                    self.statusword = Bits("Statusword 6041h", self._explain, "statusword")
                with div("columns halves"):
                    with card("Fault", "fault-card"):
                        self.fault = note("", "fault", "verdict")
                        self.remedy = note("", "remedy", "prose")
                        self.others = note("")
                        self.reset = button(
                            "Reset fault", lambda: desk.go("reset_fault"), "reset-fault", "main"
                        )
                    with card("Why refused"):
                        self.refused = note("", "refused", "prose")
                        self.limits = note("")
                with card("Process data"):
                    self.rpdo, self.tpdo = _Bytes("RPDO", "rpdo"), _Bytes("TPDO", "tpdo")

    async def _transition(self, row: Transition) -> None:
        if row.command == "fault reset":
            await self.desk.go("reset_fault")
        elif row.command == "quick stop":  # every window may
            await self.desk.halt("quick_stop", self.desk.axis)
        elif row.controlword is not None:
            await self._send(row.controlword)

    async def _toggle(self, mask: int) -> None:
        await self._send(self.desk.status["controlword"] ^ mask)

    async def _send(self, word: int) -> None:
        axis = self.desk.axis
        await self.desk.do(lambda session: session.control_word(axis, word))

    def _explain(self, mask: int) -> None:
        number = mask.bit_length() - 1
        bit = statusword_bits(self.desk.status["mode"], self.own_modes)[number]
        ui.notify(f"bit {number}, {bit.name.replace('_', ' ')}: {bit.meaning}")

    def show(self) -> None:
        """Show the present state."""
        seen, mode = self.desk.status, self.desk.status["mode"]
        self.diagram.show(seen["state"])
        self.controlword.show(seen["controlword"], controlword_bits(mode, self.own_modes))
        self.statusword.show(seen["statusword"], statusword_bits(mode, self.own_modes))
        self.fault.set_text(seen["fault"] or "No fault")
        lit(self.fault, "bad", bool(seen["fault"]))
        remedy = seen["remedy"]
        self.remedy.set_text(remedy[:1].upper() + remedy[1:])
        others = ", ".join(seen["faults"])
        self.others.set_text(f"also: {others}" if others else "")
        self.reset.set_visibility(bool(seen["fault"]))
        self.refused.set_text(seen["refused"] or "No command has been refused.")
        acting = ", ".join(seen["limits"])
        self.limits.set_text(f"Active limit: {acting}" if acting else "No limit is active.")
        bench, axis = self.desk.bench, self.desk.axis
        self.rpdo.show(seen["rpdo"], bench.mapped(axis, "rx"))
        self.tpdo.show(seen["tpdo"], bench.mapped(axis, "tx"))


class _Bytes:
    """A process image: the mapped objects with their bytes."""

    def __init__(self, name: str, test: str):
        with div("image", test):
            ui.label(name).classes("image-name")
            self._fields = div("image-fields")
        self._labels: list[tuple[int, int, ui.label]] = []
        self._layout: tuple[str, ...] | None = None

    def show(self, image: bytes, rows: list[Object]) -> None:
        """Show the present bytes."""
        layout = tuple(row.name for row in rows)
        if layout != self._layout:
            self._layout, self._labels, at = layout, [], 0
            self._fields.clear()
            with self._fields:
                if not rows:
                    note("No process data has passed yet.", kind="quiet")
                for row in rows:
                    with div("image-field"):
                        value = note("", kind="image-bytes")
                        note(f"{row.index:04X}h {row.name.replace('_', ' ')}", kind="image-object")
                    self._labels.append((at, at + row.size, value))
                    at += row.size
        for begin, end, label in self._labels:
            label.set_text(image[begin:end].hex(" ").upper())
