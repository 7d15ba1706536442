"""The parts of a step around mujoco-warp, for one machine given by the address of its SINGLE.

A step of the agent runs `begin`; for each physics step `control`, the first half-step of
mujoco-warp, `forces`, its `fwd_acceleration` and `solve_m`, `stick`, the second half-step and
`finish`; and finally `end`. The parts consist of the same blocks as `loop`. mujoco-warp steps all
machines, so a machine that is left out, or whose coordinates are no longer finite, is restored to
its state before the step.

Each part is called with the address of the first machine, the number of bytes from one machine to
the next, and the number of machines. On a CPU the machines run one after the other, on a GPU
(`gpu`) each in a thread.
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
    """Torques of the drives and controls of other actuators (ctrl)."""
    return reals_at(world, world.ctrl, world.nu)


@block
def _move(moves, count, source, target):
    """Copy fields between records of different alignment; a GPU reads aligned numbers only."""
    for move in moves_at(moves, count):
        old, new = (
            bytes_at(source + move.source, move.bytes), bytes_at(target + move.target, move.bytes)
        )
        copy(old, new)


@block
def begin(address):
    """Take over a state that was sent to the device, and begin a step of the agent."""
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
    """Latch the RPDO image at its tick, and run the drives."""
    world = single_at(address, 1)[0]
    world.moves = 0
    if _present(world):
        _latch(world, axes_at(world.axes, world.drives))
        if tick.control(world):
            world.moves = 1


@block
def forces(address):
    """Apply the mechanics of the joints, between the two halves of the physics step."""
    world = single_at(address, 1)[0]
    world.grips = world.moves != 0 and tick.forces(world)


@block
def stick(address):
    """Apply the friction of the joints, once accelerations and responses are computed."""
    world = single_at(address, 1)[0]
    if world.grips != 0:
        friction.grip(world)


@block
def finish(address):
    """Measure the result of the physics step; restore a machine that is left out."""
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
    """Write the TPDO image at the end of a step of the agent."""
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
