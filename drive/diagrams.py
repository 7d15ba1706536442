"""Diagrams of a drive: states and transitions, words bit by bit, paths of homing methods.

These tables serve user interfaces, which need nothing of the control cycle.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .kernel.device_control import TRANSITIONS, Event
from .kernel.encoder import Event as Edge
from .kernel.homing import END, HERE, METHODS, OWN, SLOW, Method
from .kernel.words import (
    ENABLED,
    MODE_ABBREVIATION,
    NONE_OWN,
    SHUTDOWN,
    SWITCHED_ON,
    TO_ENABLED,
    Controlword,
    Limit,
    Mode,
    OwnModes,
    State,
    Statusword,
    controlword_names,
    mode_words,
    state_of,
    statusword_names,
)

__all__ = [
    "ENABLED", "MODE_ABBREVIATION", "TO_ENABLED", "Bit", "Controlword", "Limit", "Mode", "State",
    "Statusword", "Transition", "controlword_bits", "homing_path", "homing_words", "limits",
    "mode_words", "state_of", "statusword_bits", "transitions",
]


class Transition(NamedTuple):
    """An arrow of the state diagram; `controlword` commands it, None if it is automatic."""

    number: int
    source: State
    target: State
    command: str
    controlword: int | None


class Bit(NamedTuple):
    """A bit of the controlword or statusword, with the name it has in a mode."""

    mask: int
    name: str
    meaning: str


COMMANDED = {
    Event.SHUTDOWN: ("shutdown", SHUTDOWN),
    Event.SWITCH_ON: ("switch on", SWITCHED_ON),
    Event.ENABLE_OPERATION: ("enable operation", ENABLED),
    Event.DISABLE_VOLTAGE: ("disable voltage", 0),
    Event.QUICK_STOP: ("quick stop", int(Controlword.ENABLE_VOLTAGE)),
    Event.FAULT_RESET: ("fault reset", int(Controlword.FAULT_RESET)),
}
OF_ITSELF = {
    Event.SELF_TEST_PASSED: "self-test passed",
    Event.FAULT: "fault",
    Event.STOPPED: "stopped",
}


def transitions() -> tuple[Transition, ...]:
    """All transitions of CiA 402-2 except transition 0, power-on."""
    found = []
    for number, source, event, target in TRANSITIONS:
        name, word = COMMANDED.get(event, (OF_ITSELF.get(event, ""), None))
        if source is State.OPERATION_ENABLED and event is Event.SWITCH_ON:
            name = "disable operation"
        found.append(Transition(number, source, target, name, word))
    return tuple(found)


STATUS_MEANINGS = {
    Statusword.READY_TO_SWITCH_ON: "the drive may be switched on",
    Statusword.SWITCHED_ON: "the power stage is ready",
    Statusword.OPERATION_ENABLED: "set-points are obeyed",
    Statusword.FAULT: "a fault has stopped the drive, or is stopping it",
    Statusword.VOLTAGE_ENABLED: "high voltage is applied to the drive",
    Statusword.QUICK_STOP: "0: a quick stop is active",
    Statusword.SWITCH_ON_DISABLED: "the drive may not be switched on before a shutdown",
    Statusword.WARNING: "a warning is present; operation goes on",
    Statusword.MANUFACTURER_8: "of the manufacturer",
    Statusword.REMOTE: "the controlword is obeyed",
    Statusword.TARGET_REACHED: "of the mode",
    Statusword.INTERNAL_LIMIT_ACTIVE: "a limit acts: switch, position, torque or speed",
    Statusword.MODE_12: "of the mode",
    Statusword.MODE_13: "of the mode",
    Statusword.MANUFACTURER_14: "of the manufacturer",
    Statusword.MANUFACTURER_15: "of the manufacturer",
}
CONTROL_MEANINGS = {
    Controlword.SWITCH_ON: "1: switch on",
    Controlword.ENABLE_VOLTAGE: "0: the power goes off",
    Controlword.QUICK_STOP: "0: quick stop",
    Controlword.ENABLE_OPERATION: "1: obey set-points",
    Controlword.NEW_SET_POINT: "a rising edge starts it",
    Controlword.FAULT_RESET: "a rising edge resets the fault",
    Controlword.HALT: "1: stop and wait",
}


def statusword_bits(mode: int, own_modes: OwnModes = NONE_OWN) -> tuple[Bit, ...]:
    """The sixteen bits of 6041h in `mode` (6061h), bit 0 first; `own_modes` of the drive model."""
    return _bits(statusword_names(mode, own_modes), STATUS_MEANINGS)


def controlword_bits(mode: int, own_modes: OwnModes = NONE_OWN) -> tuple[Bit, ...]:
    """The sixteen bits of 6040h in `mode` (6060h), bit 0 first; `own_modes` of the drive model."""
    return _bits(controlword_names(mode, own_modes), CONTROL_MEANINGS)


def _bits(names: Mapping[Any, str], meanings: Mapping[Any, str]) -> tuple[Bit, ...]:
    """Sixteen bits; one without a name in the mode has no meaning either."""
    named = {1 << n: names.get(1 << n, "") for n in range(16)}
    return tuple(
        Bit(mask, name or f"bit {mask.bit_length() - 1}", meanings.get(mask, "") if name else "")
        for mask, name in named.items()
    )


def limits(active: int) -> list[str]:
    """Names of the active limits, from `AXIS.limits`."""
    return [limit.name.lower().replace("_", " ") for limit in Limit if active & limit]


# ---- homing: the axis of the diagram is 0..1, its ends are the mechanical stops

NEGATIVE, POSITIVE, INDEX = 0.08, 0.92, 1 / 24  # limit switches begin; distance of index pulses
HOME = (0.42, 0.58)
TO_THE_END = {3: (0.5, 2.0), 4: (0.5, 2.0), 5: (-1.0, 0.5), 6: (-1.0, 0.5)}


def home_switch(method: int) -> tuple[float, float]:
    """Range of the home switch in the diagram; with some methods it extends to the end."""
    return TO_THE_END.get(method if method < 17 else method - 16, HOME)


def _method(number: int, own: Mapping[int, Method] | None) -> Method:
    """The legs of a homing method. Raises ValueError for an unknown one."""
    found = {**METHODS, **(own or {})}.get(number)
    if found is None:
        raise ValueError(f"homing method {number} is unknown")
    return found


def homing_path(method: int, start: float, own: Mapping[int, Method] | None = None) -> list[float]:
    """Turning points of a homing run from `start` (0..1), ending at home; empty if it fails.

    `own` are the homing methods of the drive model (`DriveModel.own_homing`).

    Raises ValueError for an unknown method.
    """
    if method in HERE:
        return [start]
    first_off, first_on, legs = _method(method, own)
    low, high = home_switch(method)
    leg = first_on if low <= start <= high else first_off
    path, at = [start], start
    for _ in range(8):
        direction, _, event, following, limit = legs[leg]
        place = _place(event, direction, at, (low, high))
        end = NEGATIVE if direction < 0 else POSITIVE
        seeks_end = event in (Edge.STOP, Edge.NEGATIVE_LIMIT_ON, Edge.POSITIVE_LIMIT_ON)
        if not seeks_end and (place is None or (place - end) * direction > 0):
            if limit < 0:
                return []
            at, leg = end, limit
        else:
            assert place is not None
            at, leg = place, following
        path.append(at)
        if leg == END:
            return path
    return []


_EVENTS = {
    Edge.NEGATIVE_LIMIT_ON: "the negative limit switch comes on",
    Edge.NEGATIVE_LIMIT_OFF: "the negative limit switch goes off",
    Edge.POSITIVE_LIMIT_ON: "the positive limit switch comes on",
    Edge.POSITIVE_LIMIT_OFF: "the positive limit switch goes off",
    Edge.HOME_ON: "the home switch comes on",
    Edge.HOME_OFF: "the home switch goes off",
    Edge.INDEX: "the first index pulse",
    Edge.STOP: "the mechanical stop",
}


def homing_words(method: int, own: Mapping[int, Method] | None = None) -> str:
    """A homing method in words, leg by leg; left is the negative direction.

    `own` are the homing methods of the drive model (`DriveModel.own_homing`).

    Raises ValueError for an unknown method.
    """
    if method in HERE:
        return "The position where the axis stands becomes home; nothing moves."
    off, on, legs = _method(method, own)
    visited: dict[int, None] = {}
    said = [_way(legs, off, visited)]
    if on != off:
        said.append(f"beginning on the home switch: {_way(legs, on, visited)}")
    turns = [leg[4] for leg in (legs[n] for n in [*visited]) if leg[4] >= 0]
    for turn in dict.fromkeys(turns):
        said.append(f"turning at a limit switch: {_way(legs, turn, visited)}")
    text = "; ".join(said)
    return f"{text[0].upper()}{text[1:]}."


def _way(legs: Sequence[tuple[int, ...]], leg: int, visited: dict[int, None]) -> str:
    """The legs from one on that have not been visited yet."""
    parts: list[str] = []
    while leg != END and (not parts or leg not in visited):
        visited[leg] = None
        direction, speed, event, leg, _ = legs[leg]
        side = "left" if direction < 0 else "right"
        pace = {SLOW: "slowly ", OWN: "at the model's own speed "}.get(speed, "")
        parts.append(f"{pace}{side} until {_EVENTS[Edge(event)]}")
    return ", ".join(parts) + (": home" if leg == END else ", then as before")


def _place(event: int, direction: int, at: float, home: tuple[float, float]) -> float | None:
    """Position of an event when travelling from `at`; None if it does not occur."""
    if event == Edge.STOP:
        return 0.0 if direction < 0 else 1.0
    if event == Edge.INDEX:
        turns = at / INDEX
        whole = math.ceil(turns - 1) if direction < 0 else math.floor(turns + 1)
        return whole * INDEX
    if event in (Edge.NEGATIVE_LIMIT_ON, Edge.NEGATIVE_LIMIT_OFF):
        return NEGATIVE
    if event in (Edge.POSITIVE_LIMIT_ON, Edge.POSITIVE_LIMIT_OFF):
        return POSITIVE
    low, high = home
    if event == Edge.HOME_ON:
        if low <= at <= high:
            return at
        place = low if direction > 0 else high
    else:
        place = high if direction > 0 else low
    return place if (place - at) * direction >= 0 and 0 <= place <= 1 else None
