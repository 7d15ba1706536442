"""Machine: the axes in 3D, with switches, limits and target as ghosts."""

from pathlib import Path
from typing import Any

import nicegui
from nicegui.element import Element

from ..geometry import Poses, scene
from ..session import Session
from .desk import Desk
from .widgets import Tag, button, card, div

STATIC = Path(__file__).parents[1] / "static"
THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"
LEGEND = (
    ("target", "--accent"), ("home switch", "--good"), ("limit switches", "--bad"),
    ("software limits 607Dh", "--warn"),
)


class Scene(Element, component=STATIC / "scene.js", esm={"nicegui-scene": str(THREE)}):
    """The picture in 3D."""


class MachinePage:
    """Page with the machine in 3D."""

    name, title, icon = "machine", "Machine", "view_in_ar"

    def __init__(self, desk: Desk):
        self.desk = desk
        self._ready = self._built = False
        self._last: Any = None
        self._poses: Poses | None = None
        with card("Machine", "machine-card"):
            self.scene = Scene()
            self.scene.on("ready", self._begin, [])
            with div("cluster legend"):
                for text, colour in LEGEND:
                    with Tag("span").classes("legend-item"):
                        Tag("i", style=f"background: var({colour})")
                        Tag("span", text)
                button("Reset view", lambda: self.scene.run_method("home"))

    def _begin(self) -> None:
        self._ready, self._built = True, False

    async def show(self) -> None:
        """Show the present poses."""
        if not self._ready:
            return
        if not self._built:
            self._built, self._last = True, None
            self.scene.run_method("build", await self.desk.ask(lambda s: scene(s.machine)))

        def look(session: Session) -> dict[str, Any]:
            if self._poses is None:
                self._poses = Poses(session.machine)
            return self._poses.now()

        poses = await self.desk.ask(look)
        if poses != self._last:
            self._last = poses
            self.scene.run_method("show", poses)
