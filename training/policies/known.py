"""What a policy may know before an episode: its task's constants and the machine's data sheet.

Nothing here comes from the physics or from an episode. What was drawn at random is not known.
"""

import math
from dataclasses import dataclass

from ...drive.drive import Drive
from ...envs.axis_parameters import LinearAxisParameters
from ...envs.servo_env import METRE, ServoEnv
from ...envs.tasks.positioning import STROKE


@dataclass(frozen=True)
class Known:
    """Of one environment."""

    task: str  # its id
    actions: int  # components of an action
    step_time: float  # s
    steps: int  # of an episode
    speed: float  # maximum profile velocity 607Fh (m/s)
    torque: float  # maximum torque 6072h (Nm)
    rotor_inertia: float  # of the motor (kg·m²)
    axis: LinearAxisParameters | None  # nominal; None for machines that are no linear axis
    heaviest: float  # payload declared (kg)
    reference: str = ""  # of Homing-v0
    stroke: float = STROKE  # m

    @property
    def force(self) -> float:
        """That the maximum torque makes at the carriage (N)."""
        return self.torque * self.gear

    @property
    def gear(self) -> float:
        """Angle of the motor per travel (rad/m)."""
        return 2 * math.pi / self.nominal.feed_constant

    @property
    def nominal(self) -> LinearAxisParameters:
        """The data sheet. Raises ValueError where there is none."""
        if self.axis is None:
            raise ValueError(f"{self.task} has no linear axis: use hold or random")
        return self.axis

    def mass(self, payload: float) -> float:
        """What a force at the carriage accelerates, the motor included (kg)."""
        p = self.nominal
        rotor = self.rotor_inertia if p.rotor_inertia is None else p.rotor_inertia
        return p.carriage_mass + payload + (rotor + p.transmission_inertia) * self.gear**2


def known(env: ServoEnv) -> Known:
    """What a policy may know of `env`."""
    drive, task = env.drive, vars(env)
    axis = task.get("_parameters")
    if not isinstance(axis, LinearAxisParameters):
        axis = None
    payload = axis.payload if axis else 0.0
    reference = task.get("reference")
    return Known(
        task=env.ID,
        actions=math.prod(env.action_space.shape or ()),
        step_time=env.step_time,
        steps=env.STEPS,
        speed=_object(drive, "max_profile_velocity") / METRE,
        torque=_object(drive, "max_torque") * 1e-3 * _object(drive, "motor_rated_torque") * 1e-3,
        rotor_inertia=drive.model.rotor_inertia,
        axis=axis,
        heaviest=env.randomisation.ranges.get("payload", (payload, payload))[1],
        reference=reference if isinstance(reference, str) else "",
    )


def _object(drive: Drive, name: str) -> int:
    """Of the object dictionary; 0 where a drive without set-point modes does not have it."""
    return drive.read(name) if name in drive.objects.names else 0
