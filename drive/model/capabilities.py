"""The modes and homing methods of a model, from its drive.toml; 6502h and 60E3h report them."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..kernel.homing import NUMBERS as METHODS
from ..kernel.modes.own import NUMBERS
from ..kernel.words import MODE_ABBREVIATION, Mode, ModeWords, mode_bit
from .drive_toml import refuse_unknown
from .rows import Object

MODES = {abbreviation: mode for mode, abbreviation in MODE_ABBREVIATION.items()}
STANDARD = {*MODES, *(mode.name.lower() for mode in Mode)}
SUPPORTED_MODES, SUPPORTED_METHODS = 0x6502, 0x60E3
KNOWN = sum(1 << mode_bit(mode) for mode in Mode if mode)  # bits of 6502h that the kernel has


def read_own_modes(table: dict[str, Any], path: Path) -> dict[int, ModeWords]:
    """The model's own modes by their number in 6060h. Raises ValueError with file and key."""
    found: dict[int, ModeWords] = {}
    for name, row in table.items():
        if not isinstance(row, dict):
            raise ValueError(f"{path}: modes.{name} is not a table like [modes.{name}]")
        refuse_unknown(row, ("number", "bits", "bit_4", "section"), path, f"modes.{name}.")
        number, bits = row.get("number"), row.get("bits", ["", "", ""])
        if not isinstance(number, int) or number not in NUMBERS or number in found:
            raise ValueError(
                f"{path}: modes.{name}.number = {number!r}: numbers of a maker are "
                f"{NUMBERS[-1]} to {NUMBERS[0]}, each for one mode"
            )
        if not isinstance(bits, list) or [*map(type, bits)] != [str] * 3:
            raise ValueError(
                f"{path}: modes.{name}.bits = {bits!r} is not a list of three names: of bits 10, "
                "12 and 13 of the statusword"
            )
        for key in ("bit_4", "section"):
            if not isinstance(row.get(key, ""), str):
                raise ValueError(f"{path}: modes.{name}.{key} = {row[key]!r} is not a text")
        if name.lower() in STANDARD:
            raise ValueError(f"{path}: modes.{name}: the standard has a mode of this name")
        found[number] = ModeWords(
            name, tuple(bits), row.get("bit_4", ""), section=row.get("section", "")
        )
    return found


def read_capabilities(
    table: dict[str, Any], path: Path, own_modes: Iterable[int] = (), own: Iterable[int] = ()
) -> tuple[tuple[Mode, ...], tuple[int, ...]]:
    """Modes and homing methods, after which come the model's `own_modes` and `own` methods.

    Raises ValueError for an unknown one.
    """
    for kind, known in (("modes", MODES), ("homing_methods", (*METHODS, *own))):
        for name in table.get(kind, ()):
            if name not in known:
                raise ValueError(f"{path}: unknown {kind} {name!r}, known: {[*known]}")
    modes = (*(MODES[name] for name in table.get("modes", ())), *map(Mode, own_modes))
    return modes, tuple(dict.fromkeys((*table.get("homing_methods", ()), *own)))


def with_capabilities(
    objects: dict[tuple[int, int], Object], modes: tuple[Mode, ...], methods: tuple[int, ...]
) -> dict[tuple[int, int], Object]:
    """The objects, with 6502h and 60E3h (where the model has them) reporting the capabilities.

    6060h and 6098h list them, too, for the message that refuses another value.
    """
    possible = {"mode": (0, *map(int, modes)), "homing_method": (0, *methods)}
    answers: dict[tuple[int, int], Object] = {}
    for (index, subindex), row in objects.items():
        if index == SUPPORTED_MODES and row.format:
            others = int(row.default) & ~KNOWN
            bits = others | sum(1 << mode_bit(mode) for mode in modes)
            row = _with_bits(row, bits)
        elif index == SUPPORTED_METHODS and row.format and not subindex:
            row = _with_bits(row, len(methods) if (index, 1) in objects else 0)
        elif index == SUPPORTED_METHODS and row.format:
            if subindex == 1:  # the others are like the first
                for n, method in enumerate(methods, 1):
                    named = f"{row.name.removesuffix('_1')}_{n}"
                    one = objects.get((index, n)) or replace(
                        row, subindex=n, name=named, area="constant", offset=0
                    )
                    answers[index, n] = _with_bits(one, method)
            continue
        elif row.hook in possible:
            row = replace(row, possible=possible[row.hook])
        answers[index, subindex] = row
    return answers


def _with_bits(row: Object, value: int) -> Object:
    """A row with a number as default, cut to the row's type; files from elsewhere give it any."""
    return replace(row, default=value if row.real else row.shown(value)) if row.format else row
