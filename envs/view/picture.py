"""Pictures of an environment: images with an overlay, and a window; ghosts show the goals."""

import contextlib
import importlib
import os
import sys
from collections.abc import Mapping
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Protocol

import mujoco
import numpy as np

from ..engine.machine import Machine
from ..engine.mjcf_reading import HEIGHT, WIDTH
from ..engine.physics import STATE
from .camera import beside, floor, framed, visible_points
from .decor import Part, parts
from .overlay import Line, Overlay, lines

LONGEST = 400  # places of a path that are stored
APART = 1.5e-3  # m, distance of two of them
MARK = 0.02  # m, radius of the ghost of a site
UPRIGHT = np.eye(3).ravel()
ARRIVED = 1e-5  # m, or elements of a rotation; a geom closer to its goal has no ghost
THICK = 3.0  # px, of a line
DRIVEN = np.array([0.85, 0.2, 0.15, 1.0], np.float32)
WANTED = np.array([0.1, 0.1, 0.1, 0.6], np.float32)
GUIDE = np.array([0.2, 0.2, 0.2, 0.5], np.float32)
GHOST = np.array([0.2, 0.75, 0.3, 0.35], np.float32)
INSTEAD = "use render_mode='rgb_array', or `servogym watch ENV --record out.gif`"


def _before_mesa() -> None:
    """Load triton's LLVM before that of Mesa's software renderer.

    triton comes with torch. In the other order, rendering before training, `import triton` ends the
    process (observed with triton 3.9). If Mesa is loaded already, nothing is done.
    """
    maps = Path("/proc/self/maps")
    if "triton" in sys.modules or not maps.is_file() or "libLLVM" in maps.read_text():
        return
    with contextlib.suppress(ImportError):
        importlib.import_module("triton")


def _renderer(model: mujoco.MjModel) -> mujoco.Renderer:
    """Return a renderer off screen; without a display and without MUJOCO_GL it uses EGL.

    MuJoCo chooses its backend when it is imported, before it is known whether a picture is needed.
    """
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and not display and not os.environ.get("MUJOCO_GL"):
        from mujoco.egl import GLContext
        from mujoco.rendering.classic import gl_context

        gl_context.GLContext = GLContext
    _before_mesa()
    return mujoco.Renderer(model, HEIGHT, WIDTH)


class Scene(Protocol):
    """The environment that is drawn, such as a `ServoEnv`."""

    ID: ClassVar[str]
    episode: Any
    render_mode: str | None

    @property
    def time(self) -> float:
        """Time since the episode began (s)."""

    @property
    def machine(self) -> Machine:
        """The machine in its present state."""

    def ghosts(self) -> Mapping[str, Any]:
        """Return the displacement to the goal by body, shape ``(3,)`` (m)."""

    def goal_pose(self) -> np.ndarray | None:
        """Return coordinates of the machine at its goal, shape ``(nq,)``, or None."""

    def path(self) -> np.ndarray:
        """Return the path to be followed, shape ``(n, 3)`` (m)."""


class Picture:
    """Draws one environment, off screen (``render_mode="rgb_array"``) or in a window ("human").

    Drawing does not change the episode in a single bit.
    """

    def __init__(self, env: Scene):
        self._env = env
        self._renderer: mujoco.Renderer | None = None
        self._viewer: Any = None
        self._camera: mujoco.MjvCamera | None = None
        self._parts: list[Part] | None = None
        self._goal: mujoco.MjData | None = None
        self._path: list[dict[str, np.ndarray]] = []  # places of the bodies with a goal
        self._time = 0.0

    @cached_property
    def _overlay(self) -> Overlay:
        return Overlay(list(self._env.machine.drives), WIDTH)

    def update(self) -> None:
        """Follow a step: redraw the window, or note the path for the next image."""
        if self._env.render_mode == "human":
            self.show()
        elif self._renderer is not None:
            self.follow()

    def image(self) -> np.ndarray:
        """Return an image, shape ``(540, 960, 3)``, uint8. Raises RuntimeError without OpenGL."""
        machine = self._env.machine
        if self._renderer is None:
            try:
                self._renderer = _renderer(machine.model)
            except Exception as error:  # each OpenGL backend has exceptions of its own
                raise RuntimeError(
                    f"no image can be drawn ({type(error).__name__}: {error}): without a display "
                    "set the environment variable MUJOCO_GL to egl or osmesa before starting"
                ) from error
        mujoco.mj_fwdPosition(machine.model, machine.data)
        self.follow()
        if self._camera is None:
            panels = self._overlay.heights
            self._camera = framed(
                machine.model, machine.data, WIDTH / HEIGHT, panels[1] / HEIGHT, panels[0] / HEIGHT
            )
        self._renderer.update_scene(machine.data, self._camera)
        self._decorate(self._renderer.scene)
        self._ghosts(self._renderer.scene)
        self._driven(self._renderer.scene)
        image = self._renderer.render()
        self._overlay.draw(image, lines(machine), *self._head())
        self._from_above(image)
        return image

    def show(self) -> None:
        """Redraw the window; nothing happens once its user has closed it.

        Raises RuntimeError without a display.
        """
        if self._viewer is None:
            self._viewer = self._window()
        if self.closed:
            return
        self._viewer.user_scn.ngeom = 0
        self.follow()
        self._decorate(self._viewer.user_scn)
        self._driven(self._viewer.user_scn)
        self._ghosts(self._viewer.user_scn)
        self._viewer.set_texts(self._texts())
        self._viewer.sync()

    @property
    def closed(self) -> bool:
        """Whether the user has closed the window."""
        return self._viewer is not None and not self._viewer.is_running()

    def _window(self) -> Any:
        require_display()
        import mujoco.viewer

        machine = self._env.machine
        state = np.empty(mujoco.mj_stateSize(machine.model, STATE))
        mujoco.mj_getState(machine.model, machine.data, state, STATE)
        viewer = mujoco.viewer.launch_passive(
            machine.model, machine.data, show_left_ui=False, show_right_ui=False
        )
        # the viewer has computed forces, with which the next step would start its solver
        mujoco.mj_setState(machine.model, machine.data, state, STATE)
        with viewer.lock():
            framing = framed(machine.model, machine.data, WIDTH / HEIGHT, 0.1, 0.1)
            for name in ("type", "azimuth", "elevation", "distance", "lookat"):
                setattr(viewer.cam, name, getattr(framing, name))
        return viewer

    def _head(self) -> tuple[str, str, str]:
        """Title, distance of each ghost, and reward with time."""
        env = self._env
        goals = ", ".join(
            f"{body} {1e3 * float(np.linalg.norm(displacement)):.3f}"
            for body, displacement in env.ghosts().items()
        )
        goal = f"to the goal (mm): {goals}" if goals else ""
        reward = f"reward {float(env.episode.reward):.2f}   {env.time:.3f} s"
        return env.ID.partition("/")[2], goal, reward

    def _texts(self) -> list[tuple[int, int, str, str]]:
        """The overlay as texts of the window: a box above, one below."""
        title, goal, reward = self._head()
        machine = lines(self._env.machine)
        font = mujoco.mjtFontScale.mjFONTSCALE_150
        faults = [f"FAULT {line.name}: {line.fault}" for line in machine if line.fault]
        return [
            (font, mujoco.mjtGridPos.mjGRID_TOPLEFT, "\n".join([title, goal, *faults]), reward),
            (
                font, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT,
                "\n".join(f"{line.name}  {_plain(line)}" for line in machine),
                "\n".join(f"limit {line.limits}" if line.limits else "" for line in machine),
            ),
        ]

    def _ghosts(self, scene: mujoco.MjvScene) -> None:
        """Add translucent ghosts at the goals: of bodies and sites, or of all moving geoms."""
        machine = self._env.machine
        model, here = machine.model, machine.data
        for name, displacement in self._env.ghosts().items():
            for geom in _geoms(model, name):
                place, turn = here.geom_xpos[geom] + displacement, here.geom_xmat[geom]
                _ghost(scene, model.geom_type[geom], model.geom_size[geom], place, turn)
            if not _geoms(model, name):
                place, size = here.site(name).xpos + displacement, np.full(3, MARK)
                _ghost(scene, mujoco.mjtGeom.mjGEOM_SPHERE, size, place, UPRIGHT)
        pose = self._env.goal_pose()
        if pose is None:
            return
        there = self._goal = self._goal or mujoco.MjData(model)
        there.qpos[:] = pose
        mujoco.mj_kinematics(model, there)
        for geom in range(model.ngeom):
            place, turn = there.geom_xpos[geom], there.geom_xmat[geom]
            moved = not np.allclose(place, here.geom_xpos[geom], atol=ARRIVED)
            if moved or not np.allclose(turn, here.geom_xmat[geom], atol=ARRIVED):
                _ghost(scene, model.geom_type[geom], model.geom_size[geom], place, turn)

    def _decorate(self, scene: mujoco.MjvScene) -> None:
        """Add the decoration of the plant, and the scale on the floor."""
        model, data = self._env.machine.model, self._env.machine.data
        if self._parts is None:
            self._parts = [*parts(model), *beside(model, visible_points(model, data))]
        turn, own = np.empty(9), np.empty(9)
        for part in self._parts:
            if scene.ngeom >= scene.maxgeom:
                return
            mujoco.mju_quat2Mat(own, np.array(part.turned))
            body = data.xmat[part.body]
            mujoco.mju_mulMatMat(turn.reshape(3, 3), body.reshape(3, 3), own.reshape(3, 3))
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom, part.kind, np.array(part.size),
                data.xpos[part.body] + body.reshape(3, 3) @ np.array(part.place), turn,
                np.array(part.colour, np.float32),
            )
            geom.label = part.label
            scene.ngeom += 1

    def _driven(self, scene: mujoco.MjvScene) -> None:
        """Add the path of each body with a goal, and the path to be followed, as lines.

        A contour is drawn on the floor, where the machine does not hide it.
        """
        env = self._env
        wanted = env.path()
        here = self._here()
        if len(wanted):
            below = floor(env.machine.model)
            height = float(wanted[0, 2]) if below is None else below + 2e-3
            for place in here.values():
                _line(scene, place, np.array([*place[:2], height]), GUIDE)
            wanted = np.column_stack([wanted[:, :2], np.full(len(wanted), height)])
        for before, now in pairwise(wanted):
            _line(scene, before, now, WANTED)
        for before, now in pairwise([*self._path, here]):
            for body in before.keys() & now.keys():
                ends = before[body].copy(), now[body].copy()
                if len(wanted):
                    ends[0][2] = ends[1][2] = height + 2e-3
                _line(scene, *ends, DRIVEN)

    def follow(self) -> None:
        """Record the places of bodies with a goal, at each step, for a smooth path."""
        env = self._env
        if env.time < self._time:
            self._path.clear()  # another episode
        self._time = env.time
        mujoco.mj_kinematics(env.machine.model, env.machine.data)
        here, last = self._here(), self._path[-1] if self._path else {}
        if not last or any(np.linalg.norm(here[body] - last[body]) > APART for body in here):
            self._path.append(here)
        del self._path[:-LONGEST]

    def _here(self) -> dict[str, np.ndarray]:
        """Places of the bodies with a goal (m)."""
        return {body: _tip(self._env.machine, body) for body in self._env.ghosts()}

    def _from_above(self, image: np.ndarray) -> None:
        """Draw a contour once more, large, in a corner."""
        wanted = self._env.path()
        if len(wanted):
            tracks = [np.array([place[body][:2] for place in self._path if body in place])
                      for body in self._env.ghosts()]
            self._overlay.inset(image, wanted[:, :2], tracks)

    def close(self) -> None:
        """Close window and renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None


def _geoms(model: mujoco.MjModel, name: str) -> range:
    """Return the geoms of a body; a name that is a site has none."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if number < 0:
        return range(0)
    first = int(model.body_geomadr[number])
    return range(first, first + int(model.body_geomnum[number]))


def _tip(machine: Machine, name: str) -> np.ndarray:
    """Return the centre of a body's first geom, or the place of a site (m)."""
    geoms = _geoms(machine.model, name)
    if not geoms:
        return machine.data.site(name).xpos.copy()
    return machine.data.geom_xpos[geoms[0]].copy()


def _ghost(
    scene: mujoco.MjvScene, kind: int, size: np.ndarray, place: np.ndarray, turn: np.ndarray
) -> None:
    """Add a translucent shape."""
    if scene.ngeom < scene.maxgeom:
        mujoco.mjv_initGeom(scene.geoms[scene.ngeom], kind, size * 1.02, place, turn, GHOST)
        scene.ngeom += 1


def _line(scene: mujoco.MjvScene, begin: np.ndarray, end: np.ndarray, colour: np.ndarray) -> None:
    """Add a straight line, which has no shadow."""
    if scene.ngeom >= scene.maxgeom or np.allclose(begin, end):
        return
    geom, kind = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_LINE
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), colour)
    mujoco.mjv_connector(geom, kind, THICK, begin, end)
    scene.ngeom += 1


def require_display() -> None:
    """Raise RuntimeError with an alternative if no window can be opened."""
    variables = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in variables):
        raise RuntimeError(
            f"there is no display ({' and '.join(variables)} are not set): {INSTEAD}"
        )
    import glfw

    if not glfw.init():  # the viewer would wait for its window forever
        raise RuntimeError(f"no window can be opened on this display: {INSTEAD}")


def _plain(line: Line) -> str:
    """A line as text, in the characters of the window's font."""
    text = f"{line.state.name.lower().replace('_', ' ')}  {line.mode}  {line.numbers}"
    return text.replace("±", "+-").replace("−", "-")
