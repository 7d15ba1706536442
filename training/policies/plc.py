"""The step chain of a PLC: from a drive in fault to an axis in position."""

from functools import partial

import numpy as np

from ...drive.kernel.words import TO_ENABLED, Mode, State, state_of
from ...drive.kernel.words import Controlword as C
from ...drive.kernel.words import Statusword as S
from ...envs.exchange.faces import CONTROL_BITS, STATUS_BITS
from .datasheet import Datasheet
from .script import Script, Steps

FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)  # some models show this one in FAULT
SET, CLEAR = 1.0, -1.0
UP = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
WAIT, HOMING_TIME = 20, 600  # steps; the farthest search takes 2 s, with some drives more
SHOWN = {-0.5: Mode.HOMING, 0.5: Mode.PROFILE_POSITION}  # modes as observed


def action(datasheet: Datasheet, control: int, mode: Mode, target: float) -> np.ndarray:
    """Controlword, mode and target position (-1..1) as an action."""
    bits = [SET if control >> bit & 1 else CLEAR for bit in range(CONTROL_BITS)]
    chosen = 1.0 if mode == Mode.PROFILE_POSITION else -1.0
    return datasheet.action(target_position=target, control=[*bits, chosen])


def chain(datasheet: Datasheet, gone: int = 0) -> Steps:
    """Reset the fault, enable, home, move: each when the statusword allows it.

    `gone`: the step in which the cause of the fault goes, as far as that is known.
    """
    homed = start = reset = False
    seen = datasheet.named((yield action(datasheet, 0, Mode.HOMING, 0.0)))
    for _ in range(gone - 1):
        seen = datasheet.named((yield action(datasheet, 0, Mode.HOMING, 0.0)))
    while True:
        status = seen.status[0]
        word = sum(1 << bit for bit in range(STATUS_BITS) if status.statusword[bit] > 0.5)
        state = state_of(word)
        mode = Mode.PROFILE_POSITION if homed else Mode.HOMING
        reset = state in FAULTY and not reset  # an edge every other step
        control = C.FAULT_RESET if reset or state is None else TO_ENABLED[state]
        if state != State.OPERATION_ENABLED or SHOWN.get(float(status.mode)) != mode:
            start = False
        elif not homed and start and word & S.MODE_12 and word & S.TARGET_REACHED:
            homed, start = True, False
        elif not homed or not word & S.MODE_12:  # of pp: set-point acknowledge
            start = True
        if start:
            control |= C.NEW_SET_POINT
        seen = datasheet.named((yield action(datasheet, control, mode, seen.goal)))


def timed(datasheet: Datasheet) -> Steps:
    """Run the step chain by the clock alone, with ample time for each step."""
    seen = datasheet.named((yield action(datasheet, 0, Mode.HOMING, 0.0)))
    for _ in range(int(datasheet.constant("outage"))):
        yield action(datasheet, 0, Mode.HOMING, seen.goal)
    enabled = TO_ENABLED[State.OPERATION_ENABLED]
    start = enabled | C.NEW_SET_POINT
    up = [(TO_ENABLED[state], WAIT) for state in UP]
    home = [(C.FAULT_RESET, WAIT), (0, WAIT), *up, (start, HOMING_TIME)]
    for control, steps in (*home, (enabled, WAIT)):
        for _ in range(steps):
            yield action(datasheet, control, Mode.HOMING, seen.goal)
    for control in (*[enabled] * WAIT, start):
        yield action(datasheet, control, Mode.PROFILE_POSITION, seen.goal)


def plc_policy(datasheet: Datasheet, seed: int = 0) -> Script:
    """The step chain."""
    return Script(partial(chain, datasheet))


def timed_policy(datasheet: Datasheet, seed: int = 0) -> Script:
    """The chain by the clock."""
    return Script(partial(timed, datasheet))
