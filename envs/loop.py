"""The inner loop: drives and physics of any number of machines, compiled, without Python in it.

Every physics tick: each drive whose velocity cycle begins reads its shaft and switches, runs, and
sets the torque of its actuator; then MuJoCo takes one step. When a coordinate is no longer finite
the physics stops, and the drive's encoder fault says so.
"""

import math

import numpy as np

from ..drive.cycle import velocity_cycle
from ..drive.jit import block, entry
from ..drive.process_data import PDO, collect, latch
from ..drive.record import AXIS
from . import mechanics
from .mechanics import MECHANICS
from .memory import bytes_at, floats_at, integers_at, viewer
from .physics import STATE, mj_get_state, mj_set_state, mj_step
from .probe import observe, probes_at

AXIS_SIZE = AXIS.itemsize
FARTHEST = 1e9  # m or rad; beyond it, or not a number, the physics has failed and stands still
NEGATIVE, POSITIVE, HOME = range(3)  # places in the arrays of a coupling's switches

# How a drive is coupled to the physics, and its PDOs. One record a drive.
COUPLING = np.dtype(
    [
        ("qpos", "i8"),  # address of the joint coordinate
        ("dof", "i8"),  # address of the joint's degree of freedom
        ("ctrl", "i8"),  # number of the actuator
        ("velocity_steps", "i8"),  # physics steps per velocity cycle
        ("gear", "f8"),  # rad of motor shaft per m (slide) or rad (hinge) of the joint
        ("friction", "f8"),  # frictionloss of the joint with the brake released (N or Nm)
        ("brake_friction", "f8"),  # added by the engaged brake; 0 = there is none
        ("switch_from", "f8", (3,)),  # (m or rad); from > to: there is no such switch
        ("switch_to", "f8", (3,)),
        ("switch_hysteresis", "f8", (3,)),
        ("switch_active", "u1", (3,)),
        ("noise", "f8"),  # standard deviation of the measured position (m or rad); 0 = none
        ("noise_state", "u8"),  # of its generator
    ],
    align=True,
)

# A machine as the loop sees it: where its things lie in memory. One record a machine.
WORLD = np.dtype(
    [
        ("mj_model", "i8"),  # address of MjModel
        ("mj_data", "i8"),  # address of MjData (a record has a `data` of its own)
        ("qpos", "i8"),  # addresses of the coordinates as the last run left them, for the tasks
        ("qvel", "i8"),
        ("mj_qpos", "i8"),  # addresses of arrays of MjData, and of MjModel.dof_frictionloss
        ("mj_qvel", "i8"),
        ("ctrl", "i8"),
        ("frictionloss", "i8"),
        ("inertia", "i8"),  # MjData.M
        ("applied", "i8"),  # MjData.qfrc_applied
        ("stiffness", "i8"),  # MjModel.jnt_stiffness
        ("damping", "i8"),  # MjModel.dof_damping
        ("guide_friction", "i8"),  # MjModel.tendon_frictionloss
        ("nq", "i8"),  # their lengths
        ("nv", "i8"),
        ("nu", "i8"),
        ("axes", "i8"),  # addresses of the records of its drives, and how many they are
        ("couplings", "i8"),
        ("mechanics", "i8"),
        ("pdos", "i8"),
        ("drives", "i8"),
        ("tick", "i8"),  # physics steps since the reset
        ("delay", "i8"),  # physics steps an RPDO image is late
        ("probes", "i8"),  # address of the records that measure the drives; 0: there are none
        ("timestep", "f8"),  # s
        # of a machine that shares MjModel and MjData with others, addresses of
        ("state", "i8"),  # its state while others live there; 0: it lives alone
        ("kept", "i8"),  # its values of the fields of MjModel
        ("fields", "i8"),  # where these fields are
        ("field_count", "i8"),
        ("resident", "i8"),  # the number that is the address of who lives there now
    ],
    align=True,
)

# Where the PDOs of a drive lie, and how many they are.
PDOS = np.dtype([("rpdos", "i8"), ("rpdo_count", "i8"), ("tpdos", "i8"), ("tpdo_count", "i8")])

# A field of MjModel that differs between machines that share it.
FIELD = np.dtype([("address", "i8"), ("length", "i8")])

world_at = viewer(WORLD)
axes_at = viewer(AXIS)
couplings_at = viewer(COUPLING)
mechanics_at = viewer(MECHANICS)
directory_at = viewer(PDOS)
fields_at = viewer(FIELD)
pdos_at = viewer(PDO)


@block
def _normal(coupling):
    """The next number of a normal distribution: xorshift64*, and the polar form of Box-Muller."""
    while True:
        u, v = _uniform(coupling), _uniform(coupling)
        s = u * u + v * v
        if 0.0 < s < 1.0:
            return u * math.sqrt(-2.0 * math.log(s) / s)


@block
def _uniform(coupling):
    """In -1..1 (Vigna, An experimental exploration of Marsaglia's xorshift generators)."""
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
        measured += coupling.noise * _normal(coupling)
    axis.shaft_angle = measured * coupling.gear
    place = mechanics.carriage(m, coupling, qpos)
    for i in range(3):
        at = place - m.switch_offset[i] - m.switch_shift[i]
        slack = coupling.switch_hysteresis[i] if coupling.switch_active[i] else 0.0
        inside = coupling.switch_from[i] - slack <= at <= coupling.switch_to[i] + slack
        if m.switch_scatter > 0.0 and coupling.switch_active[i] and not inside:
            m.switch_shift[i] = m.switch_scatter * _normal(m)
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
def _copy(source, target):
    for i in range(len(target)):
        target[i] = source[i]


@block
def _tick(world, axes, couplings, joints, qpos, qvel, ctrl, frictionloss):
    """One physics step and the control cycles that begin with it."""
    sound = True
    for i in range(len(axes)):
        coupling = couplings[i]
        sound = sound and abs(qpos[coupling.qpos]) < FARTHEST
        if world.tick % coupling.velocity_steps == 0:
            axis = axes[i]
            sense(axis, coupling, joints[i], qpos)
            velocity_cycle(axis)
            ctrl[coupling.ctrl] = axis.torque
    if sound:
        for i in range(len(axes)):
            mechanics.run(world, axes[i], couplings[i], joints[i], qpos, qvel, frictionloss)
        mj_step(world.mj_model, world.mj_data)
        for i in range(len(axes)):
            mechanics.watch(world, couplings[i], joints[i], qpos, qvel)
    if world.probes != 0:
        probes = probes_at(world.probes, world.drives)
        for i in range(len(axes)):
            observe(probes[i], axes[i], couplings[i], world.timestep, qpos, qvel)
    world.tick += 1


@block
def _latch(world, axes, image):
    """Write an RPDO image into the objects of all drives of a machine, one after the other."""
    directory = directory_at(world.pdos, world.drives)
    at = 0
    for i in range(len(axes)):
        pdos = pdos_at(directory[i].rpdos, directory[i].rpdo_count)
        objects = bytes_at(world.axes + i * AXIS_SIZE, AXIS_SIZE)
        at = latch(objects, axes[i], pdos, image, at)


@block
def _collect(world, image):
    """Copy the mapped objects of all drives of a machine into a TPDO image."""
    directory = directory_at(world.pdos, world.drives)
    at = 0
    for i in range(world.drives):
        pdos = pdos_at(directory[i].tpdos, directory[i].tpdo_count)
        objects = bytes_at(world.axes + i * AXIS_SIZE, AXIS_SIZE)
        at = collect(objects, pdos, image, at)


@block
def _enter(address, world):
    """Take over the MjModel and MjData that several machines share; who lived there is kept."""
    if world.state == 0:
        return
    resident = integers_at(world.resident, 1)
    if resident[0] == address:
        return
    if resident[0] != 0:
        other = world_at(resident[0], 1)[0]
        mj_get_state(other.mj_model, other.mj_data, other.state, STATE)
        _move_fields(other, False)
    _move_fields(world, True)
    mj_set_state(world.mj_model, world.mj_data, world.state, STATE)
    resident[0] = address


@block
def _move_fields(world, enters):
    """Fields of MjModel, from what is kept of a world or to it."""
    fields = fields_at(world.fields, world.field_count)
    kept = world.kept
    for i in range(len(fields)):
        size = fields[i].length
        own, shared = floats_at(kept, size), floats_at(fields[i].address, size)
        for k in range(size):
            if enters:
                shared[k] = own[k]
            else:
                own[k] = shared[k]
        kept += 8 * size


@entry
def enter(worlds):
    """Let the machine of the one world of `worlds` take over the MjData it shares."""
    _enter(worlds[0], world_at(worlds[0], 1)[0])


@entry
def run(worlds, ticks, rpdos, tpdos):
    """Advance machines by `ticks` physics steps, exchanging the process images of their drives.

    Args:
        worlds: addresses of WORLD records, shape ``(n,)``; one that is 0 is left out.
        ticks: physics steps.
        rpdos: RPDO images, latched after the delay of their machine, shape ``(n, bytes)``; with
            no bytes none is.
        tpdos: takes the TPDO images at the end, shape ``(n, bytes)``; with no bytes none is.
    """
    for w in range(len(worlds)):
        if worlds[w] == 0:
            continue
        world = world_at(worlds[w], 1)[0]
        _enter(worlds[w], world)
        axes = axes_at(world.axes, world.drives)
        couplings = couplings_at(world.couplings, world.drives)
        joints = mechanics_at(world.mechanics, world.drives)
        qpos = floats_at(world.mj_qpos, world.nq)
        qvel = floats_at(world.mj_qvel, world.nv)
        ctrl = floats_at(world.ctrl, world.nu)
        frictionloss = floats_at(world.frictionloss, world.nv)
        latched_at = min(world.delay, ticks) if rpdos.shape[1] else -1
        for now in range(ticks):
            if now == latched_at:
                _latch(world, axes, rpdos[w])
            _tick(world, axes, couplings, joints, qpos, qvel, ctrl, frictionloss)
        if latched_at == ticks:
            _latch(world, axes, rpdos[w])
        if tpdos.shape[1]:
            _collect(world, tpdos[w])
        _copy(qpos, coordinates(world))  # an assignment of slices takes Numba two seconds
        _copy(qvel, speeds(world))


@entry
def settle(axes, couplings, joints, qpos):
    """Set switches and their tolerance for the present positions, without history."""
    for i in range(len(axes)):
        m = joints[i]
        m.noise_state = m.switch_seed
        for k in range(3):
            m.switch_shift[k] = m.switch_scatter * _normal(m) if m.switch_scatter > 0.0 else 0.0
        for k in range(3):
            couplings[i].switch_active[k] = 0
        sense(axes[i], couplings[i], m, qpos)
