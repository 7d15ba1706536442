"""The two faces of an action: set-points only, or all an RPDO carries.

With ``action="setpoint"`` a master has enabled the drive and chosen its mode; the agent moves
set-points. With ``action="pdo"`` the agent is the whole master: each drive gets further components

| no | name | action | object | scaling |
|----|------|--------|--------|---------|
| 0–8 | control[:].controlword[:] | bits 0 to 8 | 6040h controlword | above 0: set |
| 9 | control[:].mode | mode | 6060h modes_of_operation | -1..1 in equal parts over `modes` |

and further observations: the 16 bits of the statusword as 0 or 1, ``status[:].statusword[:]``, and
the mode displayed (6061h) on the same scale, 0 where it is none of them, ``status[:].mode``.
"""

from ...drive.kernel.jit import block, entry
from ..engine.tick import world_at
from .fields import action, observation

SETPOINT, PDO = "setpoint", "pdo"
FACES = (SETPOINT, PDO)
CONTROL_BITS = 9
STATUS_BITS = 16
CONTROL = action(("controlword", CONTROL_BITS), "mode")
STATUS = observation(("statusword", STATUS_BITS), "mode")
FAULT = 0x08


@entry
def control(worlds, controls, modes, rpdos):
    """Controlword and mode of every drive, of `controls`, shape ``(n, drives)``."""
    for w in range(len(worlds)):
        for d in range(rpdos.shape[1]):
            wanted = controls[w, d]
            word = 0
            for bit in range(CONTROL_BITS):
                if wanted.controlword[bit] > 0.0:
                    word |= 1 << bit
            rpdos[w, d].controlword = word
            share = 0.5 * (wanted.mode + 1.0)
            chosen = min(max(int(share * len(modes)), 0), len(modes) - 1)
            rpdos[w, d].modes_of_operation = modes[chosen]


@entry
def report(tpdos, modes, status):
    """Statusword and mode of every drive as observations `status`, shape ``(n, drives)``."""
    for w in range(len(tpdos)):
        for d in range(tpdos.shape[1]):
            seen = status[w, d]
            word = int(tpdos[w, d].statusword)
            for bit in range(STATUS_BITS):
                seen.statusword[bit] = word >> bit & 1
            seen.mode = 0.0
            for m in range(len(modes)):
                if tpdos[w, d].modes_of_operation_display == modes[m]:
                    seen.mode = (2.0 * m + 1.0) / len(modes) - 1.0


@block
def clip(x):
    """Into -1..1."""
    return min(max(x, -1.0), 1.0)


@block
def faulted(tpdo):
    """Whether one of the drives of a machine is in a fault."""
    words = 0
    for d in range(len(tpdo)):
        words |= int(tpdo[d].statusword)
    return words & FAULT != 0


@block
def world_of(episode):
    """The WORLD in which an episode takes place, within `act` and `judge` of its task."""
    return world_at(episode._world, 1)[0]


@block
def limited(episode):
    """Share of the step with an internal limit active in one of the drives (statusword bit 11).

    Each physics step counts.
    """
    world = world_of(episode)
    return world.limited_ticks / max(world.step_ticks, 1)
