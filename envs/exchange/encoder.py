"""What a bus tells of its drives, and nothing else: the load is where the encoder says it is.

Tasks judge by the true place of the load and by the share of a step at an internal limit. A bus
tells neither, so on a bus they judge by the position actual value, which is sampled a position
cycle earlier in whole units, and by the end of the step. `EncoderLine` lets them do the same with
drives in this process, so that both can be compared.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...drive.kernel.words import Statusword
from ..engine import loop
from ..engine.machine import Machine


def tell(machine: Machine, axes: Sequence[str], images: np.ndarray, units: float) -> None:
    """Give a task the answers of the drives `axes` instead of the state of its machine.

    Args:
        machine: whose coordinates its task looks at; its physics is not touched.
        axes: names of the drives.
        images: the record of each with ``statusword`` and ``position_actual_value``.
        units: position units per m or rad.
    """
    positions, velocities = machine._coordinates
    names = [*machine.drives]
    for axis, image in zip(axes, images, strict=True):
        coupling = machine.couplings[names.index(axis)]
        positions[int(coupling.qpos)] = image["position_actual_value"] / units
    velocities[:] = 0.0
    limited = (images["statusword"] & Statusword.INTERNAL_LIMIT_ACTIVE).any()
    machine.world["step_ticks"], machine.world["limited_ticks"] = 1, limited


class EncoderLine:
    """The drives of an environment in this process, told as a bus tells them.

    Args:
        machine: of the environment.
        axes: names of the drives its agent commands.
        image: record of their TPDOs.
        units: position units per m or rad.
    """

    lost = 0

    def __init__(self, machine: Machine, axes: Sequence[str], image: np.dtype, units: float):
        self._machine, self._axes, self._image, self._units = machine, [*axes], image, units
        self._rest: np.ndarray | None = None  # coordinates of which nothing is told

    def begin(self, random: np.random.Generator) -> None:
        """Before an episode."""
        self._rest = None

    def run(self, world: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Run cycles as `loop.run` does, for one world and its images as bytes."""
        loop.run(world, ticks, rpdos[None], tpdos[None])
        positions = self._machine._coordinates[0]
        if self._rest is None:
            self._rest = positions.copy()
        positions[:] = self._rest
        tell(self._machine, self._axes, tpdos.view(self._image).reshape(-1), self._units)

    def look(self, world: np.ndarray, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Fill the TPDO images without running a cycle."""
        self.run(world, 0, rpdos, tpdos)

    def state(self) -> Any:
        """What has happened since it was made."""
        return self._rest

    def become(self, state: Any) -> None:
        """Go on where `state` was told."""
        self._rest = state
