"""Probe: figures of a motion, measured by the loop at every physics step and not by the drive.

`Machine.probe` creates the records; a machine without them pays one comparison per step. Every
machine also records the peaks of an agent's step and its time at a limit.
"""

import math

import numpy as np

from ...drive.kernel.jit import block
from ...drive.memory import viewer

INTERNAL_LIMIT = 0x800  # statusword bit 11
JERK_WINDOW = 5e-3  # s, over which accelerations are averaged; jerk is measured up to 100 Hz

# One record a drive. "m" stands for m (slide) or rad (hinge).
PROBE = np.dtype(
    [
        ("goal", "f8"),  # set by `begin`: goal of what is moved (m); NaN: none
        ("window", "f8"),  # half of it, around the goal (m)
        ("side", "f8"),  # direction from the start to the goal, -1 or 1
        ("unit", "f8"),  # m per position unit
        ("first", "i8"),  # coordinates behind the driven one that swing; -1: there is none
        ("second", "i8"),
        ("quiet_from", "i8"),  # ticks after which vibration counts as residual
        ("jerk_ticks", "i8"),
        ("ticks", "i8"),  # measured since `begin`
        ("outside", "i8"),  # the last tick outside the window
        ("overshoot", "f8"),  # farthest beyond the goal (m)
        ("torque_peak", "f8"),  # Nm at the shaft
        ("torque_squares", "f8"),  # sum (Nm²)
        ("error_peak", "f8"),  # following error (m)
        ("error_squares", "f8"),  # sum (m²)
        ("work", "f8"),  # positive mechanical work at the shaft (J)
        ("lowest", "f8"),  # of the residual vibration (m)
        ("highest", "f8"),
        ("velocity", "f8"),  # one jerk window ago (m/s)
        ("acceleration", "f8"),  # m/s²
        ("jerk_squares", "f8"),  # sum (m²/s⁶)
        ("jerks", "i8"),  # summed
        ("limited", "i8"),  # ticks with an internal limit active
    ],
    align=True,
)

probes_at = viewer(PROBE)


@block
def begin_step(world, axes, couplings):
    """Begin a step of an agent: its peaks start at the present values."""
    world.step_ticks = world.limited_ticks = 0
    for i in range(len(axes)):
        couplings[i].torque_peak = axes[i].torque
        couplings[i].error_peak = axes[i].od.following_error_actual_value


@block
def notice(world, axes, couplings):
    """Update the peaks of an agent's step after a physics step."""
    words = 0
    for i in range(len(axes)):
        axis, coupling = axes[i], couplings[i]
        words |= int(axis.od.statusword)
        if abs(axis.torque) > abs(coupling.torque_peak):
            coupling.torque_peak = axis.torque
        error = float(axis.od.following_error_actual_value)
        if abs(error) > abs(coupling.error_peak):
            coupling.error_peak = error
    world.step_ticks += 1
    if words & INTERNAL_LIMIT:
        world.limited_ticks += 1


@block
def observe(p, axis, coupling, timestep, qpos, qvel):
    """Update the probe of a drive after a physics step."""
    p.ticks += 1
    swing = qpos[p.first] if p.first >= 0 else 0.0
    if p.second >= 0:
        swing += qpos[p.second]
    away = qpos[coupling.qpos] + swing - p.goal
    if abs(away) > p.window:
        p.outside = p.ticks
    p.overshoot = max(p.overshoot, p.side * away)
    if p.ticks > p.quiet_from:
        p.lowest, p.highest = min(p.lowest, swing), max(p.highest, swing)
    if int(axis.od.statusword) & INTERNAL_LIMIT:
        p.limited += 1
    p.torque_peak = max(p.torque_peak, abs(axis.torque))
    p.torque_squares += axis.torque * axis.torque
    error = abs(axis.od.following_error_actual_value) * p.unit
    p.error_peak = max(p.error_peak, error)
    p.error_squares += error * error
    velocity = qvel[coupling.dof]
    p.work += max(axis.torque * velocity * coupling.gear, 0.0) * timestep
    if p.ticks % p.jerk_ticks == 0:
        window = p.jerk_ticks * timestep
        acceleration = (velocity - p.velocity) / window
        jerk = (acceleration - p.acceleration) / window
        p.velocity, p.acceleration = velocity, acceleration
        p.jerk_squares += jerk * jerk
        p.jerks += 1


def renew(machine) -> None:
    """Begin a step of an agent whose process images do not pass through the loop."""
    machine.world["step_ticks"] = machine.world["limited_ticks"] = 0
    machine.couplings["torque_peak"] = machine.axes["torque"]
    machine.couplings["error_peak"] = machine.axes["od"]["following_error_actual_value"]


def begin(
    machine, duration: float, goal: float = math.nan, window: float = 0.0, unit: float = 1e-6
) -> None:
    """Start a new recording.

    Args:
        machine: a machine with the records of `Machine.probe`.
        duration: length of the recording (s); its last quarter counts as residual vibration.
        goal: goal of the load of the first drive, behind all elasticity (m).
        window: half the width of the window around the goal (m).
        unit: m per position unit of the drives.
    """
    timestep = machine.model.opt.timestep
    machine.probes[:] = np.zeros((), PROBE)
    for i, (probe, coupling) in enumerate(zip(machine.probes, machine.couplings, strict=True)):
        springs = elastic(machine) if len(machine.probes) == 1 else []
        probe.first, probe.second = ([*springs, -1, -1])[:2]
        probe.goal, probe.window = (goal, window) if i == 0 else (math.nan, 0.0)
        place = machine.data.qpos[coupling.qpos] + sum(machine.data.qpos[q] for q in springs)
        probe.side = 1.0 if probe.goal >= place else -1.0
        probe.unit = unit
        probe.quiet_from = round(0.75 * duration / timestep)
        probe.jerk_ticks = max(round(JERK_WINDOW / timestep), 1)
        probe.lowest, probe.highest = math.inf, -math.inf


def elastic(machine) -> list[int]:
    """Coordinates of the joints without a drive, such as a transmission or a load on a spring."""
    driven = {int(coupling.qpos) for coupling in machine.couplings}
    return [q for q in range(machine.model.nq) if q not in driven]
