"""Machine: a MuJoCo model whose actuators are moved by emulated drives."""

import math
import zlib
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from ..drive import record
from ..drive.drive import Drive
from ..drive.model import DriveModel, load
from . import loop, mechanics
from .mechanics import numeric
from .memory import address
from .mjcf import actuator_of, attach
from .physics import STATE, addresses
from .probe import PROBE

SWITCHES = ("negative_limit_switch", "positive_limit_switch", "home_switch")
VERSION = 2  # of the snapshot layout
# of MjModel, what may differ between machines that share one
VARIABLE = (
    "body_pos", "body_ipos", "body_mass", "body_subtreemass", "body_inertia", "body_invweight0",
    "jnt_stiffness", "dof_damping", "dof_frictionloss", "dof_invweight0", "dof_M0", "geom_pos",
    "tendon_stiffness", "tendon_frictionloss", "tendon_length0", "tendon_invweight0",
    "actuator_acc0",
)  # fmt: skip
NO_IMAGES = np.zeros((1, 0), np.uint8)


class Machine:
    """Drives attached to named actuators of a MuJoCo model, stepped in one compiled loop.

    A joint's name stands for the actuator on it; switches and brake go by the drive's name. An
    actuator that gets a drive is a plain motor on a slide or hinge joint. Its gear is the
    mechanics: rad of motor shaft per m or rad of joint, so the drive sees a shaft and gives a
    torque in Nm. Its control range is lifted, because the drive has limits of its own. The MJCF
    may wire switches and a holding brake to an actuator by name::

        <custom>
          <numeric name="x.negative_limit_switch" data="-1 -0.005 0.0003"/>  from, to, hysteresis
          <numeric name="x.home_switch" data="0.2 0.23 0.0003"/>
          <numeric name="z.brake_torque" data="3"/>                          Nm at the shaft
        </custom>

    What else there may be, friction, backlash and more, is in `mechanics`; ``mechanics`` of a
    machine is its MECHANICS records, one a drive, with the energy of impacts on the end stops.

    Args:
        model: the MuJoCo model; its own from now on.
        drives: drive model (name, folder or `DriveModel`) by actuator or joint name.

    Raises:
        ValueError: names what does not fit and how to mend it, before the first cycle.
    """

    def __init__(
        self, model: mujoco.MjModel, drives: Mapping[str, str | Path | DriveModel]
    ) -> None:
        if not drives:
            raise ValueError(f"drives is empty: name at least one actuator of {_actuators(model)}")
        self._model = model
        # A state that is not finite must reach the drive as a dead encoder, not vanish in a reset.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._data = mujoco.MjData(model)
        self.axes = record.make(len(drives))
        self.drives = {
            name: Drive(drive, axes=self.axes, index=i, node_id=i + 1)
            for i, (name, drive) in enumerate(drives.items())
        }
        self.couplings = np.zeros(len(drives), record.accessible(loop.COUPLING))
        for (name, drive), coupling in zip(self.drives.items(), self.couplings, strict=True):
            _couple(model, name, drive, coupling)
        self.mechanics = np.zeros(len(drives), record.accessible(mechanics.MECHANICS))
        for name, coupling, joint in zip(drives, self.couplings, self.mechanics, strict=True):
            mechanics.fit(model, name, coupling, joint)
        self.cycle_time, self.physics_steps = _rates(model, self.drives)
        self._identity = _identity(model, self.drives)
        self._directory = np.zeros(len(drives), loop.PDOS)
        for i, drive in enumerate(self.drives.values()):
            for name, pdos in (("rpdo", drive.rpdos), ("tpdo", drive.tpdos)):
                self._directory[f"{name}s"][i] = address(pdos)
                self._directory[f"{name}_count"][i] = len(pdos)
        self.world = np.zeros(1, record.accessible(loop.WORLD))
        self.addresses = np.array([address(self.world)])
        self._coordinates = np.zeros(model.nq), np.zeros(model.nv)
        self._shared: tuple[np.ndarray, ...] = ()
        self.probes = np.zeros(0, record.accessible(PROBE))
        self._settle()
        self.reset()

    def _settle(self) -> None:
        """Tell the compiled loop where everything is."""
        world = self.world
        world["mj_model"], world["mj_data"] = addresses(self._model, self._data)
        for name, array in (
            ("qpos", self._coordinates[0]), ("qvel", self._coordinates[1]),
            ("mj_qpos", self._data.qpos), ("mj_qvel", self._data.qvel), ("ctrl", self._data.ctrl),
            ("frictionloss", self._model.dof_frictionloss), ("axes", self.axes),
            ("couplings", self.couplings), ("mechanics", self.mechanics),
            ("pdos", self._directory), ("inertia", self._data.M),
            ("applied", self._data.qfrc_applied), ("stiffness", self._model.jnt_stiffness),
            ("damping", self._model.dof_damping),
            ("guide_friction", self._model.tendon_frictionloss),
        ):  # fmt: skip
            world[name] = address(array)
        world["timestep"] = self._model.opt.timestep
        world["nq"], world["nv"], world["nu"] = self._model.nq, self._model.nv, self._model.nu
        world["drives"] = len(self.drives)

    @property
    def data(self) -> mujoco.MjData:
        """The state of the physics."""
        if self._shared:
            loop.enter(self.addresses)
        return self._data

    @property
    def model(self) -> mujoco.MjModel:
        """The model; what depends on its masses is up to date after `mujoco.mj_setConst`."""
        if self._shared:
            loop.enter(self.addresses)
        return self._model

    def share(self, other: "Machine", resident: np.ndarray) -> None:
        """Live in MjModel and MjData of `other` by turns, bit by bit as if alone.

        MjData takes half a megabyte and MjModel a tenth, an axis with its state some kilobytes.

        Args:
            other: a machine of the same structure, or this one.
            resident: who lives there now, shape ``(1,)`` int64, one array for all of them; 0 at
                the beginning.
        """
        state = np.empty(mujoco.mj_stateSize(self._model, STATE))
        mujoco.mj_getState(self._model, self._data, state, STATE)
        own = [getattr(self._model, name) for name in VARIABLE]
        kept = np.concatenate([array.ravel() for array in own])
        self._model, self._data = other.model, other.data
        fields = np.zeros(len(VARIABLE), loop.FIELD)
        for field, name in zip(fields, VARIABLE, strict=True):
            array = getattr(self._model, name)
            field["address"], field["length"] = address(array), array.size
        self._shared = state, kept, fields, resident
        for name, array in zip(("state", "kept", "fields", "resident"), self._shared, strict=True):
            self.world[name] = address(array)
        self.world["field_count"] = len(fields)
        self._settle()

    def probe(self) -> np.ndarray:
        """PROBE records, one a drive, that the loop fills from now on; `probe.begin` starts one."""
        self.probes = np.zeros(len(self.drives), record.accessible(PROBE))
        self.world["probes"] = address(self.probes)
        return self.probes

    @classmethod
    def from_mjcf(
        cls,
        mjcf: str | Path,
        drives: Mapping[str, str | Path | DriveModel],
        *,
        gears: Mapping[str, float] | None = None,
    ) -> "Machine":
        """A machine from any robot's MJCF: a file, or text (anything that begins with ``<``).

        Position, velocity and other actuators become motors, a joint without one gets one, and the
        timestep is shortened to fit the drives; `mjcf` says it in full. `commission_joint` sets
        the drive's parameters for the joint.

        Args:
            mjcf: the model.
            drives: drive model (name, folder or `DriveModel`) by actuator or joint name.
            gears: rad of motor shaft per m (slide) or rad (hinge), by drive name; if not given that
                of a plain motor, else 100 rad/rad or a ball screw of 20 mm lead.

        Raises:
            ValueError: names what does not fit and how to mend it, before the first cycle.
        """
        text = str(mjcf)
        try:
            if text.lstrip().startswith("<"):
                spec = mujoco.MjSpec.from_string(text)
            elif Path(text).is_file():
                spec = mujoco.MjSpec.from_file(text)
            else:
                raise ValueError(f"there is no MJCF file {text}")
            models = {name: load(drive) for name, drive in drives.items()}
            if models:
                attach(spec, models, gears or {})
            return cls(spec.compile(), models)
        except ValueError as error:
            raise ValueError(f"{text if len(text) < 200 else 'MJCF'}: {error}") from None

    @property
    def time(self) -> float:
        """Time since the reset (s)."""
        return int(self.world["tick"][0]) * self.model.opt.timestep

    def step(self, cycles: int = 1) -> None:
        """Run `cycles` position-controller cycles of the slowest drive."""
        loop.run(self.addresses, cycles * self.physics_steps, NO_IMAGES, NO_IMAGES)

    def reset(self, positions: Mapping[str, float] | None = None) -> None:
        """Power off and on again, at rest, the joints of the named drives at `positions`.

        The drives keep their parameters and PDO mapping; they are disabled and not referenced.

        Args:
            positions: joint position by drive name (m or rad); the model's own if not named.

        Raises:
            ValueError: a name without a drive, a position that is not finite or out of the range.
        """
        places = {}
        for name, position in (positions or {}).items():
            if name not in self.drives:
                raise ValueError(f"positions: there is no drive {name!r}, only {[*self.drives]}")
            coupling = self.couplings[list(self.drives).index(name)]
            joint = self.model.dof_jntid[coupling.dof]
            number = list(self.drives).index(name)
            low, high = (float(self.mechanics[end][number]) for end in ("low", "high"))
            if not math.isfinite(position) or not low <= position <= high:
                raise ValueError(
                    f"positions[{name!r}] = {position} is out of the joint's range "
                    f"{low:g}..{high:g} {_unit(self.model, joint)}"
                )
            places[int(coupling.qpos)] = float(position)
        mujoco.mj_resetData(self.model, self.data)
        for place, position in places.items():
            self.data.qpos[place] = position
        for drive in self.drives.values():
            drive.reset(keep_parameters=True)
        for coupling, joint in zip(self.couplings, self.mechanics, strict=True):
            guided = joint.guide >= 0
            friction = coupling.brake_friction + (0.0 if guided else coupling.friction)
            self.model.dof_frictionloss[coupling.dof] = friction
        for field in mechanics.WATCHED:
            self.mechanics[field] = 0
        loop.settle(self.axes, self.couplings, self.mechanics, self.data.qpos)
        mujoco.mj_forward(self.model, self.data)
        self.world["tick"] = 0

    def snapshot(self) -> bytes:
        """Everything the machine is, as bytes; `restore` continues bit by bit the same."""
        state = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, state, STATE)
        parts = [drive.snapshot() for drive in self.drives.values()]
        parts += [self.couplings.tobytes(), self.mechanics.tobytes()]
        parts += [self.model.dof_frictionloss.tobytes(), state.tobytes()]
        head = [VERSION, int(self.world["tick"][0]), self._identity, *(len(part) for part in parts)]
        return " ".join(map(str, head)).encode() + b"\n" + b"".join(parts)

    def restore(self, snapshot: bytes) -> None:
        """Become what `snapshot` was. Raises ValueError for one of another machine."""
        head, _, body = snapshot.partition(b"\n")
        own, *_ = self.snapshot().partition(b"\n")
        numbers, expected = head.split(), own.split()
        if len(numbers) < 2 or numbers[0] != expected[0] or numbers[2:] != expected[2:]:
            raise ValueError(
                f"this snapshot is of another machine or version ({head[:80]!r}), this machine "
                f"takes {own!r}: take a new one"
            )
        parts, at = [], 0
        for size in map(int, numbers[3:]):
            parts.append(body[at : at + size])
            at += size
        if at != len(body):
            raise ValueError(f"this snapshot has {len(body)} bytes, {at} were expected")
        for drive, part in zip(self.drives.values(), parts, strict=False):
            drive.restore(part)
        couplings, joints, friction, state = parts[len(self.drives) :]
        self.couplings[:] = np.frombuffer(couplings, loop.COUPLING)
        self.mechanics[:] = np.frombuffer(joints, mechanics.MECHANICS)
        self.model.dof_frictionloss[:] = np.frombuffer(friction)
        mujoco.mj_setState(self.model, self.data, np.frombuffer(state), STATE)
        self.world["tick"] = int(numbers[1])


def _actuators(model: mujoco.MjModel) -> list[str]:
    return [model.actuator(i).name for i in range(model.nu)]


def _unit(model: mujoco.MjModel, joint: int) -> str:
    return "m" if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE) else "rad"


def _identity(model: mujoco.MjModel, drives: Mapping[str, Drive]) -> int:
    """A checksum that tells machines apart."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    names = " ".join(f"{name}={drive.model.name}" for name, drive in drives.items())
    return zlib.crc32(names.encode(), zlib.crc32(buffer.tobytes()))


def _couple(model: mujoco.MjModel, name: str, drive: Drive, coupling) -> None:
    """Fill the coupling of the drive on actuator `name`."""
    number = actuator_of(model, name)
    joint = model.actuator_trnid[number, 0]
    on_joint = model.actuator_trntype[number] == int(mujoco.mjtTrn.mjTRN_JOINT)
    sliding = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
    if not on_joint or model.jnt_type[joint] not in sliding:
        raise ValueError(
            f"actuator {name!r} does not act on a slide or hinge joint: "
            f'a drive needs <motor name="{name}" joint="..." gear="..."/>'
        )
    gear = float(model.actuator_gear[number, 0])
    if not math.isfinite(gear) or gear == 0.0:
        raise ValueError(
            f"actuator {name!r}: gear = {gear} rad/{_unit(model, joint)} must be finite and not 0; "
            "it is the motor's angle per unit of joint travel"
        )
    plain = (
        model.actuator_gaintype[number] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_gainprm[number, 0] == 1.0
        and model.actuator_biastype[number] == int(mujoco.mjtBias.mjBIAS_NONE)
        and model.actuator_dyntype[number] == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    if not plain:
        raise ValueError(
            f"actuator {name!r} is not a plain motor (gain 1, no bias, no dynamics): "
            "the drive is the controller, so use <motor> with the mechanics as its gear"
        )
    model.actuator_ctrllimited[number] = 0
    coupling.qpos = model.jnt_qposadr[joint]
    coupling.dof = model.jnt_dofadr[joint]
    coupling.ctrl = number
    coupling.gear = gear
    coupling.friction = model.dof_frictionloss[coupling.dof]
    velocity_cycle = drive.model.cycle_time["velocity"]
    coupling.velocity_steps = _whole(
        velocity_cycle, model.opt.timestep, f"velocity cycle of drive {name!r}", "physics step"
    )
    for i, switch in enumerate(SWITCHES):
        span = numeric(model, f"{name}.{switch}", 3)
        coupling.switch_from[i], coupling.switch_to[i] = span[:2] if span else (1.0, -1.0)
        coupling.switch_hysteresis[i] = span[2] if span else 0.0
    brake = numeric(model, f"{name}.brake_torque", 1)
    if brake:
        coupling.brake_friction = brake[0] * abs(gear)
        model.dof_solimp[coupling.dof, :2] = mechanics.STIFF
        drive.commission({"brake_fitted": 1})


def _whole(slow: float, fast: float, slow_name: str, fast_name: str, remedy: str = "") -> int:
    """How many times `fast` (s) fits into `slow` (s)."""
    ratio = round(slow / fast)
    if ratio < 1 or abs(ratio * fast - slow) > 1e-9 * slow:
        raise ValueError(
            f"{slow_name} = {slow * 1e6:g} µs is not a whole multiple of the {fast_name} = "
            f"{fast * 1e6:g} µs: choose another {remedy or fast_name}"
        )
    return ratio


def _rates(model: mujoco.MjModel, drives: Mapping[str, Drive]) -> tuple[float, int]:
    """The machine's cycle (s), which is the longest position cycle, and its physics steps."""
    cycles = {name: drive.model.cycle_time["position"] for name, drive in drives.items()}
    longest = max(cycles, key=lambda name: cycles[name])
    for name, cycle in cycles.items():
        _whole(
            cycles[longest],
            cycle,
            f"position cycle of drive {longest!r}",
            f"position cycle of drive {name!r}",
            "drive model for one of them",
        )
    steps = _whole(cycles[longest], model.opt.timestep, "machine cycle", "physics step")
    return cycles[longest], steps
