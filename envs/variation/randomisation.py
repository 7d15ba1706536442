"""Domain randomisation: parameters of a machine that are drawn for each episode.

| name | meaning | unit |
|------|---------|------|
| payload | mass of the body ``payload`` | kg |
| cable_length | of the hanging load of a gantry, to its middle | m |
| friction | Coulomb and viscous friction of the driven joints | share of the nominal |
| stiffness | springs of joints and tendons | share of the nominal |
| backlash | gap of the transmission | m |
| structural_damping | viscous damping of the joints without a drive | share of the nominal |
| gains | position and velocity controller gains of the drives | share of the nominal |
| delay | of an RPDO on its way to the drives | position cycles |
| encoder_noise | standard deviation of the measured joint position | m or rad |

Every parameter of `servogym.envs.engine.parameters` that can act in the machine may be drawn as
well, alike for all of its drives: ``{"coulomb_friction": (8.0, 16.0), "viscous_friction": (10.0,
40.0)}`` draws the two frictions independently, in N and N·s/m.

A range ``(low, high)`` is drawn uniformly; a single number is always used. With a share, ``(low,
high, share)``, the range is drawn in that share of the episodes, and the others use the nominal
value.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ...drive.model.names import hint
from ..engine.machine import Machine
from ..engine.parameters import PARAMETERS, PAYLOAD, Joint

CABLE = "cable"
GAINS = ("velocity_control_gain", "position_control_gain")


class Nominal(NamedTuple):
    """The values that a machine was built with, to which factors refer."""

    friction: np.ndarray  # of the couplings, shape (n_drives,), N or Nm
    damping: np.ndarray  # of the degrees of freedom
    joint_stiffness: np.ndarray
    tendon_stiffness: np.ndarray
    gains: list[dict[str, int]]  # by object, for each drive
    joints: list[Joint]


class Knob(NamedTuple):
    """A row of the table: the permitted range, how a value is set, and which machines have it."""

    low: float
    high: float
    unit: str
    turn: Callable[[Machine, Nominal, float], None]
    nominal: Callable[[Machine], float]  # of a machine as it was built
    there: Callable[[Machine], bool] = lambda machine: True
    lacking: str = "this machine has nothing it could act in"  # said of a machine without it


def _cable_length(machine: Machine, nominal: Nominal, length: float) -> None:
    model = machine.model
    load, cable = model.geom(PAYLOAD), model.geom(CABLE)
    model.body(PAYLOAD).ipos[2] = load.pos[2] = -length
    cable.pos[2], cable.size[1] = -0.5 * length, 0.5 * length


def _hangs(machine: Machine) -> bool:
    return mujoco.mj_name2id(machine.model, mujoco.mjtObj.mjOBJ_GEOM, CABLE) >= 0


def _friction(machine: Machine, nominal: Nominal, share: float) -> None:
    machine.couplings["friction"] = share * nominal.friction
    for dof in machine.couplings["dof"]:
        machine.model.dof_damping[dof] = share * nominal.damping[dof]


def _stiffness(machine: Machine, nominal: Nominal, share: float) -> None:
    machine.model.jnt_stiffness[:] = share * nominal.joint_stiffness
    machine.model.tendon_stiffness[:] = share * nominal.tendon_stiffness


def _has_springs(machine: Machine) -> bool:
    return bool(machine.model.jnt_stiffness.any() or machine.model.tendon_stiffness.any())


def _structural_damping(machine: Machine, nominal: Nominal, share: float) -> None:
    free = _without_drive(machine)
    machine.model.dof_damping[free] = share * nominal.damping[free]


def _without_drive(machine: Machine) -> np.ndarray:
    """The degrees of freedom that no drive moves."""
    return np.setdiff1d(np.arange(machine.model.nv), machine.couplings["dof"])


def _gains(machine: Machine, nominal: Nominal, share: float) -> None:
    for drive, gains in zip(machine.drives.values(), nominal.gains, strict=True):
        drive.commission({name: gain * share for name, gain in gains.items()})


def _one(machine: Machine) -> float:
    """Return the nominal value of a factor: 1."""
    return 1.0


def _parameter(name: str, high: float | None = None, **more: Any) -> Knob:
    """A parameter of the machine, alike for all of its drives."""
    row = PARAMETERS[name]

    def turn(machine: Machine, nominal: Nominal, value: float) -> None:
        for joint in nominal.joints:
            row.set(joint, value)

    def joints(machine: Machine) -> list[Joint]:
        return [Joint(machine, drive) for drive in machine.drives]

    return Knob(
        row.low, row.high if high is None else high, row.unit, turn,
        lambda machine: max(map(row.get, joints(machine))),
        lambda machine: all(map(row.there, joints(machine))), **more,
    )


KNOBS = {
    **{name: _parameter(name) for name in PARAMETERS},
    "payload": _parameter(
        "payload", high=100.0, lacking="this machine has no body 'payload' with a mass"
    ),
    "cable_length": Knob(
        0.05, 10.0, "m", _cable_length, lambda m: -float(m.model.body(PAYLOAD).ipos[2]), _hangs,
        "the load of this machine does not hang, build it with cable_length",
    ),
    "friction": Knob(0.0, 10.0, "of the nominal friction", _friction, _one),
    "stiffness": Knob(
        0.1, 10.0, "of the nominal stiffness", _stiffness, _one, _has_springs,
        "this machine has no springs",
    ),
    "backlash": _parameter(
        "backlash", high=0.01, lacking="this machine has no elastic transmission "
        "(transmission_stiffness) the gap could lie in",
    ),
    "structural_damping": Knob(
        0.0, 10.0, "of the nominal damping", _structural_damping, _one,
        lambda m: bool(m.model.dof_damping[_without_drive(m)].any()),
        "no joint without a drive has damping here",
    ),
    "gains": Knob(0.1, 3.0, "of the nominal gains", _gains, _one),
}


class Randomisation:
    """Declared ranges of one machine, from which each episode draws its parameters.

    Args:
        machine: as it was built; its present values are the nominal ones.
        ranges: numbers, ``(low, high)`` or ``(low, high, share)`` by name.
        cycles: position cycles of a step, the longest possible delay.

    Raises:
        ValueError: an unknown name, an invalid range, one out of bounds or without effect here.
    """

    def __init__(
        self, machine: Machine, ranges: Mapping[str, float | tuple[float, ...]], cycles: int
    ):
        self._machine = machine
        model = machine.model
        self.ranges = {name: _range(name, given) for name, given in ranges.items()}
        if self.ranges.get("delay", (0.0, 0.0))[1] > cycles:
            raise ValueError(
                f"randomise['delay'] = {ranges['delay']!r} is out of range 0..{cycles} position "
                "cycles, those of a step"
            )
        for end in self.ranges.get("delay", ())[:2]:
            if (end * machine.physics_steps) % 1.0:
                raise ValueError(
                    f"randomise['delay'] = {ranges['delay']!r}: {end:g} position cycles are no "
                    f"whole number of physics steps, of which a cycle has {machine.physics_steps}"
                )
        for name in ranges:
            if not KNOBS[name].there(machine):
                raise ValueError(f"randomise[{name!r}]: {KNOBS[name].lacking}")
        self._nominal = Nominal(
            machine.couplings["friction"].copy(),
            model.dof_damping.copy(),
            model.jnt_stiffness.copy(),
            model.tendon_stiffness.copy(),
            [
                {name: drive.read(name) for name in GAINS if name in drive.objects.names}
                for drive in machine.drives.values()
            ],
            [Joint(machine, name) for name in machine.drives],
        )
        self.gains = self._nominal.gains  # as built: by object, for each drive
        self._usual = {name: KNOBS[name].nominal(machine) for name in ranges}

    def draw(self, generator: np.random.Generator) -> dict[str, float]:
        """Draw a value for each name and set it; -> the values. Reset the machine afterwards."""
        scattered = self._machine.mechanics["switch_scatter"] > 0.0
        if scattered.any():
            seeds = generator.integers(1, 2**63, len(scattered), dtype=np.uint64)
            self._machine.mechanics["switch_seed"] = seeds
        values = {}
        for name, (low, high, *share) in self.ranges.items():
            values[name] = float(generator.uniform(low, high)) if low < high else low
            if share and generator.random() >= share[0]:
                values[name] = self._usual[name]
        if "delay" in values:  # in whole physics steps
            steps = self._machine.physics_steps
            values["delay"] = round(values["delay"] * steps) / steps
        if "encoder_noise" in values:
            for coupling in self._machine.couplings:
                coupling.noise_state = generator.integers(1, 2**63)
        self.set(values)
        return values

    def set(self, values: Mapping[str, float]) -> None:
        """Set these values in the machine."""
        for name, value in values.items():
            KNOBS[name].turn(self._machine, self._nominal, value)
        if values:
            mujoco.mj_setConst(self._machine.model, self._machine.data)


def _range(name: str, given: float | tuple[float, ...]) -> tuple[float, ...]:
    if name not in KNOBS:
        raise ValueError(f"randomise: unknown name {name!r}: {hint(name, KNOBS)}")
    knob = KNOBS[name]
    try:
        low, high, *share = (float(given),) * 2 if np.ndim(given) == 0 else map(float, given)  # type: ignore
    except (TypeError, ValueError):
        low, high, share = math.nan, math.nan, []
    if not knob.low <= low <= high <= knob.high or len(share) > 1:
        raise ValueError(
            f"randomise[{name!r}] = {given!r} must be a number, (low, high) or (low, high, share) "
            f"within {knob.low:g}..{knob.high:g} {knob.unit}"
        )
    if share and not 0.0 <= share[0] <= 1.0:
        raise ValueError(f"randomise[{name!r}] = {given!r}: the share of the episodes is 0..1")
    return low, high, *share
