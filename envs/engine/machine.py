"""Machine: a MuJoCo model whose actuators are moved by emulated drives."""

import copy
import zlib
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...drive.drive import Drive
from ...drive.kernel import record
from ...drive.memory import address
from ...drive.model.foreign import Key
from ...drive.model.model import DriveModel, load
from ...drive.model.names import hint, named
from ...drive.objects import snapshot as snapshots
from . import loop, mechanics
from .checks import whole
from .coupling import couple, unit
from .guard import Turn
from .mjcf import attach
from .mjcf_reading import read
from .physics import OPTIONS, RNE_FLAG, STATE, addresses, compiled
from .probe import PROBE
from .rates import rates
from .replay import Replay, rows_of
from .residence import Residence, checksum, variable
from .world import COUPLING, PDOS, WORLD

MOST = 10**12  # cycles of a step
USER_LAWS = (  # of actuators, which callbacks of MuJoCo compute
    ("actuator_dyntype", mujoco.mjtDyn.mjDYN_USER),
    ("actuator_gaintype", mujoco.mjtGain.mjGAIN_USER),
    ("actuator_biastype", mujoco.mjtBias.mjBIAS_USER),
)
NO_IMAGES = np.zeros((1, 0), np.uint8)
READ = ("position", "velocity", "torque", "position_demand")  # rad, rad/s, Nm, rad


class Drives(dict[str, Drive]):
    """The drives of a machine by name."""

    def __missing__(self, name: str) -> Drive:
        raise KeyError(f"there is no drive {name!r}: {hint(str(name), self)}")


class Machine:
    """Drives attached to named actuators of a MuJoCo model, stepped in one compiled loop.

    A drive is attached to an actuator by the actuator's name or by that of its joint; the actuator
    must be a plain motor on a slide or hinge joint. The actuator's gear represents the mechanics
    (rad of motor shaft per m or rad of joint): the drive measures the shaft and applies a torque in
    Nm. The actuator's control range is removed, because the drive has limits of its own. The MJCF
    may wire switches and a holding brake to a drive by its name::

        <custom>
          <numeric name="x.negative_limit_switch" data="-1 -0.005 0.0003"/>  from, to, hysteresis
          <numeric name="x.home_switch" data="0.2 0.23 0.0003"/>
          <numeric name="z.brake_torque" data="3"/>                          Nm at the shaft
        </custom>

    Friction, backlash and other effects are described in `mechanics`. The attribute ``mechanics``
    holds one MECHANICS record for each drive, which includes the energy of impacts on end stops.

    Args:
        model: the MuJoCo model, owned by the machine from now on.
        drives: drive model (name, folder or `DriveModel`) by actuator or joint name.

    Raises:
        ValueError: something does not fit; the message says what, and how to correct it.
        TypeError: `model` is not a MuJoCo model.
    """

    def __init__(
        self, model: mujoco.MjModel, drives: Mapping[str, str | Path | DriveModel]
    ) -> None:
        if not isinstance(model, mujoco.MjModel):
            raise TypeError(
                f"model = {model!r:.80}: give a mujoco.MjModel; for a file or its text use "
                "Machine.from_mjcf"
            )
        if not drives:
            joints = [model.joint(i).name for i in range(model.njnt)]
            actuators = [model.actuator(i).name for i in range(model.nu)]
            named = [name for name in dict.fromkeys([*actuators, *joints]) if name]
            raise ValueError(f"drives is empty: name at least one actuator or joint of {named}")
        if model.opt.integrator not in loop.INTEGRATORS:
            raise ValueError(
                f"integrator {_integrator(model)} is refused: RK4 takes several steps in one, but "
                'friction and drive act once per step; use integrator="implicitfast", or '
                "Machine.from_mjcf, which sets it"
            )
        # A state that is not finite must reach the drive as a dead encoder, not vanish in a reset.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        axes = record.make(len(drives))
        self._assemble(
            model,
            {
                name: Drive(drive, axes=axes, index=i, node_id=i + 1)
                for i, (name, drive) in enumerate(drives.items())
            },
        )
        for (name, drive), coupling in zip(self.drives.items(), self.couplings, strict=True):
            couple(model, name, drive, coupling)
        for name, coupling, joint in zip(drives, self.couplings, self.mechanics, strict=True):
            mechanics.fit(model, name, coupling, joint)
        self.cycle_time, self.physics_steps = rates(model, self.drives)
        self._settle()
        self.reset()

    def _assemble(self, model: mujoco.MjModel, drives: dict[str, Drive]) -> None:
        """Set the parts of a machine; its drives are records of one array."""
        self._model, self._data = model, mujoco.MjData(model)
        self.drives = Drives(drives)
        self.axes = next(iter(drives.values())).axes
        self.couplings = np.zeros(len(drives), record.accessible(COUPLING))
        self.mechanics = np.zeros(len(drives), record.accessible(mechanics.MECHANICS))
        self.world = np.zeros(1, record.accessible(WORLD))
        self.addresses = np.array([address(self.world)])
        self.turn = Turn()
        self.probes = np.zeros(0, record.accessible(PROBE))
        self._coordinates = np.zeros(model.nq), np.zeros(model.nv)
        self._directory = np.zeros(len(drives), PDOS)
        for i, drive in enumerate(drives.values()):
            for name, pdos in (("rpdo", drive.rpdos), ("tpdo", drive.tpdos)):
                self._directory[f"{name}s"][i] = address(pdos)
                self._directory[f"{name}_count"][i] = len(pdos)
        self._residence: Residence | None = None
        # arrays whose addresses the loop has live as long as the machine
        self._alive = [
            self.axes, self.couplings, self.mechanics, self.world, self._coordinates,
            self._directory, *((drive.rpdos, drive.tpdos) for drive in drives.values()),
        ]

    def __repr__(self) -> str:
        drives = ", ".join(f"{name}={drive.model.name}" for name, drive in self.drives.items())
        cycle = f"{self.cycle_time * 1e6:g} µs"
        return f"{type(self).__name__}({drives}; cycle {cycle}, time {self.time:g} s)"

    def _settle(self) -> None:
        """Enter the addresses of all data in the WORLD, for the compiled loop."""
        world = self.world
        self._directions = mechanics.directions(self._model, self.couplings, self.mechanics)
        self._responses = np.zeros_like(self._directions)
        self._alive += [self._directions, self._responses]
        world["mj_model"], world["mj_data"] = addresses(self._model, self._data)
        for name, array in (
            ("qpos", self._coordinates[0]), ("qvel", self._coordinates[1]),
            ("mj_qpos", self._data.qpos), ("mj_qvel", self._data.qvel), ("ctrl", self._data.ctrl),
            ("axes", self.axes), ("couplings", self.couplings), ("mechanics", self.mechanics),
            ("pdos", self._directory), ("inertia", self._data.M),
            ("passive", self._data.qfrc_passive), ("acceleration", self._data.qacc),
            ("smooth_acceleration", self._data.qacc_smooth),
            ("stiffness", self._model.jnt_stiffness), ("damping", self._model.dof_damping),
            ("directions", self._directions), ("responses", self._responses),
        ):
            world[name] = address(array)
        for name, offset in OPTIONS.items():
            world[f"option_{name}"] = address(self._model.opt.gravity) + offset
        world["rne_flag"] = address(self._data.energy) + RNE_FLAG
        world["act_callbacks"] = _has_act_callbacks(self._model)
        world["timestep"] = self._model.opt.timestep
        world["response_row"] = self._responses.strides[0]
        world["nq"], world["nv"], world["nu"] = self._model.nq, self._model.nv, self._model.nu
        world["inertias"], world["guides"] = len(self._data.M), self._model.ntendon
        world["joints"], world["drives"] = self._model.njnt, len(self.axes)

    @property
    def data(self) -> mujoco.MjData:
        """State of the physics. Its ``timer`` counts calls but not durations, see `clock`."""
        if self._residence:
            with self.turn:
                loop.enter(self.addresses)
        return self._data

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model. After changing masses, call `mujoco.mj_setConst`."""
        if self._residence:
            with self.turn:
                loop.enter(self.addresses)
        return self._model

    def share(self, residence: "Residence") -> None:
        """Share MjModel and MjData with other machines by taking turns; results stay bit-identical.

        This saves memory: MjData takes half a megabyte and MjModel a tenth of one, the state of an
        axis only some kilobytes.

        Args:
            residence: residence of this machine, or of one that differs only in `VARIABLE`.

        Raises:
            ValueError: the residence belongs to another kind of machine.
        """
        if residence.checksum != checksum(self.model):
            raise ValueError("the residence is of another machine: build both alike")
        state = np.empty(mujoco.mj_stateSize(self._model, STATE))
        mujoco.mj_getState(self._model, self._data, state, STATE)
        kept = np.concatenate([array.ravel() for array in variable(self._model)])
        self._model, self._data = residence.model, residence.data
        own = state, kept, residence.fields, residence.resident
        for name, array in zip(("state", "kept", "fields", "resident"), own, strict=True):
            self.world[name] = address(array)
        self.world["field_count"] = len(residence.fields)
        self._residence, self.turn = residence, residence.turn
        residence.alive += [self.world, state, kept]
        self._settle()

    def probe(self) -> np.ndarray:
        """Return PROBE records, one per drive, for the loop; `probe.begin` starts a recording."""
        self.probes = np.zeros(len(self.axes), record.accessible(PROBE))
        self.probes["jerk_ticks"] = 1
        self._alive.append(self.probes)
        self.world["probes"] = address(self.probes)
        return self.probes

    @classmethod
    def from_mjcf(
        cls, mjcf: str | Path, drives: Mapping[str, str | Path | DriveModel], *,
        gears: Mapping[str, float] | None = None, folder: str | Path | None = None,
    ) -> "Machine":
        """Build a machine from the MJCF of any robot: a file, or text that begins with ``<``.

        Position, velocity and other actuators become motors, a joint without an actuator gets one,
        and the timestep is shortened to fit the drives; the module `mjcf` has the details.
        `commission_joint` sets the parameters of a drive for its joint.

        Args:
            mjcf: path or text of the model.
            drives: drive model (name, folder or `DriveModel`) by actuator or joint name.
            gears: rad of motor shaft per m (slide) or rad (hinge), by drive name. By default the
                gear of a plain motor is kept, others get 100 rad/rad or a ball screw of 20 mm lead.
            folder: folder that must contain all includes, meshes and textures; by default the
                folder of the file, for text the working directory.

        Raises:
            ValueError: something does not fit; the message says what, and how to correct it.
        """
        text = str(mjcf)
        try:
            spec = read(mjcf, folder)
            models = {
                name: load(drive)
                for name, drive in named("drives", drives, '{"joint": "generic"}').items()
            }
            if models:
                attach(spec, models, {} if gears is None else gears)
            return cls(compiled(spec), models)
        except ValueError as error:
            name = text if len(text) < 200 else "MJCF"
            said = str(error)
            raise ValueError(said if said.startswith(name) else f"{name}: {said}") from None

    @property
    def time(self) -> float:
        """Time since the last reset (s)."""
        return int(self.world["tick"][0]) * float(self.world["timestep"][0])

    def joint(self, name: str) -> tuple[float, str]:
        """Return a drive's gear (rad of motor shaft per m or rad of joint), and "m" or "rad"."""
        coupling = self.coupling(name)
        return float(coupling.gear), unit(self._model, self._model.dof_jntid[coupling.dof])

    def range(self, name: str) -> tuple[float, float]:
        """Return the ends of a drive's joint (m or rad); infinite where there is no end.

        Raises KeyError if there is no drive of that name.
        """
        joint = self.mechanics[self.number(name)]
        return float(joint.low), float(joint.high)

    def number(self, name: str) -> int:
        """Place of a drive in the arrays. Raises KeyError if there is no drive of that name."""
        return [*self.drives.values()].index(self.drives[name])

    def coupling(self, name: str) -> Any:
        """The COUPLING record of a drive. Raises KeyError if there is no drive of that name."""
        return self.couplings[self.number(name)]

    def step(self, cycles: int = 1) -> None:
        """Run `cycles` position-controller cycles of the slowest drive; Ctrl-C ends it in between.

        Raises:
            ValueError: `cycles` is not a whole number of 0 or more, or the machine's records have
                been damaged.
            mujoco.FatalError: MuJoCo reports an error, such as a full arena. An exception in a
                MuJoCo callback is raised as it is. In both cases the machine refuses to step until
                `reset` or `restore`.
        """
        ticks = whole("cycles", cycles, 0, MOST) * self.physics_steps
        with self.turn:
            try:
                loop.run(self.addresses, ticks, NO_IMAGES, NO_IMAGES)
            except KeyboardInterrupt:
                left = -int(self.world["tick"][0]) % self.physics_steps
                if self.world["status"][0] == loop.SOUND:
                    loop.run(self.addresses, left, NO_IMAGES, NO_IMAGES)
                raise

    def replay(
        self, rows: Mapping[str, Any], read: Sequence[str] = READ, *,
        drive: str | None = None, arrives: Any = None,
    ) -> dict[str, np.ndarray]:
        """Play the set-points of a log into a drive, one row per position cycle, compiled.

        The machine continues from its present state, enabled or not.
        `servogym.envs.twin.experiment` turns the log of a bus into rows and brings a machine into
        the state in which the log begins.

        Args:
            rows: columns by variable of the drive (drive units), such as ``controlword`` and
                ``target_position``, each of shape ``(n,)``.
            read: fields of the drive's record (SI units), or ``od.`` followed by a variable.
            drive: name of the drive; by default the first one.
            arrives: whether a process image arrives with each row, shape ``(n,)``; by default
                with every row.

        Returns:
            The columns `read` by name, sampled after each row, shape ``(n,)``.

        Raises:
            ValueError: an unknown name, columns of different lengths.
        """
        name = next(iter(self.drives)) if drive is None else drive
        self.number(name)
        layout = Replay(name, [*rows], read)
        found = layout.run([self], rows_of(rows), arrives)[0]
        return {each: found[each] for each in read}

    def reset(self, positions: Mapping[str, float] | None = None) -> None:
        """Switch the machine off and on again, at rest, with joints at `positions`.

        The drives keep their parameters and PDO mappings; they are disabled and not referenced.

        Args:
            positions: joint position by drive name (m or rad); other joints start where the MuJoCo
                model has them.

        Raises:
            ValueError: there is no drive of that name, or a position is not finite or out of range.
        """
        places = {}
        for name, position in named("positions", positions, '{"x": 0.1}').items():
            if name not in self.drives:
                raise ValueError(
                    f"positions: there is no drive {name!r}: {hint(name, self.drives)}"
                )
            coupling = self.coupling(name)
            joint = self.model.dof_jntid[coupling.dof]
            low, high = self.range(name)
            if not (isinstance(position, Real) and low <= float(position) <= high):
                raise ValueError(
                    f"positions[{name!r}] = {position!r} is out of the joint's range "
                    f"{low:g}..{high:g} {unit(self.model, joint)}"
                )
            places[int(coupling.qpos)] = float(position)
        with self.turn:
            self._reset(places)

    def _reset(self, places: Mapping[int, float]) -> None:
        mujoco.mj_resetData(self.model, self.data)
        for place, position in places.items():
            self.data.qpos[place] = position
        for drive in self.drives.values():
            drive.reset(keep_parameters=True)
        for field in mechanics.MEMORY:
            self.mechanics[field] = 0
        loop.settle(self.axes, self.couplings, self.mechanics, self.data.qpos)
        mujoco.mj_forward(self.model, self.data)
        self.world["tick"] = 0
        self.world["status"] = loop.SOUND

    def _identity(self) -> dict[str, Any]:
        return {
            "kind": "machine", "drives": {n: d.model.name for n, d in self.drives.items()},
            "MjModel": checksum(self.model), "layout": LAYOUT,
        }

    def snapshot(self) -> bytes:
        """Return the complete state as bytes; `restore` continues from it bit by bit.

        Of MjModel it contains what randomisation changes and what MuJoCo derives from that (masses,
        friction, damping, stiffness, lengths, gears). Everything else must be the same in the
        machine that restores it.

        Raises:
            RuntimeError: a step failed, and the machine has not been reset since.
        """
        with self.turn:
            if self.world["status"][0] != loop.SOUND:
                raise RuntimeError(f"no snapshot can be taken: {loop.RESET}")
            state = np.empty(mujoco.mj_stateSize(self.model, STATE))
            mujoco.mj_getState(self.model, self.data, state, STATE)
            fields = np.concatenate([array.ravel() for array in variable(self.model)])
            arrays = self.couplings, self.mechanics, fields, state
            parts = [drive.snapshot() for drive in self.drives.values()]
            numbers = {name: int(self.world[name][0]) for name in NUMBERS}
            parts += [array.tobytes() for array in arrays]
            return snapshots.seal(self._identity(), numbers, parts)

    def restore(self, snapshot: bytes) -> None:
        """Restore the state of a `snapshot`.

        Raises:
            ValueError: not a snapshot, altered, or of another machine; nothing changes.
        """
        with self.turn:
            drives = list(self.drives.values())
            sizes = [
                *[None] * len(drives), self.couplings.nbytes, self.mechanics.nbytes,
                sum(array.nbytes for array in variable(self.model)),
                8 * mujoco.mj_stateSize(self.model, STATE),
            ]
            numbers, parts = snapshots.unseal(snapshot, self._identity(), NUMBERS, sizes)
            opened = [drive.opened(part) for drive, part in zip(drives, parts, strict=False)]
            couplings, joints, fields, state = parts[len(drives) :]
            for drive, taken in zip(drives, opened, strict=True):
                drive.take(taken)
            self.couplings[:] = np.frombuffer(couplings, COUPLING)
            self.mechanics[:] = np.frombuffer(joints, mechanics.MECHANICS)
            at, values = 0, np.frombuffer(fields)
            for array in variable(self.model):
                array.ravel()[:] = values[at : at + array.size]
                at += array.size
            mujoco.mj_setState(self.model, self.data, np.frombuffer(state), STATE)
            for name, number in numbers.items():
                self.world[name] = number
            self.world["status"] = loop.SOUND

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy or a pickle is a machine of its own in the present state, without probes."""
        with self.turn:
            drives = {n: (d.model, d.node_id, d.parameters.file) for n, d in self.drives.items()}
            rates = self.cycle_time, self.physics_steps
            return _rebuild, (copy.copy(self.model), drives, rates, self.snapshot())


def _rebuild(
    model: mujoco.MjModel, drives: dict[str, tuple], rates: tuple[float, int], snapshot: bytes
) -> Machine:
    machine = Machine.__new__(Machine)
    axes = record.make(len(drives))
    machine._assemble(
        model,
        {
            name: Drive(drive, axes=axes, index=i, node_id=node_id, parameter_file=file)
            for i, (name, (drive, node_id, file)) in enumerate(drives.items())
        },
    )
    machine.cycle_time, machine.physics_steps = rates
    machine.restore(snapshot)
    machine._settle()
    mujoco.mj_fwdPosition(machine.model, machine.data)  # not `mj_forward`, which warms the solver
    return machine


def _integrator(model: mujoco.MjModel) -> str:
    try:
        return mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    except ValueError:
        return str(model.opt.integrator)


def _has_act_callbacks(model: mujoco.MjModel) -> bool:
    return any(np.any(getattr(model, name) == int(user)) for name, user in USER_LAWS)


NUMBERS = {"tick": Key(int, True), "delay": Key(int, True)}  # of a snapshot, besides the arrays
LAYOUT = zlib.crc32(repr((COUPLING.descr, mechanics.MECHANICS.descr)).encode())
