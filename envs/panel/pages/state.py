"""State: the diagram, both words bit by bit, faults in words, the bytes of the process data."""

from nicegui import ui

from ....drive.diagrams import Transition, controlword_bits, statusword_bits
from .desk import Desk, refuse
from .state_diagram import StateDiagram
from .widgets import Bits, button, card


class StatePage:
    """Page with state diagram, statusword, controlword and process data."""

    name, title, icon = "state", "State", "account_tree"

    def __init__(self, desk: Desk):
        self.desk = desk
        self.own_modes = desk.bench.model(desk.axis).own_modes
        with ui.element("div").classes("columns state-columns"):
            with card("Device control · CiA 402", "diagram"):
                self.diagram = StateDiagram(self._transition)
            with ui.element("div").classes("stack"):
                with card("Words"), ui.element("div").classes("words"):
                    self.controlword = Bits("Controlword 6040h", self._toggle, "controlword")
                    self.statusword = Bits("Statusword 6041h", self._explain, "statusword")
                with ui.element("div").classes("columns halves"):
                    with card("Fault", "fault-card") as self.fault_card:
                        self.fault = ui.label("").classes("verdict").props("data-test=fault")
                        self.remedy = ui.label("").classes("prose").props("data-test=remedy")
                        self.others = ui.label("").classes("prose quiet")
                        self.reset = button("Reset fault", self._reset, "reset-fault", "main")
                    with card("Why refused"):
                        self.refused = ui.label("").classes("prose").props("data-test=refused")
                        self.limits = ui.label("").classes("prose quiet")
                with card("Process data"):
                    self.rpdo, self.tpdo = _Bytes("RPDO", "rpdo"), _Bytes("TPDO", "tpdo")

    async def _transition(self, row: Transition) -> None:
        axis, word = self.desk.axis, row.controlword
        assert word is not None
        if row.command == "fault reset":
            refuse(await self.desk.motion(lambda session: session.reset_fault(axis)))
        elif row.command == "quick stop":  # every window may
            refuse(await self.desk.stop(lambda session: session.quick_stop(axis)))
        else:
            refuse(await self.desk.command(lambda session: session.control_word(axis, word)))

    async def _toggle(self, mask: int) -> None:
        axis, word = self.desk.axis, self.desk.status["controlword"] ^ mask
        refuse(await self.desk.command(lambda session: session.control_word(axis, word)))

    def _explain(self, mask: int) -> None:
        bits = statusword_bits(self.desk.status["mode"], self.own_modes)
        bit = bits[mask.bit_length() - 1]
        ui.notify(f"bit {mask.bit_length() - 1}, {bit.name.replace('_', ' ')}: {bit.meaning}")

    async def _reset(self) -> None:
        axis = self.desk.axis
        refuse(await self.desk.motion(lambda session: session.reset_fault(axis)))

    def show(self) -> None:
        """Show the present state."""
        seen = self.desk.status
        self.diagram.show(seen["state"])
        self.controlword.show(seen["controlword"], controlword_bits(seen["mode"], self.own_modes))
        self.statusword.show(seen["statusword"], statusword_bits(seen["mode"], self.own_modes))
        self.fault.set_text(seen["fault"] or "No fault")
        self.fault.classes(**({"add": "bad"} if seen["fault"] else {"remove": "bad"}))
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
        with ui.element("div").classes("image").props(f"data-test={test}"):
            ui.label(name).classes("image-name")
            self._fields = ui.element("div").classes("image-fields")
        self._labels: list[tuple[int, int, ui.label]] = []
        self._layout: tuple[str, ...] | None = None
        self._shown = b""

    def show(self, image: bytes, rows: list) -> None:
        """Show the present bytes."""
        layout = tuple(row.name for row in rows)
        if layout != self._layout:
            self._layout, self._labels, at = layout, [], 0
            self._fields.clear()
            with self._fields:
                if not rows:
                    ui.label("none has passed yet").classes("quiet")
                for row in rows:
                    with ui.element("div").classes("image-field"):
                        value = ui.label("").classes("image-bytes")
                        ui.label(f"{row.index:04X}h {row.name.replace('_', ' ')}").classes(
                            "image-object"
                        )
                    self._labels.append((at, at + row.size, value))
                    at += row.size
        elif image == self._shown:
            return
        self._shown = image
        for begin, end, label in self._labels:
            label.set_text(image[begin:end].hex(" ").upper())
