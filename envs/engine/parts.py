"""What runs around the steps of mujoco-warp, for one of many machines, by its SINGLE's address.

A step of the agent is `begin`, for each physics step `control`, the first half of mujoco-warp,
`forces`, its `fwd_acceleration` and `solve_m`, `stick`, the second half, `finish`; then `end`. All
of it is made of the blocks that `loop` consists of. A machine that is left out, or whose
coordinates are no longer finite, stands still meanwhile, for mujoco-warp knows no exception.

Called with the address of the first machine, the bytes from one to the next, and how many they
are: on a CPU here, one after the other; on a GPU, a thread each, by `gpu`.
"""

from collections.abc import Callable
from typing import Any

from ...drive.kernel.jit import block, entry
from ...drive.memory import bytes_at, floats_at, integers_at, viewer
from . import friction, tick
from .arrays import positions, reals_at, velocities
from .probe import begin_step
from .tick import axes_at, coordinates, copy, couplings_at, speeds
from .world import MOVE, SINGLE

single_at = viewer(SINGLE)
moves_at = viewer(MOVE)


@block
def _present(world):
    return integers_at(world.present, 1)[0] != 0


@block
def controls(world):
    """Torques of the drives, and controls of other actuators (ctrl)."""
    return reals_at(world, world.ctrl, world.nu)


@block
def _move(moves, count, source, target):
    """Bytes of one record to those of another; a GPU reads no numbers that are not aligned."""
    for move in moves_at(moves, count):
        old, new = (
            bytes_at(source + move.source, move.bytes), bytes_at(target + move.target, move.bytes)
        )
        copy(old, new)


@block
def begin(address):
    """Take over what has arrived, and begin a step of the agent."""
    world = single_at(address, 1)[0]
    if world.arrived != 0:
        world.arrived = 0
        copy(coordinates(world), positions(world))
        copy(speeds(world), velocities(world))
        warmstart = reals_at(world, world.warmstart, world.nv)
        copy(floats_at(world.kept_warmstart, world.nv), warmstart)
        copy(floats_at(world.kept_ctrl, world.nu), controls(world))
    world.latch_at = -1
    if _present(world) and world.rpdo_bytes > 0:
        _move(world.rpdo_moves, world.rpdo_move_count, world.rpdo_record, world.rpdo)
        axes = axes_at(world.axes, world.drives)
        begin_step(world, axes, couplings_at(world.couplings, world.drives))
        world.latch_at = min(max(world.delay, 0), world.ticks)


@block
def _latch(world, axes):
    if world.step_ticks == world.latch_at:
        tick.latch_image(world, axes, bytes_at(world.rpdo, world.rpdo_bytes))


@block
def control(address):
    """Latch the RPDO image when its time has come, and run the drives."""
    world = single_at(address, 1)[0]
    world.moves = 0
    if _present(world):
        _latch(world, axes_at(world.axes, world.drives))
        if tick.control(world):
            world.moves = 1


@block
def forces(address):
    """The mechanics of the joints, between the halves of the physics step."""
    world = single_at(address, 1)[0]
    world.grips = world.moves != 0 and tick.forces(world)


@block
def stick(address):
    """The friction of the joints, once accelerations and responses are there."""
    world = single_at(address, 1)[0]
    if world.grips != 0:
        friction.grip(world)


@block
def finish(address):
    """Measure what the physics step brought; who stands still goes back to where it was."""
    world = single_at(address, 1)[0]
    qpos, qvel = positions(world), velocities(world)
    if world.moves != 0:
        tick.finish(world)
        copy(qpos, coordinates(world))
        copy(qvel, speeds(world))
    else:
        copy(coordinates(world), qpos)
        copy(speeds(world), qvel)
    if _present(world):
        tick.count(world)


@block
def end(address):
    """End a step of the agent: the TPDO image."""
    world = single_at(address, 1)[0]
    if not _present(world):
        return
    if world.latch_at == world.ticks:
        _latch(world, axes_at(world.axes, world.drives))
    if world.tpdo_bytes > 0:
        tick.collect_image(world, bytes_at(world.tpdo, world.tpdo_bytes))
        _move(world.tpdo_moves, world.tpdo_move_count, world.tpdo, world.tpdo_record)


def _over_all(part: Callable[..., None]) -> Any:
    @entry
    def one_after_the_other(first, stride, n):
        for i in range(n):
            part(first + i * stride)

    return one_after_the_other


PARTS = {part.__name__: part for part in (begin, control, forces, stick, finish, end)}
ON_CPU = {name: _over_all(part) for name, part in PARTS.items()}
