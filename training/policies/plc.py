"""Commissioning-v0: the step chain of a PLC."""

import numpy as np

from ...drive.words import TO_ENABLED, Mode, State, state_of
from ...drive.words import Controlword as C
from ...drive.words import Statusword as S
from .known import Known
from .script import Script, Steps

FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)  # some models show this one in FAULT
SHOWN = {-0.5: Mode.HOMING, 0.5: Mode.PROFILE_POSITION}  # modes as observed


def action(control: int, mode: Mode, target: float) -> np.ndarray:
    """Controlword, mode and target position (-1..1) as an action."""
    bits = [1.0 if control >> bit & 1 else -1.0 for bit in range(9)]
    return np.array([target, *bits, 1.0 if mode == Mode.PROFILE_POSITION else -1.0], np.float32)


HOLD = action(0, Mode.HOMING, 0.0)


def chain() -> Steps:
    """Reset the fault, enable, home, move: each when the statusword allows it."""
    homed = start = reset = False
    seen = yield HOLD
    while True:
        word = sum(1 << bit for bit in range(16) if seen[6 + bit] > 0.5)
        state = state_of(word)
        mode = Mode.PROFILE_POSITION if homed else Mode.HOMING
        reset = state in FAULTY and not reset  # an edge every other step
        control = C.FAULT_RESET if reset or state is None else TO_ENABLED[state]
        if state != State.OPERATION_ENABLED or SHOWN.get(float(seen[22])) != mode:
            start = False
        elif not homed and start and word & S.MODE_12 and word & S.TARGET_REACHED:
            homed, start = True, False
        elif not homed or not word & S.MODE_12:  # of pp: set-point acknowledge
            start = True
        if start:
            control |= C.NEW_SET_POINT
        seen = yield action(control, mode, seen[0])


def plc_policy(known: Known, seed: int = 0) -> Script:
    """The step chain."""
    return Script(chain)
