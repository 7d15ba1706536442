"""An environment whose process data travel in EtherCAT frames, with faults of the bus to order.

>>> env = OverEtherCat(gym.make("servogym.envs:servogym/LinearAxis-v0", drive="kollmorgen_akd"),
...                    faults=["drop rate=0.01 count=0"])

Without faults an episode is the same as without frames, byte by byte. A frame that is lost leaves
the drive with its last set-point and the agent with its last observation; time passes all the same.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from ..drive.ethercat.faulty import Fault, FaultyBus
from ..drive.ethercat.master import EtherCatMaster
from ..drive.ethercat.segment import Segment
from ..drive.ethercat.slave import Slave
from .engine import loop, probe
from .engine.machine import NO_IMAGES
from .servo_env import ServoEnv


class _Frames:
    """Takes the place of `loop.run` for one machine: images go in frames."""

    def __init__(self, env: ServoEnv, faults: Sequence[Fault], seed: int):
        self._machine = env.machine
        self._bus = FaultyBus(Segment([Slave(drive) for drive in env.drives]), seed=seed)
        self.master = EtherCatMaster(self._bus)
        self.master.to_op()
        self._bus.order(faults)  # from here on: what brings the slaves to OP is undisturbed
        self.lost = 0  # frames of process data

    def run(self, worlds: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """As `loop.run`, for one world."""
        probe.renew(self._machine)
        delay = min(int(self._machine.world["delay"][0]), ticks)
        loop.run(worlds, delay, NO_IMAGES, NO_IMAGES)
        at = 0
        for slave in self.master.slaves:
            size = len(slave.outputs)
            slave.outputs[:] = rpdos[0, at : at + size].tobytes()
            at += size
        self.lost += not self.master.cycle()
        loop.run(worlds, ticks - delay, NO_IMAGES, NO_IMAGES)
        self._bus.segment.publish(0)
        if self.master.look():
            inputs = b"".join(slave.inputs for slave in self.master.slaves)
            tpdos[0] = np.frombuffer(inputs, np.uint8)
        else:
            self.lost += 1


class OverEtherCat(gym.Wrapper):
    """The environment `env`, its drives behind slave controllers on a segment.

    ``info["frames_lost"]`` counts frames of the episode that were lost, or not counted by all
    slaves.

    Args:
        env: a servogym environment with a drive model for EtherCAT.
        faults: lines as `servogym ethercat --fault` takes them, or `Fault`; each episode anew.
        seed: of faults with a rate, until a reset gives one.

    Raises:
        ValueError: another environment or drive model, a fault that is none.
    """

    def __init__(self, env: gym.Env, faults: Sequence[str | Fault] = (), seed: int = 0):
        super().__init__(env)
        base = env.unwrapped
        if not isinstance(base, ServoEnv):
            raise ValueError(f"{base} is no environment of servogym")
        if base.drive.model.bus != "ethercat":
            raise ValueError(
                f"drive {base.drive.model.name!r} is on {base.drive.model.bus}: give the "
                'environment a model for EtherCAT, such as drive=load("generic", "ethercat")'
            )
        self._base = base
        self._faults = [f if isinstance(f, Fault) else Fault.parse(f) for f in faults]
        self._random = np.random.default_rng(seed)
        self._frames: _Frames | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start anew, with slaves in OPERATIONAL."""
        if seed is not None:
            self._random = np.random.default_rng(seed)
        self._base.exchange_by(loop.run)
        observation, info = self.env.reset(seed=seed, options=options)
        draw = int(self._random.integers(1 << 31))
        self._frames = _Frames(self._base, self._faults, draw)
        self._base.exchange_by(self._frames.run)
        return observation, info | {"frames_lost": 0}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One step, its set-points and answers in frames."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        lost = self._frames.lost if self._frames else 0
        return observation, reward, terminated, truncated, info | {"frames_lost": lost}
