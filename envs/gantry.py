"""A gantry: three axes at right angles, each moved by a drive of its own.

X carries the bridge, Y the slide on it, Z hangs from the slide and has a holding brake. All three
are linear axes as `linear_axis` makes them, commissioned the same way.
"""

import math
from importlib import resources
from pathlib import Path

import mujoco

from ..drive.model import DriveModel, load
from .linear_axis import LinearAxisParameters, commission
from .machine import Machine

MJCF = Path(str(resources.files("servogym.assets"))) / "mjcf" / "gantry.xml"
AXES = ("x", "y", "z")


def gantry(
    drive: str | Path | DriveModel = "generic",
    *,
    timestep: float | None = None,
    payload: float = 2.0,
) -> Machine:
    """A `Machine` with the drives ``x``, ``y`` and ``z``; strokes 0.8 m, 0.5 m and 0.3 m.

    Position unit 1 µm; positive Z is upwards. Homing method 17 for X and Y puts the zero at the
    left end of the stroke; Z homes upwards, with method 18, and has its zero at the upper end.

    Args:
        drive: drive model by name, folder or loaded, for all axes.
        timestep: physics step (s); the velocity cycle of the drive if not given.
        payload: mass in the gripper (kg), 0..10.

    Raises:
        ValueError: unknown model, a parameter out of range, a timestep the rates do not allow.
    """
    if not 0.0 <= payload <= 10.0:
        raise ValueError(f"payload = {payload!r} is out of range 0..10 kg")
    model = load(drive)
    spec = mujoco.MjSpec.from_file(str(MJCF))
    spec.option.timestep = model.cycle_time["velocity"] if timestep is None else timestep
    spec.geom("payload").mass = payload
    parameters = LinearAxisParameters(max_velocity=0.5, max_acceleration=5.0)
    gear = 2 * math.pi / parameters.feed_constant
    for name in AXES:
        spec.joint(name).armature = model.rotor_inertia * gear**2
        spec.actuator(name).gear[0] = gear
    machine = Machine(spec.compile(), dict.fromkeys(AXES, model))
    for name in AXES:
        commission(machine, name, parameters)
    z = machine.drives["z"]
    z.commission({"homing_method": 18, "home_offset": -5_000})
    z.commission({"min_position_limit": -300_000, "max_position_limit": 0})
    machine.drives["x"].commission({"max_position_limit": 800_000})
    machine.reset()
    return machine
