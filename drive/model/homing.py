"""Homing methods that a drive model defines in its `homing.csv`, one row for each leg.

The engine of the standard methods runs them, see `servogym.drive.kernel.homing`.
"""

from pathlib import Path

from ..kernel.encoder import Event
from ..kernel.homing import END, ERROR, FAST, NUMBERS, OWN, SLOW, Method
from ..kernel.record import MAKER_LEGS, MAKER_METHODS
from .rows import integer, lines_of

FILE = "homing.csv"
COLUMNS = ("method", "leg", "direction", "speed", "until", "next", "at_limit_switch", "section")
WORDS = {
    "direction": {"-": -1, "+": +1},
    "speed": {"fast": FAST, "slow": SLOW, "own": OWN},
    "until": {event.name.lower(): int(event) for event in Event if event},
    "next": {"home": END},
    "at_limit_switch": {"": ERROR, "error": ERROR},
}
ON_SWITCH = "from_home_switch"  # column: the leg that begins where the home switch is on


def read_homing(path: Path) -> dict[int, Method]:
    """Read the methods by number; none if there is no file.

    Raises:
        ValueError: with file, line and reason.
    """
    found: dict[int, list[tuple[int, int, int, int, int]]] = {}
    begin: dict[int, int] = {}
    last: dict[int, str] = {}
    for row, where in lines_of(path, COLUMNS) if path.exists() else ():
        method = integer(row["method"], where, "method")
        if not -128 <= method < 0 or method in NUMBERS:
            raise ValueError(
                f"{where}: method {method}: numbers of a maker are -1 to -128, and "
                f"{', '.join(str(n) for n in NUMBERS if n < 0)} are there already"
            )
        legs = found.setdefault(method, [])
        if row["leg"] != str(len(legs)):
            raise ValueError(
                f"{where}: leg {row['leg']!r} of method {method} has to be {len(legs)}"
            )
        if row.get(ON_SWITCH, "") == "yes":
            begin[method] = len(legs)
        direction, speed, until, following, limit = (_cell(row, name, where) for name in WORDS)
        legs.append((direction, speed, until, following, limit))
        last[method] = where
    for method, legs in found.items():
        for leg in legs:
            if max(leg[3:]) >= len(legs):
                raise ValueError(f"{last[method]}: method {method} has no leg {max(leg[3:])}")
        if END not in (leg[3] for leg in legs):
            raise ValueError(f"{last[method]}: method {method} has no leg that ends at home")
    if len(found) > MAKER_METHODS or sum(map(len, found.values())) > MAKER_LEGS:
        raise ValueError(
            f"{path}: a model has at most {MAKER_METHODS} homing methods of its own, with "
            f"{MAKER_LEGS} legs together"
        )
    return {method: (0, begin.get(method, 0), legs) for method, legs in found.items()}


def _cell(row: dict[str, str], name: str, where: str) -> int:
    """The value of a word of `WORDS`, or of the number of a leg."""
    words, text = WORDS[name], row[name]
    if text in words:
        return words[text]
    if name in ("next", "at_limit_switch") and text.isdecimal():
        return int(text)
    leg = ", or the number of a leg" if name in ("next", "at_limit_switch") else ""
    raise ValueError(f"{where}: {name} {text!r} is none of {', '.join(filter(None, words))}{leg}")
