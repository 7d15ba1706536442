"""Many environments of one task on a warp device: physics, drives and task run beside the agent.

Gymnasium calls `vectors` for ``gymnasium.make_vec``; it returns a `DeviceVectorEnv` if ``device``
is given, otherwise a `ServoVectorEnv`. A machine is reset, enabled and referenced alone on the CPU.
With a GPU this happens in advance while the GPU steps: the next episode of an environment waits on
the device, and any number of episodes begin there by a few copies in the same stream. The random
draws equal those of `ServoVectorEnv`, because only the environment itself draws from its generator.
"""

import importlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from ..engine import worlds
from ..engine.rows import Records, aligned
from ..engine.worlds import Images, Worlds
from ..exchange.batch import JUDGED_NAMES, shown
from ..exchange.faces import CONTROL, FAULT, STATUS, control, report
from ..exchange.loops import acting, judging
from .servo_env import ServoEnv
from .vector_env import ServoVectorEnv

KNOWN = ("episodes", "tpdos")  # arrays of a batch that a step copies back


class DeviceVectorEnv(ServoVectorEnv):
    """`ServoVectorEnv` whose physics and drives are stepped on a device by mujoco-warp and Numba.

    Observations, rewards, terminations and truncations are torch tensors on the device. Actions may
    be as well, and then never leave it. Infos are NumPy arrays. The results of a step are those of
    `ServoVectorEnv` except for single precision (`servogym.envs.engine.worlds`).

    Args:
        task: class of the environments.
        num_envs: number of environments.
        device: warp device: "cuda", a specific one such as "cuda:1", or "cpu".
        **arguments: of `ServoVectorEnv` but `threads`, and of the task but faults of a bus, whose
            frames are made in Python, one environment after the other.

    Raises:
        ImportError: a package of the extra ``servogym[gpu]``, or torch, is missing.
        ValueError: the device does not exist or lacks a feature, and as for `ServoVectorEnv`.
        MemoryError: the device has too little memory for so many environments.
    """

    def __init__(
        self, task: type[ServoEnv], num_envs: int = 1, *, device: str = "cuda", **arguments: Any
    ):
        self._wp, _ = worlds.packages()
        self._torch = torch = _torch(worlds.found(self._wp, device), device)
        if "threads" in arguments:
            raise ValueError("threads: a device has its own, leave them out")
        super().__init__(task, num_envs, threads=1, **arguments)
        first, n = self.envs[0], self.num_envs
        if first.line is not None:
            raise ValueError(
                f"faults of a bus are not available with device={device!r}, because Python makes "
                "and reads each frame: leave one of them out"
            )
        # the next episodes are prepared in rows of their own, while the present ones are in use
        self._coming = first.batch(n)
        for row, env in enumerate(self.envs):
            env.join(self._coming, row)
        rpdo, tpdo = first._images
        drives = len(first.drives)
        self._there = there = Worlds(
            [env.machine for env in self.envs], device, ticks=self._batch.ticks,
            images=Images((rpdo, drives), (tpdo, drives)),
        )
        self._stream = torch.cuda.ExternalStream(
            there.device.stream.cuda_stream, self._wp.device_to_torch(there.device)
        ) if there.device.is_cuda else None
        with worlds.room(n, there.device):
            self._make_tables(there)
        self._before = [self._compiled("act", "episodes", "commands", "rpdos")]
        self._after = [self._compiled("judge", "episodes", "rpdos", "tpdos", "seen")]
        if len(self._coming.modes):
            self._before.append(self._compiled("control", "controls", "rpdos"))
            self._after.append(self._compiled("report", "tpdos", "status"))
        self._ready: list[_Ready | None] = [None] * n
        # faults draw random numbers between two episodes, and a picture needs the state on the CPU
        self._ahead = not (first._faults or self.render_mode)
        self._queue: OrderedDict[int, None] = OrderedDict()  # rows that have begun, oldest first
        self._done = self._wp.Event(there.device) if there.device.is_cuda else None

    def _make_tables(self, there: Worlds) -> None:
        """Allocate the arrays of the task on the device, and their torch tensors."""
        wp, torch, coming, first = self._wp, self._torch, self._coming, self.envs[0]
        rpdo, tpdo = map(aligned, first._images)
        on, drives = there.device, len(first.drives)
        tables = self._tables = {
            "episodes": Records(wp, on, coming.episodes, first.EPISODE),
            "commands": Records(wp, on, coming._commands, first.ACTION),
            "rpdos": Records(wp, on, coming.rpdos, rpdo, drives, there.rpdos),
            "tpdos": Records(wp, on, coming.tpdos, tpdo, drives, there.tpdos),
            "seen": Records(wp, on, coming._seen, first.OBSERVATION),
        }
        if len(coming.modes):
            tables["controls"] = Records(wp, on, coming._controls, CONTROL, drives)
            tables["status"] = Records(wp, on, coming._status, STATUS, drives)
        inputs, outputs = ("commands", "controls"), ("seen", "status")
        self._inputs = [tables[name].numbers(torch.float64) for name in inputs if name in tables]
        self._outputs = [tables[name].numbers(torch.float32) for name in outputs if name in tables]
        known = [name for name in JUDGED_NAMES if not shown(name)]
        known += filter(shown, first.EPISODE.names or ())
        layout: Any = first.EPISODE.fields
        places = [range(at, at + kind.itemsize) for kind, at, *_ in map(layout.get, known)]
        self._known_here = np.concatenate([*map(np.asarray, places)])
        self._known = torch.as_tensor(self._known_here, device=self.device)
        self._bytes_of_episodes = tables["episodes"].numbers(torch.uint8)
        shape = self.num_envs, first._history, sum(part.shape[1] for part in self._outputs)
        self._frames = torch.zeros(shape, device=self.device)
        self._actions = torch.zeros(coming.actions.shape, dtype=torch.float64, device=self.device)

    @property
    def device(self) -> Any:
        """Device (of torch) on which the observations are."""
        return self._outputs[0].device

    def _compiled(self, name: str, *names: str) -> Callable[[], None]:
        """Compile the function before or after the physics of a step, with its arrays."""
        first, there, modes = self.envs[0], self._there, self._batch.modes
        tables = [self._tables[each] for each in names]
        if not there.device.is_cuda:
            arrays, present = [table.view() for table in tables], there.present.numpy()
            if name == "control":
                return lambda: control(present, arrays[0], modes, arrays[1])
            if name == "report":
                return lambda: report(arrays[0], modes, arrays[1])
            function = acting(first.act) if name == "act" else judging(first.judge)
            return lambda: function(present, *arrays)
        from ..engine import gpu

        kinds, drives = [table.kind for table in tables], len(first.drives)
        kernel: gpu.Kernel = {
            "act": lambda: gpu.of_act(acting(first.act), drives, *kinds),
            "judge": lambda: gpu.of_judge(judging(first.judge), drives, *kinds),
            "control": lambda: gpu.of_control(control, modes, drives, *kinds),
            "report": lambda: gpu.of_report(report, modes, drives, *kinds),
        }[name]()
        launch = gpu.launcher(self._wp, there.device, kernel, self.num_envs)
        places = [there.present.ptr, *(table.rows.memory.ptr for table in tables)]
        return lambda: launch(*places)

    @contextmanager
    def _in_stream(self) -> Iterator[None]:
        """Run torch in the stream of warp, ordered with the caller's stream."""
        if self._stream is None:
            yield
            return
        theirs = self._torch.cuda.current_stream(self.device)
        self._stream.wait_stream(theirs)
        with self._torch.cuda.stream(self._stream):
            yield
        theirs.wait_stream(self._stream)

    # ------------------------------------------------------------------ the next episode

    def _restart(self, rows: list[int], options: dict[str, Any] | None = None) -> None:
        if not rows:
            return
        for i in rows:
            ready, env = self._ready[i], self.envs[i]
            if ready is not None and env._np_random is not ready.generator:
                self._ready[i] = None  # seeded again meanwhile
            elif ready is not None and options:
                ready.generator.bit_generator.state = ready.before
                self._ready[i] = None
        self._keep({i: self._made(i, options) for i in rows if self._ready[i] is None})
        self._there.begin(rows)
        for table in self._tables.values():
            table.rows.begin(rows)
        for name in KNOWN:
            getattr(self._batch, name)[rows] = getattr(self._coming, name)[rows]
        for i in rows:
            if (ready := self._ready[i]) is not None:
                self.envs[i].parameters, self._ready[i] = ready.parameters, None
        self._steps[rows], self._ended[rows] = 0, False
        self._queue |= dict.fromkeys(rows if self._ahead else ())
        at = self._torch.as_tensor(rows, device=self.device)
        self._frames[at] = self._looked()[at, None]
        self._actions[at] = 0.0

    def _made(self, i: int, options: dict[str, Any] | None = None) -> "_Ready":
        """Make the next episode of an environment, on a core."""
        env = self.envs[i]
        present, generator = env.parameters, env.np_random
        before = generator.bit_generator.state
        try:
            env.restart(options)
            return _Ready(generator, before, env.parameters)
        finally:
            env.parameters = present

    def _keep(self, made: "dict[int, _Ready]") -> None:
        """Copy prepared episodes to the device, where they wait."""
        if rows := list(made):
            self._there.keep(rows)
            for table in self._tables.values():
                table.keep(rows)
        for i, ready in made.items():
            self._ready[i] = ready

    def _busy(self) -> bool:
        """Whether the device still has something to do."""
        return self._done is not None and not self._done.is_complete

    def _made_meanwhile(self) -> "dict[int, _Ready]":
        """Make next episodes while the device steps."""
        made = {}
        while self._queue and self._busy():
            i, _ = self._queue.popitem(last=False)
            if self._ready[i] is None:
                made[i] = self._made(i)
        return made

    # ------------------------------------------------------------------------- a step

    def _reset(self, seed: Any, options: dict[str, Any] | None) -> Any:
        with self._in_stream():
            return super()._reset(seed, options)

    def _step(self, actions: Any) -> Any:
        with self._in_stream():
            observations, rewards, *ends, infos = super()._step(actions)
            torch, device = self._torch, self.device
            rewards = torch.as_tensor(rewards, dtype=torch.float32, device=device)
            ended, cut = (torch.as_tensor(end, device=device) for end in ends)
            return observations, rewards, ended, cut, infos

    def _numbers(self, actions: Any) -> Any:
        torch = self._torch
        if not isinstance(actions, torch.Tensor):
            actions = np.asarray(actions, np.float64)
        return torch.as_tensor(actions, dtype=torch.float64, device=self.device).detach()

    def _act_on(self, given: Any, moving: np.ndarray) -> None:
        torch = self._torch
        mask = torch.as_tensor(moving, device=self.device)
        self._actions = torch.where(mask[:, None], given, self._actions)
        widths = [part.shape[1] for part in self._inputs]
        for part, numbers in zip(self._inputs, self._actions.split(widths, 1), strict=True):
            part.copy_(numbers)

    def _run(self, moving: np.ndarray) -> None:
        there, tables = self._there, self._tables
        self._inject(moving)
        prices = any(self._batch.prices)
        before = self._batch.torque(self._parts[0]) if prices else None
        there.leave_out(~moving)
        for run in self._before:
            run()
        there.step()
        for run in self._after:
            run()
        if self._done is not None:
            there.device.stream.record_event(self._done)
        made = self._made_meanwhile()
        self._fetch_episodes()
        tables["tpdos"].fetch(self._batch.tpdos)
        self._keep(made)
        faulty = (self._batch.words & FAULT != 0).any(axis=1) & moving
        there.fetch(np.flatnonzero(faulty), physics=False)  # for the name of the fault
        if before is not None:
            self._batch.charge(self._parts[0], before)

    def _fetch_episodes(self) -> None:
        """Copy the public fields of the episodes back; private ones (long paths) stay there."""
        brought = self._bytes_of_episodes[:, self._known].cpu().numpy()
        here = self._batch.episodes.view(np.ndarray).view(np.uint8).reshape(self.num_envs, -1)
        here[:, self._known_here] = brought

    def _inject(self, moving: np.ndarray) -> None:
        """Inject the declared faults into the records on the device."""
        if not self.envs[0]._faults:
            return
        for i in np.flatnonzero(moving).tolist():
            env = self.envs[i]
            known = len(env._injected)
            env.inject_faults()
            if happened := env._injected[known:]:
                self._there.fetch([i])  # overwrites the injected causes
                for name, drive, cause, _ in env._faults:
                    if name in happened:
                        drive.inject(cause)
                self._there.send([i])

    def _looked(self) -> Any:
        """The present observations of all environments, without history."""
        return self._torch.cat(self._outputs, 1)

    def _remember(self, moving: np.ndarray) -> None:
        torch = self._torch
        mask = torch.as_tensor(moving, device=self.device)
        frames = torch.cat([self._looked()[:, None], self._frames[:, :-1]], 1)
        self._frames = torch.where(mask[:, None, None], frames, self._frames)

    def _observed(self) -> Any:
        frames = self._frames.flatten(1)
        if not self.envs[0]._previous_action:
            return frames.clone()
        return self._torch.cat([frames, self._actions.float()], 1)

    # --------------------------------------------------------------- benchmarks and pictures

    def zeros(self) -> Any:
        """Return actions of 0 on the device."""
        return self._torch.zeros(self.action_space.shape, device=self.device)

    @property
    def in_graphs(self) -> bool:
        """Whether a physics step is launched as one graph; a benchmark may switch it off."""
        return self._there.in_graphs

    @in_graphs.setter
    def in_graphs(self, given: bool) -> None:
        self._there.in_graphs = given

    def state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions, speeds and torques of the physics, shape ``(n, ...)`` each."""
        return self._there.qpos, self._there.qvel, self._there.ctrl

    def step_physics(self) -> None:
        """Step drives and physics alone with the present RPDOs, for benchmarks."""
        self._there.step()

    def synchronize(self) -> None:
        """Wait until the device has finished."""
        self._wp.synchronize_device(self._there.device)

    def render(self) -> tuple[Any, ...] | None:
        """Return an image of each environment, whose state is copied back for it."""
        if self.render_mode is None:
            return None
        self._there.fetch(range(self.num_envs))
        self._tables["episodes"].fetch(self._batch.episodes)
        for name in KNOWN:
            getattr(self._coming, name)[:] = getattr(self._batch, name)
        return super().render()

    def __reduce__(self) -> tuple[Any, ...]:
        """Raise TypeError: it cannot be copied or pickled."""
        raise TypeError("a vector on a device cannot be copied or pickled: build another one")


class _Ready(NamedTuple):
    """An episode that waits on the device."""

    generator: np.random.Generator  # of its environment
    before: Any  # state of the generator before the episode was prepared
    parameters: dict[str, float]


def vectors(
    task: type[ServoEnv], num_envs: int = 1, *, device: str | None = None, **arguments: Any
) -> gym.vector.VectorEnv:
    """Return environments of a task, on a warp device if one is given."""
    if device is None:
        return ServoVectorEnv(task, num_envs, **arguments)
    return DeviceVectorEnv(task, num_envs, device=device, **arguments)


def _torch(found: Any, device: str) -> Any:
    """Load torch for a warp device. Raises ImportError or ValueError in one line."""
    try:
        torch: Any = importlib.import_module("torch")
    except ImportError as error:
        raise ImportError(f"device={device!r}: {error}: pip install torch") from None
    if found.is_cuda and found.ordinal >= torch.cuda.device_count():
        raise ValueError(
            f"device = {device!r}: warp finds it, torch {torch.__version__} does not: install "
            "torch with CUDA, see https://pytorch.org/get-started"
        )
    return torch
