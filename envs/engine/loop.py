"""The inner loop: drives and physics of any number of machines, compiled, without Python in it.

Every physics tick: each drive whose velocity cycle begins reads its shaft and switches, runs, and
sets the torque of its actuator; then MuJoCo takes one step, in two halves between which the
mechanics and the friction of the driven joints join the passive forces. When a coordinate is no
longer finite the physics stops, and the drive's encoder fault says so.
"""

import math
from enum import IntEnum
from typing import Any

import mujoco
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ...drive.kernel.cycle import velocity_cycle
from ...drive.kernel.jit import DISABLED, block, entry
from ...drive.kernel.process_data import PDO, collect, latch
from ...drive.kernel.record import AXIS
from ...drive.memory import address, bytes_at, floats_at, integers_at, peek, viewer
from . import friction, mechanics
from .guard import JOB, guarded
from .mechanics import MECHANICS
from .physics import STATE, mj_get_state, mj_reset, mj_set_state, mj_step1, mj_step2
from .probe import begin_step, notice, observe, probes_at

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
        ("friction", "f8"),  # Coulomb friction of the joint with the brake released (N or Nm)
        ("brake_friction", "f8"),  # added by the engaged brake; 0 = there is none
        ("switch_from", "f8", (3,)),  # (m or rad); from > to: there is no such switch
        ("switch_to", "f8", (3,)),
        ("switch_hysteresis", "f8", (3,)),
        ("switch_active", "u1", (3,)),
        ("noise", "f8"),  # standard deviation of the measured position (m or rad); 0 = none
        ("noise_state", "u8"),  # of its generator
        ("torque_peak", "f8"),  # of the step, with its sign (Nm)
        ("error_peak", "f8"),  # the following error's (position units)
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
        ("mj_qpos", "i8"),  # addresses of arrays of MjData
        ("mj_qvel", "i8"),
        ("ctrl", "i8"),
        ("inertia", "i8"),  # M
        ("passive", "i8"),  # qfrc_passive
        ("acceleration", "i8"),  # qacc
        ("smooth_acceleration", "i8"),  # qacc_smooth
        ("stiffness", "i8"),  # MjModel.jnt_stiffness
        ("damping", "i8"),  # MjModel.dof_damping
        ("directions", "i8"),  # of the frictions, two rows a drive over the degrees of freedom
        ("responses", "i8"),  # accelerations they give, the same shape
        ("nq", "i8"),  # their lengths
        ("nv", "i8"),
        ("nu", "i8"),
        ("inertias", "i8"),
        ("guides", "i8"),
        ("joints", "i8"),
        ("status", "i8"),  # `Status`
        ("axes", "i8"),  # addresses of the records of its drives, and how many they are
        ("couplings", "i8"),
        ("mechanics", "i8"),
        ("pdos", "i8"),
        ("drives", "i8"),
        ("tick", "i8"),  # physics steps since the reset
        ("delay", "i8"),  # physics steps an RPDO image is late
        ("probes", "i8"),  # address of the records that measure the drives; 0: there are none
        ("timestep", "f8"),  # s
        ("step_ticks", "i8"),  # physics steps since the last RPDO image came
        ("limited_ticks", "i8"),  # of these with an internal limit active in one of the drives
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


class Status(IntEnum):
    """Of a machine; all but SOUND keep it from running."""

    SOUND = 0
    RUNNING = 1
    FAILED = 2  # MuJoCo left it in the middle of a step
    MISFIT = 3  # a coupling names what the model does not have
    MAPPING = 4  # the PDOs of its drives are not what the images are made of


SOUND, RUNNING, FAILED, MISFIT, MAPPING = map(int, Status)
RESET = "the machine stands in the middle of a step, reset() it or restore() a snapshot"
REFUSALS: dict[int, tuple[type[Exception], str]] = {
    FAILED: (RuntimeError, f"an earlier step failed: {RESET}"),
    MISFIT: (
        ValueError,
        "`couplings`, `mechanics` or `probes` hold a number of a coordinate, actuator or tendon "
        "that the model does not have, or a period below 1: build the machine anew",
    ),
    MAPPING: (
        RuntimeError,
        "the PDO mapping of a drive has changed, its process image has another size now: "
        "map what the task needs, or make the environment anew",
    ),
}

world_at = viewer(WORLD)
axes_at = viewer(AXIS)
couplings_at = viewer(COUPLING)
mechanics_at = viewer(MECHANICS)
directory_at = viewer(PDOS)
fields_at = viewer(FIELD)
job_at = viewer(JOB)
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
def load_noise(world):
    """What the noise of the first drive's encoder is worth at a sensor of the load (m)."""
    coupling = couplings_at(world.couplings, 1)[0]
    return coupling.noise * _normal(coupling) if coupling.noise > 0.0 else 0.0


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
    axis.load_angle = (measured + place - qpos[coupling.qpos]) * coupling.gear
    for i in range(3):
        at = place - m.switch_offset[i] - m.switch_shift[i]
        if m.switch_period > 0.0:
            at -= m.switch_period * math.floor(at / m.switch_period)
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
def _tick(world, axes, couplings, joints, qpos, qvel, ctrl):
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
        mj_step1(world.mj_model, world.mj_data)
        for i in range(len(axes)):
            mechanics.run(world, axes[i], couplings[i], joints[i], qpos, qvel)
        if friction.limited(joints):
            friction.stick(world, couplings, joints, qvel)
        mj_step2(world.mj_model, world.mj_data)
        friction.remember(world, couplings, joints)
        for i in range(len(axes)):
            mechanics.watch(world, couplings[i], joints[i], qpos, qvel)
    notice(world, axes, couplings)
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
    return at


@block
def _collect(world, image):
    """Copy the mapped objects of all drives of a machine into a TPDO image."""
    directory = directory_at(world.pdos, world.drives)
    at = 0
    for i in range(world.drives):
        pdos = pdos_at(directory[i].tpdos, directory[i].tpdo_count)
        objects = bytes_at(world.axes + i * AXIS_SIZE, AXIS_SIZE)
        at = collect(objects, pdos, image, at)
    return at


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


@block
def _fits(world, couplings, joints):
    """Whether all that is used as an index is one."""
    for i in range(len(couplings)):
        coupling, m = couplings[i], joints[i]
        inside = 0 <= coupling.qpos < world.nq and 0 <= coupling.dof < world.nv
        inside = inside and 0 <= coupling.ctrl < world.nu and coupling.velocity_steps > 0
        inside = inside and 0 <= m.inertia_at < world.inertias and m.guide < world.guides
        if m.guide >= 0:
            inside = inside and 0 <= m.elastic_joint < world.joints
            inside = inside and 0 <= m.elastic_qpos < world.nq and 0 <= m.elastic_dof < world.nv
        if not inside:
            return False
        if world.probes != 0:
            probe = probes_at(world.probes, world.drives)[i]
            if probe.first >= world.nq or probe.second >= world.nq or probe.jerk_ticks < 1:
                return False
    return True


@block
def _advance(address, ticks, rpdo, tpdo):
    """Advance one machine; -> its `Status`."""
    world = world_at(address, 1)[0]
    couplings = couplings_at(world.couplings, world.drives)
    joints = mechanics_at(world.mechanics, world.drives)
    if world.status == FAILED:
        return FAILED
    if not _fits(world, couplings, joints):
        return MISFIT
    world.status = RUNNING
    _enter(address, world)
    axes = axes_at(world.axes, world.drives)
    qpos = floats_at(world.mj_qpos, world.nq)
    qvel = floats_at(world.mj_qvel, world.nv)
    ctrl = floats_at(world.ctrl, world.nu)
    if len(rpdo):
        begin_step(world, axes, couplings)
    latched_at = min(max(world.delay, 0), ticks) if len(rpdo) else -1
    latched, collected = len(rpdo), len(tpdo)
    for now in range(ticks):
        if now == latched_at:
            latched = _latch(world, axes, rpdo)
        _tick(world, axes, couplings, joints, qpos, qvel, ctrl)
    if latched_at == ticks:
        latched = _latch(world, axes, rpdo)
    if len(tpdo):
        collected = _collect(world, tpdo)
    _copy(qpos, coordinates(world))  # an assignment of slices takes Numba two seconds
    _copy(qvel, speeds(world))
    world.status = SOUND
    return SOUND if latched == len(rpdo) and collected == len(tpdo) else MAPPING


REFUSED_AT = int(JOB.fields["refused"][1])  # type: ignore[index]
EXCEPTION = -1  # instead of an address: an index out of a table of the drive


def _all(job_address):
    """What a JOB says, machine after machine."""
    job = job_at(job_address, 1)[0]
    worlds = integers_at(job.worlds, job.count)
    for w in range(job.count):
        if worlds[w] != 0:
            rpdo = bytes_at(job.rpdos + w * job.rpdo_bytes, job.rpdo_bytes)
            tpdo = bytes_at(job.tpdos + w * job.tpdo_bytes, job.tpdo_bytes)
            status = _advance(worlds[w], job.ticks, rpdo, tpdo)
            if status != SOUND and job.refused == 0:
                job.refused, job.status = worlds[w], status


@intrinsic
def _protected(context, batch, job):
    """``mjb_apply`` on `_all`; -> 1 if MuJoCo came back with an error."""

    def build(context, builder, signature, arguments):
        number, small, nothing = context.get_value_type(types.intp), ir.IntType(32), ir.VoidType()
        called = ir.FunctionType(nothing, [number, number, small, number])
        function = ir.Function(builder.module, called, context.mangler("protected", [types.intp]))
        function.linkage = "internal"
        inner = ir.IRBuilder(function.append_basic_block())
        work = context.compile_subroutine(builder, _all, types.none(types.intp))
        context.call_internal_no_propagate(inner, work.fndesc, work.signature, [function.args[3]])
        inner.ret_void()
        apply = ir.FunctionType(small, [number, number, small, number, number, small])
        apply = cgutils.get_or_insert_function(builder.module, apply, "mjb_apply")
        zero = small(0)
        where = builder.ptrtoint(function, number)
        return builder.call(apply, [arguments[0], number(0), zero, where, arguments[1], zero])

    return types.int32(types.intp, types.intp), build


@entry
def _run(batch, job, worlds, ticks, rpdos, tpdos):
    """Fill a JOB and do it; -> 1 if MuJoCo failed in it."""
    job[0].worlds, job[0].count, job[0].ticks = worlds.ctypes.data, len(worlds), ticks
    job[0].rpdos, job[0].rpdo_bytes = rpdos.ctypes.data, rpdos.shape[1]
    job[0].tpdos, job[0].tpdo_bytes = tpdos.ctypes.data, tpdos.shape[1]
    job[0].refused = 0
    return _protected(batch, job.ctypes.data)


def _run_in_python(batch, job, worlds, ticks, rpdos, tpdos):
    row = job[0]
    row.worlds, row.count, row.ticks = address(worlds), len(worlds), ticks
    row.rpdos, row.rpdo_bytes = address(rpdos), rpdos.shape[1]
    row.tpdos, row.tpdo_bytes = address(tpdos), tpdos.shape[1]
    row.refused = 0
    _all(address(job))
    return 0


if DISABLED:
    _run = _run_in_python


def run(worlds: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
    """Advance machines by `ticks` physics steps, exchanging the process images of their drives.

    The caller has the turn of the machines and keeps them alive.

    Args:
        worlds: addresses of WORLD records, shape ``(n,)``; one that is 0 is left out.
        ticks: physics steps.
        rpdos: RPDO images, latched after the delay of their machine, shape ``(n, bytes)``; with
            no bytes none is.
        tpdos: takes the TPDO images at the end, shape ``(n, bytes)``; with no bytes none is.

    Raises:
        mujoco.FatalError: MuJoCo reports an error; that machine has to be reset.
        Exception: what a callback of MuJoCo raised; that machine has to be reset.
        RuntimeError: a machine has failed before, or its PDO mapping is no longer that of the
            images; the others have been advanced.
        ValueError: an index in the couplings or mechanics is none.
    """
    job = guarded.job
    guarded.running = True
    try:
        failed = _run(guarded.address, job, worlds, ticks, rpdos, tpdos)
    except SystemError as error:  # so Python reports what a callback left behind
        _stop(worlds)
        raise (error.__cause__ or error) from None
    except BaseException:  # without JIT
        _stop(worlds)
        raise
    finally:
        guarded.running = False
    if failed:
        message = guarded.batch.error() if guarded.batch else ""
        _stop(worlds)
        raise mujoco.FatalError(f"{message}: {RESET}")
    if job["refused"][0] == EXCEPTION:
        _stop(worlds)
        raise RuntimeError(f"the record of a drive holds what no drive can be in: {RESET}")
    if job["refused"][0]:
        row = int(np.flatnonzero(worlds == job["refused"][0])[0])
        kind, remedy = REFUSALS[int(job["status"][0])]
        raise kind(f"{f'machine {row}: ' if len(worlds) > 1 else ''}{remedy}")


def _stop(worlds: np.ndarray) -> None:
    """Mark the machine MuJoCo has left in the middle of a step, and free what it shares."""
    for place in filter(None, worlds.tolist()):
        world: Any = peek(WORLD, place, 1)[0]
        if world.status == RUNNING:
            world.status = FAILED
            _abandon(world.mj_model, world.mj_data)
            if world.resident:
                peek(np.dtype("i8"), world.resident, 1)[0] = 0


@entry
def _abandon(model, data):
    """Give MuJoCo's stack in MjData back; what is there now is of no machine."""
    mj_reset(model, data)


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
