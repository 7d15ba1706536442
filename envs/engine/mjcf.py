"""Prepares any MJCF for drives, through `mujoco.MjSpec`.

For joints that get a drive, and only for these, the following is changed:

- An actuator that is not a plain motor (position, velocity, general, ...), or whose gear is given,
  becomes a plain motor: gain 1, no bias, no dynamics, no delay. It keeps its name and its number in
  ``data.ctrl``. A joint without an actuator gets one, the last, with the name of the joint.
- Such a motor has the gear of `gears`, otherwise that of `GEARS`; the armature of the joint becomes
  the rotor inertia of the drive model times gear². A plain motor without a control range and
  without an entry in `gears` already describes the mechanics: it keeps its gear, and the joint its
  armature. With a control range, as in robots for learning, MuJoCo's `gear` is the torque of a
  control of 1 and says nothing about a reduction: that motor gets the usual gear.
- Limits of the control, of the actuator force and of the joint's actuator force are removed,
  because the drive has limits of its own.
- The integrator RK4 becomes implicitfast, because friction and drive act once per step.
- A timestep that does not fit into the velocity cycles becomes the next shorter one that does.
- In keyframes the control of such an actuator is 0 Nm; actuator activations are dropped if their
  number changes.

Everything else stays. Other actuators obey ``data.ctrl``.
"""

import functools
import math
from collections.abc import Mapping
from numbers import Real

import mujoco

from ...drive.model.model import DriveModel
from ...drive.model.names import hint, named

GEAR_RANGE = 1e-3, 1e6  # rad per m or rad; a gear outside is a typing error
JOINT_TYPES = {mujoco.mjtJoint.mjJNT_SLIDE: "m", mujoco.mjtJoint.mjJNT_HINGE: "rad"}  # units
ON_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
# motor angle per joint travel if no gear is given
GEARS = {
    mujoco.mjtJoint.mjJNT_HINGE: 100.0,  # rad/rad; strain wave gears have 30..160 (inferred)
    mujoco.mjtJoint.mjJNT_SLIDE: 2 * math.pi / 0.02,  # rad/m; a ball screw of 20 mm lead (inferred)
}
# fields that identify an actuator; all others describe how it acts
_IDENTITY = ("name", "target", "trntype", "group", "userdata", "info", "id", "signature")
_OBJECTS = ("classname", "compiler", "plugin")


def attach(
    spec: mujoco.MjSpec, drives: Mapping[str, DriveModel], gears: Mapping[str, float]
) -> None:
    """Put a motor on the joint of every drive, as this module describes.

    Args:
        spec: the robot; changed in place.
        drives: drive model by actuator or joint name; an actuator takes precedence over a joint.
        gears: rad of motor shaft per m (slide) or rad (hinge) of the joint, by drive name.

    Raises:
        ValueError: a name that does not exist, a joint or transmission that cannot take a drive,
            two actuators or drives on one joint, or a gear out of `GEAR_RANGE`.
    """
    for name in named("gears", gears, '{"joint": 100}'):
        if name not in drives:
            raise ValueError(f"gears: there is no drive {name!r}: {hint(name, drives)}")
    names: dict[str, str] = {}  # drive by joint
    for name, drive in drives.items():
        joint, actuator = _place(spec, name)
        if joint.name in names:
            raise ValueError(
                f"drives {names[joint.name]!r} and {name!r} are both on joint {joint.name!r}: "
                "leave one out"
            )
        names[joint.name] = name
        if actuator is None or name in gears or not _plain(actuator):
            gear = _gear(name, gears.get(name, GEARS[joint.type]), JOINT_TYPES[joint.type])
            _install(spec, joint, actuator, gear)
            joint.armature = drive.rotor_inertia * gear**2
        else:
            actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT  # in its parent it is the same
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.timestep = fitting_timestep(spec.option.timestep, drives)


def fitting_timestep(timestep: float, drives: Mapping[str, DriveModel]) -> float:
    """The longest physics step (s) not above `timestep` that fits into all velocity cycles."""
    if not (math.isfinite(timestep) and timestep > 0.0):
        raise ValueError(f"option timestep = {timestep} s must be finite and above 0")
    nanoseconds = {round(drive.cycle_time["velocity"] * 1e9) for drive in drives.values()}
    cycle = functools.reduce(math.gcd, nanoseconds) * 1e-9
    steps = math.ceil(cycle / timestep - 1e-9)
    return timestep if abs(steps * timestep - cycle) < 1e-9 * cycle else cycle / steps


def actuator_of(model: mujoco.MjModel, name: str) -> int:
    """Number of the actuator `name`, otherwise of the only actuator on the joint `name`.

    Raises ValueError with the existing names.
    """
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    if number >= 0:
        return number
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    if joint < 0:
        actuators = [model.actuator(i).name for i in range(model.nu)]
        joints = [model.joint(i).name for i in range(model.njnt)]
        raise ValueError(_missing(name, actuators, joints))
    on_it = [
        i
        for i in range(model.nu)
        if model.actuator_trntype[i] in map(int, ON_JOINT) and model.actuator_trnid[i, 0] == joint
    ]
    if len(on_it) != 1:
        raise ValueError(
            f"joint {name!r} has {len(on_it)} actuators, a drive needs one: "
            "name the actuator, or use Machine.from_mjcf, which adds a missing one"
        )
    return on_it[0]


def _missing(name: str, actuators: list[str], joints: list[str]) -> str:
    return (
        f"there is no actuator or joint {name!r}: the model has "
        f"the actuators {[n for n in actuators if n]} and the joints {[n for n in joints if n]}"
    )


def _place(spec: mujoco.MjSpec, name: str):
    """The joint of the actuator or joint `name`, and its actuator or None."""
    actuator = spec.actuator(name)
    if actuator is not None and actuator.trntype not in ON_JOINT:
        kind = actuator.trntype.name.removeprefix("mjTRN_").lower()
        raise ValueError(
            f"actuator {name!r} acts on a {kind}, a drive needs a slide or hinge joint: "
            "name such a joint"
        )
    joint = spec.joint(name if actuator is None else actuator.target)
    if joint is None:
        raise ValueError(
            _missing(name, [a.name for a in spec.actuators], [j.name for j in spec.joints])
        )
    if joint.type not in JOINT_TYPES:
        kind = joint.type.name.removeprefix("mjJNT_").lower()
        raise ValueError(
            f"joint {joint.name!r} is a {kind} joint, a drive needs a slide or hinge joint: "
            "drive another one, or make hinges of it"
        )
    on_it = [a for a in spec.actuators if a.trntype in ON_JOINT and a.target == joint.name]
    if len(on_it) > 1:
        raise ValueError(
            f"joint {joint.name!r} has {len(on_it)} actuators {[a.name for a in on_it]}: "
            "the drive is its only controller, so delete all but one from the MJCF"
        )
    return joint, on_it[0] if on_it else None


def _plain(actuator) -> bool:
    """Whether an actuator is a motor with gain 1, no bias, no dynamics and no control range."""
    return (
        actuator.ctrllimited != mujoco.mjtLimited.mjLIMITED_TRUE
        and actuator.ctrlrange[0] == actuator.ctrlrange[1]
        and actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
        and actuator.gainprm[0] == 1.0
        and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
        and actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE
    )


def _gear(name: str, gear: float, unit: str) -> float:
    low, high = GEAR_RANGE
    if not isinstance(gear, Real) or not low <= abs(gear) <= high:
        raise ValueError(
            f"gears[{name!r}] = {gear!r} rad/{unit} is out of range {low:g}..{high:g}: "
            f"it is the motor's angle per {unit} of joint travel, negative to turn the direction"
        )
    return float(gear)


def _install(spec: mujoco.MjSpec, joint, actuator, gear: float) -> None:
    """Make `actuator` a plain motor with `gear`; a new one on `joint` if it is None."""
    number = len(spec.actuators) if actuator is None else spec.actuators.index(actuator)
    if actuator is None:
        actuator = spec.add_actuator(name=joint.name, target=joint.name)
    stateful = actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE
    # `set_to_motor` leaves limits, delays and the like; an actuator of an empty model has none
    pristine = mujoco.MjSpec().add_actuator()
    for field in dir(pristine):
        if not field.startswith(("_", "set_")) and field not in (*_IDENTITY, *_OBJECTS):
            setattr(actuator, field, getattr(pristine, field))
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.plugin.active = False
    actuator.ctrllimited = actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    actuator.gear = [gear, 0.0, 0.0, 0.0, 0.0, 0.0]
    for key in spec.keys:
        if len(key.ctrl):
            ctrl = [*key.ctrl, 0.0][: len(spec.actuators)]
            ctrl[number] = 0.0
            key.ctrl = ctrl
        if stateful:
            key.act = []
