"""The step chain of a PLC: from a drive in fault to an axis in position."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from ...drive.kernel.words import TO_ENABLED, Mode, State, state_of
from ...drive.kernel.words import Controlword as C
from ...drive.kernel.words import Statusword as S
from ...envs.exchange.faces import CONTROL_BITS, STATUS_BITS
from .datasheet import Datasheet
from .numbers import Range, Tunable
from .script import Script, Steps

FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)  # some models report the latter in FAULT
SET, CLEAR = 1.0, -1.0
UP = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
# Steps for each state and for the homing; the longest search takes 2 s, on some drives more
WAITS = {"wait": Range(2.0, 40.0, 20.0), "homing": Range(100.0, 1000.0, 600.0)}
SHOWN = {-0.5: Mode.HOMING, 0.5: Mode.PROFILE_POSITION}  # modes as observed


def action(datasheet: Datasheet, control: int, mode: Mode, target: float) -> np.ndarray:
    """Return the action for a controlword, a mode and a target position (-1..1)."""
    bits = [SET if control >> bit & 1 else CLEAR for bit in range(CONTROL_BITS)]
    chosen = 1.0 if mode == Mode.PROFILE_POSITION else -1.0
    return datasheet.action(target_position=target, control=[*bits, chosen])


def chain(datasheet: Datasheet, gone: int = 0) -> Steps:
    """Reset the fault, enable, home and move, each as soon as the statusword allows it.

    Args:
        datasheet: of the environment.
        gone: the step in which the cause of the fault clears; 0 if this is not known.
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


def timed(datasheet: Datasheet, waits: Mapping[str, float]) -> Steps:
    """Run the step chain by the clock alone, with given steps for each state and the homing."""
    wait, homing = (round(waits[name]) for name in WAITS)
    seen = datasheet.named((yield action(datasheet, 0, Mode.HOMING, 0.0)))
    for _ in range(int(datasheet.constant("outage"))):
        yield action(datasheet, 0, Mode.HOMING, seen.goal)
    enabled = TO_ENABLED[State.OPERATION_ENABLED]
    start = enabled | C.NEW_SET_POINT
    up = [(TO_ENABLED[state], wait) for state in UP]
    home = [(C.FAULT_RESET, wait), (0, wait), *up, (start, homing)]
    for control, steps in (*home, (enabled, wait)):
        for _ in range(steps):
            yield action(datasheet, control, Mode.HOMING, seen.goal)
    for control in (*[enabled] * wait, start):
        yield action(datasheet, control, Mode.PROFILE_POSITION, seen.goal)


def plc_policy(datasheet: Datasheet, seed: int = 0) -> Script:
    """Return the step chain with feedback."""
    return Script(partial(chain, datasheet))


def timed_policy(datasheet: Datasheet, seed: int = 0) -> Script:
    """Return the chain by the clock, with ample time for each step."""
    return Script(partial(timed, datasheet, {name: one.untuned for name, one in WAITS.items()}))


class TunedTimed(Script, Tunable):
    """The step chain by the clock, with times of the tuner."""

    NAME, RANGES = "tuned_plc_timed", WAITS

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(partial(timed, datasheet, self.numbers(datasheet.task)))
