"""Families of mechanics, and the unknown parameters of each."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ...drive.model.model import DriveModel
from ...drive.model.names import hint
from ..engine.machine import Machine
from ..plants.catalogue import BUILDERS

GAINS = ("velocity_gain", "integral_time", "position_gain")
COMMON = ("coulomb_friction", "viscous_friction", "load_force")


@dataclass(frozen=True)
class Family:
    """A family of machines.

    Args:
        name: name of the family.
        builder: key of `BUILDERS`.
        arguments: arguments of the builder.
        axis: drive that was logged.
        mass: parameter that the inertia of the regression determines.
        spring: stiffness and damping of an unknown spring, if there is one.
        extra: further unknown parameters.
    """

    name: str
    builder: str
    arguments: Mapping[str, Any]
    axis: str = "x"
    mass: str = "payload"
    spring: tuple[str, str] | None = None
    extra: tuple[str, ...] = ()
    built: Mapping[str, Any] = field(default_factory=dict)  # by the user: --set
    objects: Mapping[str, float] = field(default_factory=dict)  # read from the drive

    @property
    def unknown(self) -> tuple[str, ...]:
        """The names of the unknown parameters, without gains and lag."""
        return (self.mass, *COMMON, *(self.spring or ()), *self.extra)

    def make(self, drive: str | DriveModel) -> Machine:
        """Build a commissioned machine of the family."""
        machine = BUILDERS[self.builder](drive, **{**self.arguments, **self.built})
        if self.objects:
            machine.drives[self.axis].commission(dict(self.objects))
        machine.step()  # commissioned values take effect in the first cycle
        return machine

    def given(
        self, built: Mapping[str, Any] | None = None, objects: Mapping[str, float] | None = None
    ) -> "Family":
        """Return the family with values given by the user, for the plant and for the drive."""
        return replace(
            self, built={**self.built, **(built or {})}, objects={**self.objects, **(objects or {})}
        )


def _linear(name: str, **more: Any) -> Family:
    return Family(name, "linear_axis", {"mechanics": name}, **more)


FAMILIES: Mapping[str, Family] = {
    family.name: family
    for family in (
        _linear("rigid"),
        # a screw behind a gear: the motor's own inertia is nearly all there is
        Family("spindle", "linear_axis", {"mechanics": "rigid"}, mass="rotor_inertia"),
        Family(
            "spring", "linear_axis",
            {"mechanics": "rigid", "stiffness": 4e4, "structural_damping": 20.0},
            spring=("load_stiffness", "load_damping"),
        ),
        _linear("toothed_belt", spring=("transmission_stiffness", "transmission_damping")),
        _linear("ball_screw"), _linear("linear_motor"), _linear("vertical"),
        _linear("rack_pinion"), _linear("ball_screw_scale"),
        Family("rotary_table", "rotary_axis", {"mechanics": "rotary_table"}, mass="inertia"),
        Family("conveyor", "rotary_axis", {"mechanics": "conveyor"}, mass="inertia"),
        *(Family(f"gantry.{axis}", "gantry", {}, axis=axis) for axis in ("x", "y", "z")),
    )
}
AUTO = ("rigid", "spring", "toothed_belt")  # that ``auto`` tries, one after the other


def family(name: str) -> Family:
    """Return a family by name. Raises ValueError if it is unknown."""
    if name not in FAMILIES:
        raise ValueError(f"--mechanics = {name!r}: {hint(name, ['auto', *FAMILIES])}")
    return FAMILIES[name]
