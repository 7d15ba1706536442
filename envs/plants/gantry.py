"""A gantry: three axes at right angles, moved by three drives, or by four with two of them in X.

X carries the bridge, Y the slide on it, Z hangs from the slide and has a holding brake. All are
linear axes and are commissioned like those of `linear_axis`. Each of two drives in X moves a
carriage on its own rail; the bridge lies on both carriages and can skew. The gripper holds the
payload, or the payload hangs from it on a cable.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import mujoco

from ...drive.drive import Drive
from ...drive.model.model import DriveModel, load
from ..engine.checks import changed, check_fields, flag, ranged
from ..engine.machine import Machine
from ..engine.physics import compiled
from ..engine.rates import physics_step
from . import own_units
from .axis_parameters import LinearAxisParameters
from .linear_axis import commission
from .loops import in_units
from .shaft import plant_at_shaft
from .sizing import largest
from .tuning import Unmovable, fitting, gains, inertias, movable, rule

MJCF = Path(str(resources.files("servogym.assets"))) / "mjcf" / "gantry.xml"
FEED_CONSTANT = 0.06  # m per motor revolution
SPAN = 0.6  # m between the rails, as in the MJCF
PAIR = ("x1", "x2")
MAX_SKEW = 0.03  # m; angles stay small, and more would tear the joints of the bridge (inferred)
# kg, between a carriage and its end of the bridge in their fastest vibration, at least: 2 kg and
# the rotor, against the 0.35 kg·m² of bridge, slide and gripper seen at the rails
VIBRATING_MASS = 1.0
# axis: (end of the stroke (m), homing method)
AXES = {"x": (0.8, 17), "x1": (0.8, 17), "x2": (0.8, 17), "y": (0.5, 17), "z": (-0.3, 18)}


@dataclass(frozen=True)
class GantryParameters:
    """Parameters of a gantry. Raises ValueError with field, value, range and unit."""

    x_drives: int = ranged(1, 1, 2, "drives in X, 1 or 2")
    payload: float = ranged(2.0, 0.0, 10.0, "kg")
    coulomb_friction: float = ranged(12.0, 0.0, 200.0, "N")  # of each driven axis
    viscous_friction: float = ranged(20.0, 0.0, 2000.0, "N·s/m")  # of each driven axis
    max_velocity: float = ranged(0.5, 1e-3, 5.0, "m/s")  # profile velocity
    max_acceleration: float = ranged(5.0, 1e-2, 50.0, "m/s²")  # of the profile
    # N/m and N·s/m, between each carriage and its end of the bridge. inferred: about 5 % damping of
    # the bridge against its carriages, in the way of motion, at some 200 Hz
    coupling_stiffness: float = ranged(4e6, 1e5, 2e7, "N/m")
    coupling_damping: float = ranged(300.0, 0.0, 1e4, "N·s/m")
    # Nm/rad and Nm·s/rad, of the joints that hold the bridge square. inferred: flexure joints, in
    # which the friction of the guides can hold the bridge skew by 2 mm, as a pinned bridge does
    skew_stiffness: float = ranged(2000.0, 0.0, 1e6, "Nm/rad")
    skew_damping: float = ranged(5.0, 0.0, 1e3, "Nm·s/rad")
    squaring_offset: float = ranged(0.0, -0.004, 0.004, "m")  # of x2's switches, ahead
    cable_length: float = ranged(0.0, 0.0, 10.0, "m, 0 or at least 0.05")  # 0: held
    sway_damping: float = ranged(0.01, 0.0, 10.0, "Nm·s/rad")  # inferred: 0.2 % of critical

    def __post_init__(self) -> None:
        check_fields(self)
        if self.x_drives not in (1, 2):
            raise ValueError(f"x_drives = {self.x_drives!r}: use 1 or 2 drives in X")
        if 0.0 < self.cable_length < 0.05:
            raise ValueError(
                f"cable_length = {self.cable_length!r} m is too short to swing: use 0 for a "
                "payload in the gripper, or 0.05..10 m"
            )
        if self.cable_length and not self.payload:
            raise ValueError("payload = 0.0 kg cannot hang on a cable: give more than 0 kg")


class Gantry(Machine):
    """A `Machine` that measures the skew of its bridge and the sway of its load."""

    def reset(self, positions: Mapping[str, float] | None = None) -> None:
        """Reset as `Machine.reset` does, with the bridge free of tension on its carriages.

        Raises ValueError also if the `positions` of x1 and x2 are more than 30 mm apart.
        """
        x1, x2 = ((positions or {}).get(name, 0.0) for name in PAIR)
        if abs(x2 - x1) > MAX_SKEW:
            raise ValueError(
                f"positions: x1 = {x1} m and x2 = {x2} m would tear the bridge: give both, at most "
                f"{MAX_SKEW:g} m apart"
            )
        super().reset(positions)
        if all(name in self.drives for name in PAIR):
            x1, x2 = (self._joint(name) for name in PAIR)
            self.data.joint("x").qpos[0] = 0.5 * (x1 + x2)
            self.data.joint("skew").qpos[0] = (x2 - x1) / SPAN
            mujoco.mj_forward(self.model, self.data)

    def _joint(self, name: str) -> float:
        """Coordinate of a joint (m or rad), 0 if there is none."""
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name)
        return float(self.data.qpos[self.model.jnt_qposadr[number]]) if number >= 0 else 0.0

    @property
    def skew(self) -> float:
        """Lead of the end of the bridge on x2 over the end on x1 (m)."""
        return self._joint("skew") * SPAN

    @property
    def sway(self) -> tuple[float, float]:
        """Angles of the cable in X and Y (rad), positive where the load is ahead of the gripper."""
        return self._joint("sway_x"), self._joint("sway_y")


def gantry(
    drive: str | Path | DriveModel = "generic",
    *,
    timestep: float | None = None,
    parameters: GantryParameters | None = None,
    tuned: bool = True,
    **values: float,
) -> Gantry:
    """Build a gantry with the drives ``x``, ``y`` and ``z``; strokes 0.8 m, 0.5 m and 0.3 m.

    With ``x_drives=2`` its drives are ``x1``, ``x2``, ``y`` and ``z``; `squaring.square` homes
    the first two. The position unit is 1 µm; positive Z is upwards. Homing method 17 for X and Y
    puts the zero at the left end of the stroke; Z homes upwards, with method 18, and has its zero
    at the upper end.

    Args:
        drive: drive model by name, folder or loaded, for all axes.
        timestep: physics step (s); by default the velocity cycle of the drive.
        parameters: `GantryParameters`, or its fields as keywords.
        tuned: as for `linear_axis`.

    Raises:
        ValueError: an unknown model, a parameter out of range, or a timestep that does not fit the
            cycles of the drive.
    """
    if parameters is None:
        parameters = changed(GantryParameters(), values, "a gantry")
    elif values:
        raise ValueError(f"parameters and {', '.join(values)} are both given: choose one way")
    model, tuned = load(drive), flag("tuned", tuned)
    names = ("x", "y", "z") if parameters.x_drives == 1 else (*PAIR, "y", "z")
    timestep = physics_step(timestep, model.cycle_time["velocity"])
    stiffest = VIBRATING_MASS * (1.5 / timestep) ** 2  # the integrator diverges at 2
    if parameters.x_drives == 2 and parameters.coupling_stiffness > stiffest:
        raise ValueError(
            f"coupling_stiffness = {parameters.coupling_stiffness:g} N/m is too stiff for "
            f"timestep = {timestep:g} s: use {stiffest:.3g} N/m at most, or a shorter timestep"
        )
    try:
        machine = _made(model, parameters, timestep, names, tuned)
    except Unmovable as error:

        def moves(payload: float) -> bool:
            lighter = replace(parameters, payload=payload)
            return movable(lambda: _made(model, lighter, timestep, names, tuned))

        raise ValueError(
            f"payload = {parameters.payload:g} kg: {error}; "
            f"it takes {largest(moves, parameters.payload):.3g} kg"
        ) from None
    machine.reset()
    return machine


def _made(
    drive: DriveModel, p: GantryParameters, timestep: float, names: tuple[str, ...], tuned: bool
) -> Gantry:
    """Build and commission a gantry. Raises Unmovable if a motor or drive cannot move it."""
    machine = Gantry(_plant(p, drive, timestep, names), dict.fromkeys(names, drive))
    for name, axis in machine.drives.items():
        _commission(machine, name, axis, p, tuned)
    return machine


def _plant(
    p: GantryParameters, drive: DriveModel, timestep: float, names: tuple[str, ...]
) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(MJCF))
    spec.option.timestep = timestep
    gear = 2 * math.pi / FEED_CONSTANT
    for name in names:
        joint = spec.joint(name)
        joint.armature = drive.rotor_inertia * gear**2
        joint.frictionloss = p.coulomb_friction
        joint.damping[0] = p.viscous_friction
        spec.actuator(name).gear[0] = gear
    if p.x_drives == 1:
        _leave_carriages_out(spec)
    else:
        _lay_bridge_on_carriages(spec, p)
    spec.geom("payload").mass = p.payload
    if p.cable_length > 0.0:
        _hang(spec, p)
    return compiled(spec)


def _leave_carriages_out(spec: mujoco.MjSpec) -> None:
    for part in (
        *(spec.actuator(name) for name in PAIR), spec.tendon("end1"), spec.tendon("end2"),
        spec.joint("skew"), spec.body("carriage1"), spec.body("carriage2"),
    ):
        spec.delete(part)


def _lay_bridge_on_carriages(spec: mujoco.MjSpec, p: GantryParameters) -> None:
    """Move the drives, the friction and the end stops from the bridge to the carriages."""
    spec.delete(spec.actuator("x"))
    bridge, skew = spec.joint("x"), spec.joint("skew")
    bridge.armature = bridge.frictionloss = bridge.damping[0] = 0.0
    bridge.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    skew.stiffness[0], skew.damping[0] = p.skew_stiffness, p.skew_damping
    for name in ("end1", "end2"):
        end = spec.tendon(name)
        end.stiffness[0], end.damping[0] = p.coupling_stiffness, p.coupling_damping
        end.springlength = [0.0, 0.0]  # otherwise it would rest at the skew of qpos0
    for numeric in spec.numerics:
        if numeric.name.startswith("x2."):
            low, high, hysteresis = numeric.data
            numeric.data = [low + p.squaring_offset, high + p.squaring_offset, hysteresis]


def _hang(spec: mujoco.MjSpec, p: GantryParameters) -> None:
    """Hang the payload on a cable: a pendulum with the joints ``sway_x`` and ``sway_y``."""
    body, box = spec.body("payload"), spec.geom("payload")
    # turned so that a positive angle is the load ahead in X or in Y
    for name, axis in (("sway_x", [0, -1, 0]), ("sway_y", [1, 0, 0])):
        joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        joint.damping[0] = p.sway_damping
        joint.armature = joint.frictionloss = 0.0
    box.pos = [0, 0, -p.cable_length]
    body.add_geom(
        name="cable", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.003, 0, 0],
        fromto=[0, 0, 0, *box.pos], mass=0.0, rgba=[0.2, 0.2, 0.2, 1], contype=0, conaffinity=0,
        group=1,
    )


def _commission(machine: Gantry, name: str, drive: Drive, p: GantryParameters, tuned: bool) -> None:
    axis = LinearAxisParameters(
        feed_constant=FEED_CONSTANT, max_velocity=p.max_velocity,
        max_acceleration=p.max_acceleration, payload=p.payload,
    )
    commission(machine, name, axis, tuned and name not in PAIR)  # the pair is tuned below
    if not drive.model.positions:
        return  # its motor and its ramps are parameters of its own
    end, method = AXES[name]
    offset = -5_000 if method == 18 else 5_000
    limits = sorted((0, round(end * 1e6)))
    if name in PAIR:
        _prepare_for_squaring(machine, name, drive, tuned)
        offset -= round(p.squaring_offset * 1e6) if name == "x2" else 0
    own_units.commission(
        drive,
        {"homing_method": method, "home_offset": offset,
         "min_position_limit": limits[0], "max_position_limit": limits[1]},
        _micrometre(machine, name),
    )


def _micrometre(machine: Gantry, name: str) -> float:
    """1 µm at the shaft (rad)."""
    return abs(float(machine.coupling(name).gear)) * 1e-6


def _prepare_for_squaring(machine: Gantry, name: str, drive: Drive, tuned: bool) -> None:
    """Tune a drive of the pair with half of the bridge as its load, and slow its search."""
    coupling = machine.coupling(name)
    bridge = machine.model.body_subtreemass[machine.model.body("bridge").id]
    inertia = inertias(machine, name)[0] + 0.5 * float(bridge) / float(coupling.gear) ** 2
    drive.commission(gains(drive, inertia))
    if tuned:  # for both ways to move: side by side, and one against the other
        signs = [dict(zip(PAIR, (1.0, sign), strict=True)) for sign in (1.0, -1.0)]
        plants = [plant_at_shaft(machine, each) for each in signs]
        found = fitting(plants, drive, rule(drive, inertia), 0.0)
        if found is None:
            raise Unmovable(
                f"drives {' and '.join(PAIR)} ({drive.model.name}) have no gains that keep their "
                "margins with this beam: a stiffer coupling would do"
            )
        drive.commission(in_units(drive, found))
    own_units.commission(
        drive, {"speed_during_search_for_switch": 50_000, "homing_acceleration": 2_000_000},
        _micrometre(machine, name),
    )
