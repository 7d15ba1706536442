"""The compiled inner loop: drives and physics of any number of machines, without Python in it.

In every physics step, each drive whose velocity cycle begins reads its shaft and its switches,
runs, and sets the torque of its actuator. MuJoCo then takes one step in two halves; between them
the mechanics and the friction of the driven joints are added to the passive forces. If a coordinate
is no longer finite, the physics stops, and the drive reports an encoder fault.

`piece` works on a JOB, the arguments of `loop.run`, for one pace of physics steps.
"""

from enum import IntEnum
from typing import Any

import mujoco
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ...drive.kernel.jit import DISABLED, block, entry, rare
from ...drive.memory import bytes_at, floats_at, integers_at, viewer
from . import friction, tick
from .arrays import positions, velocities
from .guard import JOB
from .physics import (
    STATE,
    mj_check_acc,
    mj_compare_fwd_inv,
    mj_euler,
    mj_fwd_acceleration,
    mj_fwd_constraint,
    mj_get_state,
    mj_implicit,
    mj_reset,
    mj_sensor_acc,
    mj_set_state,
    mj_step1,
    mj_step2,
)
from .probe import begin_step, probes_at
from .tick import axes_at, coordinates, copy, couplings_at, mechanics_at, sense, speeds, world_at
from .world import FIELD

FIRST_PACE = 64  # physics steps of the first piece, before their duration is known


class Status(IntEnum):
    """Status of a machine; any value but SOUND keeps it from running."""

    SOUND = 0
    RUNNING = 1
    FAILED = 2  # MuJoCo left the machine in the middle of a step
    MISFIT = 3  # a coupling refers to something that the model does not have
    MAPPING = 4  # the PDOs of the drives do not match the process images
    OPTION = 5  # the timestep or the integrator of the model has been changed


SOUND, RUNNING, FAILED, MISFIT, MAPPING, OPTION = map(int, Status)
_kinds = {int(kind) for kind in mujoco.mjtIntegrator.__members__.values()}
RK4, LAST_INTEGRATOR = int(mujoco.mjtIntegrator.mjINT_RK4), max(_kinds)
INTEGRATORS = _kinds - {RK4}
EULER, UNPACKED = (
    int(mujoco.mjtIntegrator.mjINT_EULER),
    int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
)
FWDINV = int(mujoco.mjtEnableBit.mjENBL_FWDINV)
fields_at = viewer(FIELD)
integers32_at = viewer(np.dtype("i4"))
job_at = viewer(JOB)


@block
def _tick(world):
    """Run one physics step and the control cycles that begin with it."""
    if tick.control(world):
        mj_step1(world.mj_model, world.mj_data)
        grips = tick.forces(world)
        if grips:
            friction.stick(world)
        if grips and world.act_callbacks != 0 and _integrator(world) <= UNPACKED:
            _second_half(world)
        else:
            mj_step2(world.mj_model, world.mj_data)
        tick.finish(world)
    tick.count(world)


@block
def _integrator(world):
    return integers32_at(world.option_integrator, 1)[0]


@block
def _second_half(world):
    """`mj_step2` without the actuation, whose callbacks `stick` has called already."""
    model, data = world.mj_model, world.mj_data
    mj_fwd_acceleration(model, data)
    mj_fwd_constraint(model, data)
    bytes_at(world.rne_flag, 1)[0] = 0
    mj_sensor_acc(model, data)
    mj_check_acc(model, data)
    if integers32_at(world.option_enableflags, 1)[0] & FWDINV:
        mj_compare_fwd_inv(model, data)
    if _integrator(world) == EULER:
        mj_euler(model, data)
    else:
        mj_implicit(model, data)


@block
def _as_made(world):
    """Whether the timestep is unchanged and the integrator takes one step."""
    integrator = _integrator(world)
    one_step = 0 <= integrator <= LAST_INTEGRATOR and integrator != RK4
    return one_step and floats_at(world.option_timestep, 1)[0] == world.timestep


@block
def _enter(address, world):
    """Take over the shared MjModel and MjData; the state of the machine before is saved."""
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


@rare
def _move_fields(world, enters):
    """Copy the saved fields of a world into its MjModel (`enters`), or back."""
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
    """Let the first machine of `worlds` take over the MjData it shares."""
    _enter(worlds[0], world_at(worlds[0], 1)[0])


@block
def _fits(world, couplings, joints):
    """Whether all indices of the couplings, mechanics and probes are within their arrays."""
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
def _arrives(world, tick, ticks):
    """Whether the RPDO image of the row that began at `tick` is latched."""
    if world.latches == 0:
        return True
    row = (tick - world.latches_from) // max(ticks, 1)
    return 0 <= row < world.latches_count and bytes_at(world.latches, world.latches_count)[row] != 0


@block
def _advance(address, begin, end, ticks, rpdo, tpdo):
    """Advance a machine from tick `begin` to `end` of a step of `ticks`; -> its `Status`."""
    world = world_at(address, 1)[0]
    couplings = couplings_at(world.couplings, world.drives)
    joints = mechanics_at(world.mechanics, world.drives)
    if world.status == FAILED:
        return FAILED
    if not _fits(world, couplings, joints):
        return MISFIT
    if not _as_made(world):
        return OPTION
    world.status = RUNNING
    _enter(address, world)
    axes = axes_at(world.axes, world.drives)
    arrives = len(rpdo) > 0 and _arrives(world, world.tick - begin, ticks)
    if arrives and begin == 0:
        begin_step(world, axes, couplings)
    latched_at = min(max(world.delay, 0), ticks) if arrives else -1
    latched, collected = len(rpdo), len(tpdo)
    for now in range(begin, end):
        if now == latched_at:
            latched = tick.latch_image(world, axes, rpdo)
        _tick(world)
    if latched_at == ticks == end:
        latched = tick.latch_image(world, axes, rpdo)
    if len(tpdo) and end == ticks:
        collected = tick.collect_image(world, tpdo)
    copy(positions(world), coordinates(world))
    copy(velocities(world), speeds(world))
    world.status = SOUND
    return SOUND if latched == len(rpdo) and collected == len(tpdo) else MAPPING


DONE, FAULTY, MORE = range(3)  # result of a piece


@block
def _present(worlds, row):
    """The first row from `row` on whose machine takes part."""
    while row < len(worlds) and worlds[row] == 0:
        row += 1
    return row


def _all(job_address):
    """Work on a JOB, machine after machine, for one pace of physics steps."""
    job = job_at(job_address, 1)[0]
    worlds = integers_at(job.worlds, job.count)
    job.row = _present(worlds, job.row)
    if job.row == job.count:
        return
    if job.paced == 0:
        job.paced = worlds[job.row]
    first = world_at(job.paced, 1)[0]
    if first.pace < 1:
        first.pace = FIRST_PACE
    left = first.pace
    while job.row < job.count and left > 0:
        w, begin = job.row, job.tick
        end = min(begin + left, job.ticks)
        rpdo = bytes_at(job.rpdos + w * job.rpdo_bytes, job.rpdo_bytes)
        tpdo = bytes_at(job.tpdos + w * job.tpdo_bytes, job.tpdo_bytes)
        status = _advance(worlds[w], begin, end, job.ticks, rpdo, tpdo)
        left -= end - begin
        if status != SOUND:
            end = job.ticks
            if job.refused == 0:
                job.refused, job.status = worlds[w], status
        job.tick = end
        if end == job.ticks:
            job.row, job.tick = _present(worlds, w + 1), 0


@intrinsic
def _protected(context, batch, job):
    """Call `_all` through ``mjb_apply``; -> 1 if MuJoCo returned with an error."""

    def build(context, builder, signature, arguments):
        number, small, nothing = context.get_value_type(types.intp), ir.IntType(32), ir.VoidType()
        called = ir.FunctionType(nothing, [number, number, small, number])
        function = ir.Function(builder.module, called, context.mangler("protected", [types.intp]))
        function.linkage = "internal"
        inner = ir.IRBuilder(function.append_basic_block())
        work = context.compile_subroutine(builder, _all, types.none(types.intp))
        context.call_internal_no_propagate(inner, work.fndesc, work.signature, [function.args[3]])
        inner.ret_void()
        apply = builder.module.globals.get("mjb_apply") or ir.Function(
            builder.module, ir.FunctionType(small, [number, number, small, number, number, small]),
            "mjb_apply",
        )
        zero = small(0)
        where = builder.ptrtoint(function, number)
        return builder.call(apply, [arguments[0], number(0), zero, where, arguments[1], zero])

    return types.int32(types.intp, types.intp), build


def _in_python(batch, job):
    """`_protected` without JIT: MuJoCo's Python functions raise errors themselves."""
    _all(job)
    return 0


protected: Any = _in_python if DISABLED else _protected


@entry
def piece(batch, job, worlds, ticks, rpdos, tpdos, further):
    """Fill a JOB and run its first or a further piece; -> DONE, MORE or FAULTY."""
    if not further:
        job[0].row, job[0].tick, job[0].paced, job[0].refused = 0, 0, 0, 0
    job[0].worlds, job[0].count, job[0].ticks = worlds.ctypes.data, len(worlds), ticks
    job[0].rpdos, job[0].rpdo_bytes = rpdos.ctypes.data, rpdos.shape[1]
    job[0].tpdos, job[0].tpdo_bytes = tpdos.ctypes.data, tpdos.shape[1]
    if protected(batch, job.ctypes.data):
        return FAULTY
    return MORE if job[0].row < len(worlds) else DONE


@entry
def abandon(model, data):
    """Release the stack of MuJoCo in MjData, whose contents now belong to no machine."""
    mj_reset(model, data)


@entry
def settle(axes, couplings, joints, qpos):
    """Set the switches and their scatter for the present positions, without history."""
    for i in range(len(axes)):
        m = joints[i]
        m.noise_state = m.switch_seed
        for k in range(3):
            m.switch_shift[k] = m.switch_scatter * tick.normal(m) if m.switch_scatter > 0.0 else 0.0
        for k in range(3):
            couplings[i].switch_active[k] = 0
        sense(axes[i], couplings[i], m, qpos)
