"""Steps many machines of one structure together with their drives, on mujoco-warp.

This is the second back-end of the engine. The data of a machine (WORLD, AXIS, COUPLING, MECHANICS
and PDO records, coordinates) form one row of bytes on the device, with addresses of the arrays of
mujoco-warp. The `parts` run between the halves of its steps: the same code as in `loop`, compiled
by Numba on the CPU device and by numba-cuda on a GPU (`gpu`), on the same stream and memory. Only
the precision differs, because mujoco-warp has single precision only.

A machine is set up, homed and reset alone on the CPU; `send` copies it to the device, `fetch`
copies it back. The initial state of its next episode can be copied in advance with `keep`: it waits
on the device, and `begin` starts any number of machines from there at once, in the same stream.
"""

import copy
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ...drive.kernel.process_data import PDO
from ...drive.kernel.record import AXIS
from . import loop, parts
from .machine import Machine
from .mechanics import CARRIAGE, MECHANICS, PLACES
from .residence import VARIABLE
from .rows import Rows, aligned
from .world import COUPLING, MOVE, PDOS, SINGLE


class Images(NamedTuple):
    """Process images of a machine: the record of a drive in each direction, and the drives."""

    rpdo: tuple[np.dtype, int]
    tpdo: tuple[np.dtype, int]


NO_IMAGES = Images((np.dtype([]), 0), (np.dtype([]), 0))


def _offset(record: np.dtype, name: str) -> int:
    return record.fields[name][1]  # type: ignore[index]


class _Table:
    """Images of all machines as bytes and as records, and the conversion between them."""

    def __init__(self, memory: Callable[[Any], Any], record: np.dtype, drives: int, n: int):
        even = aligned(record)
        self.packed, self.aligned = record.itemsize * drives, even.itemsize * drives
        self.images, self.records = memory(n * self.packed), memory(n * self.aligned)
        moves = [
            (_offset(even, name) + i * even.itemsize, _offset(record, name) + i * record.itemsize,
             record[name].itemsize)
            for i in range(drives)
            for name in record.names or ()
        ]
        self.moves = len(moves)
        packs = np.array(moves, MOVE)
        unpacks = np.array([(b, a, size) for a, b, size in moves], MOVE)
        self.packs, self.unpacks = memory(packs), memory(unpacks)


class Worlds:
    """Machines on a warp device.

    Args:
        machines: of one structure; they may differ in `residence.VARIABLE`.
        device: "cuda", one such as "cuda:1", or "cpu".
        ticks: physics steps in a step of the agent.
        images: process images of a machine, or None.

    Raises:
        ImportError: a package of the extra ``servogym[gpu]`` is missing.
        ValueError: the device does not exist, or mujoco-warp does not support the model.
        MemoryError: the device has too little memory for so many machines.
    """

    def __init__(
        self, machines: Sequence[Machine], device: str = "cuda", *, ticks: int = 1,
        images: "Images | None" = None,
    ):
        self.wp, self._mjw = packages()
        self.device = found(self.wp, device)
        self.machines = list(machines)
        self.ticks = ticks
        first, n = self.machines[0], len(self.machines)
        model = _takeable(first.model)
        self._rows = np.zeros(n, _row(first))
        with room(n, self.device), self.wp.ScopedDevice(self.device):
            self._make_physics(model, first, n)
            self._make_rows(images or NO_IMAGES, n)
        for row in range(n):
            self._address(row)
        self._launch = self._launcher()
        # what mujoco-warp allocates in a step, a graph takes from a pool
        self.in_graphs = self.device.is_cuda and self.wp.is_mempool_enabled(self.device)
        self._graph: Any = None
        self.leave_out(np.zeros(n, bool))
        self.send(range(n))

    def _make_rows(self, images: Images, n: int) -> None:
        self._stride = self._rows.dtype.itemsize
        self._memory = self._bytes(n * self._stride)
        self._own = Rows(self.wp, self._memory, n)
        self._models = [Rows(self.wp, getattr(self._model, name), n) for name in self._varied]
        self._images = [_Table(self._bytes, *each, n) for each in images]
        self.rpdos, self.tpdos = (table.records for table in self._images)
        self.present = self.wp.zeros(n, dtype=self.wp.int64, device=self.device)
        self.addresses = self._memory.ptr + self._stride * np.arange(n)

    def _make_physics(self, model: mujoco.MjModel, first: Machine, n: int) -> None:
        wp, mjw = self.wp, self._mjw
        kinds = {field.name: field.type for field in dataclasses.fields(mjw.Model)}
        batched = {
            name for name, kind in kinds.items() if getattr(kind, "shape", ("",))[:1] == ("*",)
        }
        self._varied = [each for each in VARIABLE if each in batched and getattr(model, each).size]
        try:
            self._model = mjw.put_model(model, batch_sizes=dict.fromkeys(self._varied, n))
            self._data = mjw.put_data(model, first.data, nworld=n)
        except (NotImplementedError, ValueError) as error:
            raise ValueError(f"mujoco-warp cannot take this model: {error}") from None
        wide = np.repeat(first._directions[:, None].astype(np.float32), n, axis=1)
        self._directions = wp.array(wide, dtype=float)
        self._responses = wp.zeros(wide.shape, dtype=float)
        self._solved = [
            PLACES * i + place
            for i, joint in enumerate(first.mechanics)
            for place in range(PLACES)
            if place == CARRIAGE or joint["guide"] >= 0
        ]

    def _bytes(self, what: int | np.ndarray) -> Any:
        """Allocate bytes on the device, or copy those of records."""
        wp = self.wp
        if isinstance(what, np.ndarray) and what.size:
            return wp.array(what.view(np.uint8), dtype=wp.uint8, device=self.device)
        size = what if isinstance(what, int) else 0
        return wp.zeros(max(size, 1), dtype=wp.uint8, device=self.device)

    def _launcher(self) -> Any:
        first, stride, n = self._memory.ptr, self._stride, len(self.machines)
        if self.device.is_cuda:
            from . import gpu

            for name, drive in self.machines[0].drives.items():
                for mode in drive.model.own_modes.values():
                    raise ValueError(
                        f"{name}: mode {mode.name!r} of drive model {drive.model.name!r} is "
                        "compiled for cores only: choose device='cpu'"
                    )
            kernels = {
                name: gpu.launcher(self.wp, self.device, gpu.of_part(name), n)
                for name in parts.PARTS
            }
            return lambda part: kernels[part](first, stride)
        return lambda part: parts.ON_CPU[part](first, stride, n)

    def _address(self, row: int) -> None:
        """Enter the addresses of a machine's data in its row."""
        d, m = self._data, self._model
        world = self._rows["world"][row : row + 1]
        own = int(self.addresses[row])
        for name, field in (
            ("axes", "axes"), ("couplings", "couplings"), ("mechanics", "mechanics"),
            ("pdos", "directory"), ("qpos", "qpos"), ("qvel", "qvel"),
            ("kept_warmstart", "warmstart"), ("kept_ctrl", "ctrl"),
        ):
            world[name] = own + _offset(self._rows.dtype, field)
        for name, array in (
            ("mj_qpos", d.qpos), ("mj_qvel", d.qvel), ("ctrl", d.ctrl), ("inertia", d.M),
            ("passive", d.qfrc_passive), ("acceleration", d.qacc), ("warmstart", d.qacc_warmstart),
            ("smooth_acceleration", d.qacc_smooth), ("stiffness", m.jnt_stiffness),
            ("damping", m.dof_damping), ("responses", self._responses[0]),
            ("directions", self._directions[0]), ("present", self.present),
        ):
            world[name] = array.ptr + row % array.shape[0] * array.strides[0]
        world["response_row"] = self._responses.strides[0]
        for name, table in zip(("rpdo", "tpdo"), self._images, strict=True):
            moves = table.packs if name == "rpdo" else table.unpacks
            world[name] = table.images.ptr + row * table.packed
            world[f"{name}_bytes"] = table.packed
            world[f"{name}_record"] = table.records.ptr + row * table.aligned
            world[f"{name}_moves"], world[f"{name}_move_count"] = moves.ptr, table.moves
        world["ticks"], world["latch_at"] = self.ticks, -1

    @property
    def qpos(self) -> np.ndarray:
        """Joint coordinates, shape ``(n, nq)`` float32, a copy where the device is not a CPU."""
        return self._data.qpos.numpy()

    @property
    def qvel(self) -> np.ndarray:
        """Joint speeds, shape ``(n, nv)`` float32."""
        return self._data.qvel.numpy()

    @property
    def ctrl(self) -> np.ndarray:
        """Torques of the drives, and controls of other actuators, shape ``(n, nu)`` float32."""
        return self._data.ctrl.numpy()

    def leave_out(self, rows: np.ndarray) -> None:
        """Set which machines stand still from now on, a mask of shape ``(n,)``."""
        self.present.assign(np.where(rows, 0, self.addresses))

    def send(self, rows: Sequence[int]) -> None:
        """Copy machines to the device in their present state."""
        for place, values in self._packed(rows):
            place.send(rows, values)

    def keep(self, rows: Sequence[int]) -> None:
        """Copy the present state of machines to the device, where it waits for `begin`."""
        for place, values in self._packed(rows):
            place.keep(rows, values)

    def begin(self, rows: Sequence[int]) -> None:
        """Continue machines from the state that was copied by `keep`."""
        for place in (self._own, *self._models):
            place.begin(rows)

    def _packed(self, rows: Sequence[int]) -> list[tuple[Rows, np.ndarray]]:
        fields: list[list[np.ndarray]] = [[] for _ in self._varied]
        for row in rows:
            self._pack(row)
            model = self.machines[row].model
            for values, name in zip(fields, self._varied, strict=True):
                values.append(np.array(getattr(model, name), np.float32))
        some = [np.stack(values) for values in fields]
        return [(self._own, self._rows[list(rows)]), *zip(self._models, some, strict=True)]

    def _pack(self, row: int) -> None:
        machine, packed = self.machines[row], self._rows[row]
        world, own = packed["world"], machine.world[0]
        for name in ("timestep", "nq", "nv", "nu", "inertias", "guides", "joints", "drives"):
            world[name] = own[name]
        for name in ("tick", "delay", "step_ticks", "limited_ticks"):
            world[name] = own[name]
        world["status"], world["arrived"] = loop.SOUND, 1
        packed["axes"], packed["couplings"] = machine.axes, machine.couplings
        packed["mechanics"] = machine.mechanics
        packed["qpos"], packed["qvel"] = machine.data.qpos, machine.data.qvel
        packed["warmstart"], packed["ctrl"] = machine.data.qacc_warmstart, machine.data.ctrl
        at, offset = 0, _offset(packed.dtype, "pdos")
        for drive, directory in zip(machine.drives.values(), packed["directory"], strict=True):
            for name, pdos in (("rpdo", drive.rpdos), ("tpdo", drive.tpdos)):
                packed["pdos"][at : at + len(pdos)] = pdos
                directory[f"{name}s"] = self.addresses[row] + offset + at * PDO.itemsize
                directory[f"{name}_count"] = len(pdos)
                at += len(pdos)

    def fetch(self, rows: Sequence[int] | np.ndarray, *, physics: bool = True) -> None:
        """Copy machines, or only their drives, back from the device."""
        if not len(rows):
            return
        rows = [int(row) for row in rows]
        packed = self._own.fetch(rows).view(self._rows.dtype)[:, 0]
        for row, own in zip(rows, packed, strict=True):
            self.machines[row].axes[:] = own["axes"]
        if not physics:
            return
        ctrl, warmstart = self.ctrl, self._data.qacc_warmstart.numpy()
        for row, own in zip(rows, packed, strict=True):
            machine = self.machines[row]
            machine.couplings[:], machine.mechanics[:] = own["couplings"], own["mechanics"]
            for name in ("tick", "step_ticks", "limited_ticks"):
                machine.world[name] = own["world"][name]
            with machine.turn:
                data = machine.data
                data.qpos[:], data.qvel[:], data.ctrl[:] = own["qpos"], own["qvel"], ctrl[row]
                data.qacc_warmstart[:] = warmstart[row]
                mujoco.mj_fwdPosition(machine.model, data)

    def step(self, steps: int | None = None) -> None:
        """Run a step of the agent, or any number of physics steps if there are no images."""
        with self.wp.ScopedDevice(self.device):
            self._launch("begin")
            for _ in range(self.ticks if steps is None else steps):
                self._tick()
            self._launch("end")

    def _tick(self) -> None:
        """Run one physics step; on a GPU it is captured in a graph after the first one."""
        if self._graph is not None and self.in_graphs:
            self.wp.capture_launch(self._graph)
            return
        self._physics_step()
        if self.in_graphs:
            with self.wp.ScopedCapture(self.device) as capture:
                self._physics_step()
            self._graph = capture.graph

    def _physics_step(self) -> None:
        mjw, m, d = self._mjw, self._model, self._data
        self._launch("control")
        mjw.step1(m, d)
        self._launch("forces")
        mjw.fwd_actuation(m, d)
        mjw.fwd_acceleration(m, d)
        for row in self._solved:
            mjw.solve_m(m, d, self._responses[row], self._directions[row])
        self._launch("stick")
        mjw.step2(m, d)
        self._launch("finish")


def packages() -> tuple[Any, Any]:
    """Warp and mujoco-warp. Raises ImportError with the command that installs them."""
    try:
        import warp

        if warp.config.log_level == warp.LOG_INFO:
            warp.config.log_level = warp.LOG_WARNING  # or it names each kernel it loads
        import mujoco_warp
    except ImportError as error:
        raise ImportError(f"{error}: pip install 'servogym[gpu]'") from None
    return warp, mujoco_warp


def found(wp: Any, device: str) -> Any:
    """Return a warp device. Raises ValueError in one line if there is none."""
    names = [str(each) for each in wp.get_devices()]
    wanted = "cuda:0" if str(device) == "cuda" else str(device)  # torch and warp have their own
    if wanted not in names:
        driver = "" if wp.get_cuda_devices() else " (warp finds no driver of NVIDIA with a GPU)"
        raise ValueError(
            f"device = {device!r}: there is none, this machine has {', '.join(names)}{driver}; "
            "leave device out for the loop on the CPU, which is faster than device='cpu'"
        )
    return wp.get_device(wanted)


@contextmanager
def room(n: int, device: Any) -> Iterator[None]:
    """Wrap allocations on a device. Raises MemoryError with the number of machines."""
    try:
        yield
    except RuntimeError as error:
        if "allocate" not in (text := str(error).partition("\n")[0]):
            raise
        raise MemoryError(f"{device} has no room for {n} machines ({text}): take fewer") from None


def _takeable(model: mujoco.MjModel) -> mujoco.MjModel:
    """Copy a model without the flag for automatic reset, which mujoco-warp does not know."""
    if model.na:
        raise ValueError(
            f"the model has {model.na} actuator activations, which are not part of what a device "
            "keeps of a machine, since drives have none: leave device out"
        )
    model = copy.copy(model)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return model


def _row(machine: Machine) -> np.dtype:
    """Record type with all data of one machine."""
    n, nq, nv = len(machine.axes), machine.model.nq, machine.model.nv
    pdos = sum(len(drive.rpdos) + len(drive.tpdos) for drive in machine.drives.values())
    return np.dtype(
        [
            ("world", SINGLE), ("axes", AXIS, (n,)), ("couplings", COUPLING, (n,)),
            ("mechanics", MECHANICS, (n,)), ("directory", PDOS, (n,)), ("qpos", "f8", (nq,)),
            ("qvel", "f8", (nv,)), ("warmstart", "f8", (nv,)), ("ctrl", "f8", (machine.model.nu,)),
            ("pdos", PDO, (pdos,)), ("end", "i8"),
        ],
        align=True,
    )
