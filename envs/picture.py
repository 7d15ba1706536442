"""What an environment looks like: images, and a window, with ghosts where things should be."""

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

if TYPE_CHECKING:
    from .servo_env import ServoEnv

HEIGHT, WIDTH = 540, 960
GHOST = np.array([0.2, 0.75, 0.3, 0.35], np.float32)


class Picture:
    """Draws one environment, off screen (``render_mode="rgb_array"``) or in a window ("human")."""

    def __init__(self, env: "ServoEnv"):
        self._env = env
        self._renderer: mujoco.Renderer | None = None
        self._viewer: Any = None

    def image(self) -> np.ndarray:
        """Shape ``(540, 960, 3)``, uint8."""
        machine = self._env.machine
        if self._renderer is None:
            self._renderer = mujoco.Renderer(machine.model, HEIGHT, WIDTH)
        mujoco.mj_fwdPosition(machine.model, machine.data)
        self._renderer.update_scene(machine.data)
        self._ghosts(self._renderer.scene)
        return self._renderer.render()

    def show(self) -> None:
        """Bring the window up to date."""
        if self._viewer is None:
            import mujoco.viewer

            machine = self._env.machine
            self._viewer = mujoco.viewer.launch_passive(machine.model, machine.data)
        self._viewer.user_scn.ngeom = 0
        self._ghosts(self._viewer.user_scn)
        self._viewer.sync()

    def _ghosts(self, scene: mujoco.MjvScene) -> None:
        """Add the boxes of each body that has a ghost, translucent, where it should be."""
        machine = self._env.machine
        for body, displacement in self._env.ghosts().items():
            number = machine.model.body(body).id
            first = machine.model.body_geomadr[number]
            for geom in range(first, first + machine.model.body_geomnum[number]):
                if scene.ngeom >= scene.maxgeom:
                    return
                mujoco.mjv_initGeom(
                    scene.geoms[scene.ngeom],
                    machine.model.geom_type[geom],
                    machine.model.geom_size[geom] * 1.02,
                    machine.data.geom_xpos[geom] + displacement,
                    machine.data.geom_xmat[geom],
                    GHOST,
                )
                scene.ngeom += 1

    def close(self) -> None:
        """Close window and renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
