"""Many environments of one task on a device of warp: physics, drives and task where the agent is.

`vectors` is what Gymnasium calls for ``gymnasium.make_vec``: with ``device`` a `DeviceVectorEnv`,
else a `ServoVectorEnv`. A machine is reset, enabled and referenced alone on the CPU, as ever, and
then brought to the device; what a step brings back is whether an episode has ended, and the infos.
"""

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from ..drive.kernel.record import accessible
from . import fields
from .engine import worlds
from .engine.worlds import Images, Worlds, aligned
from .faces import FAULT, PDO
from .servo_env import ServoEnv
from .vector_env import ServoVectorEnv


class DeviceVectorEnv(ServoVectorEnv):
    """`ServoVectorEnv` whose physics and drives mujoco-warp and Numba step on a device.

    Observations, rewards, terminations and truncations are tensors of torch on the device, actions
    may be; infos are arrays as ever. What a step returns is that of `ServoVectorEnv` but for single
    precision (`servogym.envs.engine.worlds`).

    Args:
        task: class of the environments.
        num_envs: how many.
        device: of warp: "cuda", one such as "cuda:1", or "cpu".
        **arguments: of `ServoVectorEnv` but `threads`, and of the task. Not on a device yet:
            ``action="pdo"``, `history`, `previous_action`, faults of a bus.

    Raises:
        ImportError: a package of the extra ``servogym[gpu]``, or torch, is missing.
        ValueError: there is no such device, what is not there yet, and as `ServoVectorEnv` does.
    """

    def __init__(
        self, task: type[ServoEnv], num_envs: int = 1, *, device: str = "cuda", **arguments: Any
    ):
        self._wp, _ = worlds.packages()
        worlds.found(self._wp, device)
        try:
            self._torch: Any = importlib.import_module("torch")
        except ImportError as error:
            raise ImportError(f"device={device!r}: {error}: pip install torch") from None
        if "threads" in arguments:
            raise ValueError("threads: a device has its own, leave them out")
        super().__init__(task, num_envs, threads=1, **arguments)
        first, batch = self.envs[0], self._batch
        for name, given in (
            ('action="pdo"', first.face == PDO),
            ("history", first._history > 1),
            ("previous_action", first._previous_action),
            ("faults of a bus", first.line is not None),
        ):
            if given:
                raise ValueError(
                    f"{name} is not there with device={device!r} yet: leave one of them out"
                )
        rpdo, tpdo = first._images
        drives = len(first.drives)
        self._worlds_there = Worlds(
            [env.machine for env in self.envs], device, ticks=batch.ticks,
            images=Images((rpdo, drives), (tpdo, drives)),
        )  # fmt: skip
        self._tables = {
            "episodes": _Table(self, batch.episodes, first.EPISODE),
            "actions": _Table(self, batch.actions, first.ACTION),
            "rpdos": _Table(self, batch.rpdos, aligned(rpdo), drives, self._worlds_there.rpdos),
            "tpdos": _Table(self, batch.tpdos, aligned(tpdo), drives, self._worlds_there.tpdos),
            "observations": _Table(self, batch.observations, first.OBSERVATION),
        }
        width = fields.width(first.OBSERVATION)
        seen = self._tables["observations"].memory
        self._seen = self._wp.to_torch(seen).view(self._torch.float32).view(num_envs, width)
        self._act = self._compiled("act", "episodes", "actions", "rpdos")
        self._judge = self._compiled("judge", "episodes", "rpdos", "tpdos", "observations")
        self._arrived: list[int] = []  # rows that have been reset and are not yet there

    @property
    def device(self) -> Any:
        """Of torch, where the observations are."""
        return self._seen.device

    def _compiled(self, name: str, *names: str) -> Callable[[], None]:
        """`act` or `judge` of the task, on the tables that it works on."""
        function = getattr(self.envs[0], name)
        there, tables = self._worlds_there, [self._tables[each] for each in names]
        if not there.device.is_cuda:
            worlds_there = there.present.numpy()
            arrays = [table.view() for table in tables]
            return lambda: function(worlds_there, *arrays)
        from .engine import gpu

        drives = len(self.envs[0].drives)
        kinds = [table.kind for table in tables]
        if name == "act":
            episode, command, rpdo = kinds
            kernel = gpu.of_act(function, episode, command, rpdo, drives)
        else:
            episode, rpdo, tpdo, seen = kinds
            kernel = gpu.of_judge(function, episode, rpdo, tpdo, drives, seen)
        launch = gpu.launcher(self._wp, there.device, kernel, self.num_envs)
        places = [there.present.ptr, *(table.memory.ptr for table in tables)]
        return lambda: launch(*places)

    def _restart(self, i: int, options: dict[str, Any] | None = None) -> None:
        super()._restart(i, options)
        self._arrived.append(i)

    def _bring(self) -> None:
        """Bring what has been reset to the device."""
        if self._arrived:
            self._worlds_there.put(self._arrived)
            for table in self._tables.values():
                table.put(self._arrived)
            self._arrived = []

    def _run(self, moving: np.ndarray) -> None:
        there, tables = self._worlds_there, self._tables
        self._inject(moving)
        prices = any(self._batch.prices)
        before = self._batch.torque(self._parts[0]) if prices else None
        there.leave_out(~moving)
        tables["actions"].put(range(self.num_envs))
        self._act()
        there.step()
        self._judge()
        tables["episodes"].fetch()
        tables["tpdos"].fetch()
        faulty = (self._batch.words & FAULT != 0).any(axis=1) & moving
        there.fetch(np.flatnonzero(faulty))  # for the name of the fault
        if before is not None:
            self._batch.charge(self._parts[0], before)

    def _inject(self, moving: np.ndarray) -> None:
        """Let the declared faults happen, in the records that are on the device."""
        for i in np.flatnonzero(moving).tolist():
            env = self.envs[i]
            known = len(env._injected)
            env.inject_faults()
            if happened := env._injected[known:]:
                self._worlds_there.fetch([i])  # which has overwritten them
                for name, drive, cause, _ in env._faults:
                    if name in happened:
                        drive.inject(cause)
                self._worlds_there.put([i])

    def _observed(self) -> Any:
        self._bring()
        self.synchronize()  # torch has a stream of its own
        return self._seen.clone()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:  # type: ignore[override]
        """One step of each.

        Args:
            actions: tensor of torch, or array, shape ``(num_envs, actions)``.

        Raises:
            ValueError: actions out of the space.
        """
        if isinstance(actions, self._torch.Tensor):
            actions = actions.detach().cpu().numpy()
        observations, rewards, *ends, infos = super().step(actions)
        torch, device = self._torch, self.device
        rewards = torch.as_tensor(rewards, dtype=torch.float32, device=device)
        ended, cut = (torch.as_tensor(end, device=device) for end in ends)
        return observations, rewards, ended, cut, infos

    def zeros(self) -> Any:
        """Actions that do nothing, on the device."""
        return self._torch.zeros(self.action_space.shape, device=self.device)

    def step_physics(self) -> None:
        """The drives and the physics of a step alone, under the RPDOs there are: for a bench."""
        self._bring()
        self._worlds_there.step()

    def synchronize(self) -> None:
        """Wait until the device has done what it was given."""
        self._wp.synchronize_device(self._worlds_there.device)

    def render(self) -> tuple[Any, ...] | None:
        """An image of each environment, brought back for it."""
        self._bring()
        self._worlds_there.fetch(range(self.num_envs))
        return super().render()

    def __reduce__(self) -> tuple[Any, ...]:
        """It is not copied."""
        raise TypeError("a vector on a device is not copied or pickled: make it where it is needed")


class _Table:
    """An array of the batch, and the same on the device, as records that a GPU can read.

    Args:
        vector: whose it is.
        here: of the batch, one row an environment.
        kind: record there.
        columns: of it; 0: one dimension.
        memory: on the device; None: of its own.
    """

    def __init__(
        self, vector: Any, here: np.ndarray, kind: np.dtype, columns: int = 0, memory: Any = None
    ):
        wp = self._wp = vector._wp
        there: Worlds = vector._worlds_there
        self.kind, self._columns, self._here = kind, columns, here.view(np.ndarray)
        self._staged = np.zeros((len(here), max(columns, 1)), kind)
        self._stride = self._staged.strides[0]
        if memory is None:
            memory = wp.zeros(self._staged.nbytes, dtype=wp.uint8, device=there.device)
        self.memory = memory
        self._staged_bytes = wp.array(
            self._staged.view(np.uint8).reshape(-1), dtype=wp.uint8, device="cpu", copy=False
        )
        same = here.dtype.itemsize == kind.itemsize or not columns
        self._same = same and here.nbytes == self._staged.nbytes

    def view(self) -> np.ndarray:
        """The records there, where the device is a CPU."""
        records = self.memory.numpy().view(accessible(self.kind))
        return records.reshape(-1, self._columns) if self._columns else records

    def put(self, rows: Sequence[int]) -> None:
        """Bring rows to the device."""
        self._move(self._here, self._staged, rows)
        whole = len(rows) == len(self._here)
        for first, count in [(0, len(rows))] if whole else [(row, 1) for row in rows]:
            at = first * self._stride
            self._wp.copy(self.memory, self._staged_bytes, at, at, count * self._stride)

    def fetch(self) -> None:
        """Bring all rows back."""
        self._wp.copy(self._staged_bytes, self.memory)
        self._wp.synchronize_device(self.memory.device)
        self._move(self._staged, self._here, slice(None))

    def _move(self, source: np.ndarray, target: np.ndarray, rows: Any) -> None:
        if self._same:
            target.view(np.uint8).reshape(len(target), -1)[rows] = source.view(np.uint8).reshape(
                len(source), -1
            )[rows]
            return
        for name in self.kind.names or ():
            target[name][rows] = source[name][rows]


def vectors(
    task: type[ServoEnv], num_envs: int = 1, *, device: str | None = None, **arguments: Any
) -> gym.vector.VectorEnv:
    """Environments of a task, on a device of warp where one is given."""
    if device is None:
        return ServoVectorEnv(task, num_envs, **arguments)
    return DeviceVectorEnv(task, num_envs, device=device, **arguments)
