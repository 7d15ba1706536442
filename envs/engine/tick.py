"""One physics step of a machine without MuJoCo: the drives and joints around its two halves.

`control` runs before the step, `forces` between its halves, followed by `friction`, and `finish`
and `count` after it. They are compiled into `loop`, where a machine steps alone, and into `worlds`,
where mujoco-warp steps many at once, and use only numbers, records and arrays.
"""

import math

import numpy as np

from ...drive.kernel.cycle import velocity_cycle
from ...drive.kernel.jit import block
from ...drive.kernel.process_data import PDO, collect, latch
from ...drive.kernel.record import AXIS
from ...drive.memory import bytes_at, floats_at, viewer
from . import mechanics
from .arrays import axes_at, couplings_at, reals_at
from .friction import limited, remember
from .mechanics import mechanics_at
from .probe import notice, observe, probes_at
from .world import PDOS, WORLD

AXIS_SIZE = AXIS.itemsize
FARTHEST = 1e9  # m or rad; beyond it, or at NaN, the physics has failed and stands still
NEGATIVE, POSITIVE, HOME = range(3)  # places in the arrays of a coupling's switches

world_at = viewer(WORLD)
directory_at = viewer(PDOS)
pdos_at = viewer(PDO)


@block
def normal(coupling):
    """The next number of a normal distribution: xorshift64*, and the polar form of Box-Muller."""
    while True:
        u, v = _uniform(coupling), _uniform(coupling)
        s = u * u + v * v
        if 0.0 < s < 1.0:
            return u * math.sqrt(-2.0 * math.log(s) / s)


@block
def load_noise(world):
    """Noise of a sensor at the load (m), with the standard deviation of the first encoder."""
    coupling = couplings_at(world.couplings, 1)[0]
    return coupling.noise * normal(coupling) if coupling.noise > 0.0 else 0.0


@block
def _uniform(coupling):
    """A uniform number in -1..1 (Vigna, An experimental exploration of Marsaglia's xorshift)."""
    state = np.uint64(coupling.noise_state)
    state ^= state >> np.uint64(12)
    state ^= state << np.uint64(25)
    state ^= state >> np.uint64(27)
    coupling.noise_state = state
    return (state >> np.uint64(11)) * 2.0**-52 - 1.0


@block
def sense(axis, coupling, m, qpos):
    """Feed the shaft angle of a joint and the switches at its carriage to the drive."""
    measured = qpos[coupling.qpos]
    if coupling.noise > 0.0:
        measured += coupling.noise * normal(coupling)
    axis.shaft_angle = measured * coupling.gear
    place = mechanics.carriage(m, coupling, qpos)
    axis.load_angle = (measured + place - qpos[coupling.qpos]) * coupling.gear
    for i in range(3):
        at = place - m.switch_offset[i] - m.switch_shift[i]
        if m.switch_period > 0.0:
            at -= m.switch_period * math.floor(at / m.switch_period)
        slack = coupling.switch_hysteresis[i] if coupling.switch_active[i] else 0.0
        inside = coupling.switch_from[i] - slack <= at <= coupling.switch_to[i] + slack
        if m.switch_scatter > 0.0 and coupling.switch_active[i] and not inside:
            m.switch_shift[i] = m.switch_scatter * normal(m)
        coupling.switch_active[i] = 1 if inside else 0
    axis.negative_limit_switch = coupling.switch_active[NEGATIVE]
    axis.positive_limit_switch = coupling.switch_active[POSITIVE]
    axis.home_switch = coupling.switch_active[HOME]


@block
def coordinates(world):
    """The joint coordinates of a machine (MjData.qpos), as the last `run` left them."""
    return floats_at(world.qpos, world.nq)


@block
def speeds(world):
    """The joint speeds of a machine (MjData.qvel), as the last `run` left them."""
    return floats_at(world.qvel, world.nv)


@block
def copy(source, target):
    """Copy element by element, because Numba compiles an assignment of slices for two seconds."""
    for i in range(len(target)):
        target[i] = source[i]


@block
def control(world):
    """Run the control cycles that begin with a physics step; -> whether the physics is sound."""
    axes = axes_at(world.axes, world.drives)
    couplings = couplings_at(world.couplings, world.drives)
    joints = mechanics_at(world.mechanics, world.drives)
    qpos = reals_at(world, world.mj_qpos, world.nq)
    ctrl = reals_at(world, world.ctrl, world.nu)
    sound = True
    for i in range(len(axes)):
        coupling = couplings[i]
        sound = sound and abs(qpos[coupling.qpos]) < FARTHEST
        if world.tick % coupling.velocity_steps == 0:
            axis = axes[i]
            sense(axis, coupling, joints[i], qpos)
            velocity_cycle(axis)
            ctrl[coupling.ctrl] = axis.torque
    return sound


@block
def forces(world):
    """Set the friction limits and add the other forces; -> whether a joint has friction."""
    axes = axes_at(world.axes, world.drives)
    couplings = couplings_at(world.couplings, world.drives)
    joints = mechanics_at(world.mechanics, world.drives)
    qpos = reals_at(world, world.mj_qpos, world.nq)
    qvel = reals_at(world, world.mj_qvel, world.nv)
    for i in range(len(axes)):
        mechanics.run(world, axes[i], couplings[i], joints[i], qpos, qvel)
    return limited(joints)


@block
def finish(world):
    """Record the effect of the constraints, and measure impacts."""
    couplings = couplings_at(world.couplings, world.drives)
    joints = mechanics_at(world.mechanics, world.drives)
    qpos = reals_at(world, world.mj_qpos, world.nq)
    qvel = reals_at(world, world.mj_qvel, world.nv)
    remember(world, couplings, joints)
    for i in range(len(joints)):
        mechanics.watch(world, couplings[i], joints[i], qpos, qvel)


@block
def count(world):
    """Measure for the task, and for the probes if the machine has them."""
    axes = axes_at(world.axes, world.drives)
    couplings = couplings_at(world.couplings, world.drives)
    notice(world, axes, couplings)
    if world.probes != 0:
        qpos = reals_at(world, world.mj_qpos, world.nq)
        qvel = reals_at(world, world.mj_qvel, world.nv)
        probes = probes_at(world.probes, world.drives)
        for i in range(len(axes)):
            observe(probes[i], axes[i], couplings[i], world.timestep, qpos, qvel)
    world.tick += 1


@block
def latch_image(world, axes, image):
    """Write an RPDO image into the objects of all drives of a machine, one after the other."""
    directory = directory_at(world.pdos, world.drives)
    at = 0
    for i in range(len(axes)):
        pdos = pdos_at(directory[i].rpdos, directory[i].rpdo_count)
        objects = bytes_at(world.axes + i * AXIS_SIZE, AXIS_SIZE)
        at = latch(objects, axes[i], pdos, image, at)
    return at


@block
def collect_image(world, image):
    """Copy the mapped objects of all drives of a machine into a TPDO image."""
    directory = directory_at(world.pdos, world.drives)
    at = 0
    for i in range(world.drives):
        pdos = pdos_at(directory[i].tpdos, directory[i].tpdo_count)
        objects = bytes_at(world.axes + i * AXIS_SIZE, AXIS_SIZE)
        at = collect(objects, pdos, image, at)
    return at
