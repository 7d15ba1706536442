"""What a model can, from `[capabilities]` of its drive.toml; 6502h and 60E3h repeat it."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..kernel.homing import NUMBERS
from ..kernel.words import MODE_ABBREVIATION, Mode, mode_bit
from .rows import Object

MODES = {abbreviation: mode for mode, abbreviation in MODE_ABBREVIATION.items()}
SUPPORTED_MODES, SUPPORTED_METHODS = 0x6502, 0x60E3
KNOWN = sum(1 << mode_bit(mode) for mode in Mode if mode)  # bits of 6502h that the kernel has


def read_capabilities(
    table: dict[str, Any], path: Path, own: Iterable[int] = ()
) -> tuple[tuple[Mode, ...], tuple[int, ...]]:
    """Modes and homing methods, after which come the model's `own`.

    Raises ValueError for one that there is not.
    """
    for kind, known in (("modes", MODES), ("homing_methods", (*NUMBERS, *own))):
        for name in table.get(kind, ()):
            if name not in known:
                raise ValueError(f"{path}: unknown {kind} {name!r}, known: {[*known]}")
    modes = tuple(MODES[name] for name in table.get("modes", ()))
    return modes, tuple(dict.fromkeys((*table.get("homing_methods", ()), *own)))


def with_capabilities(
    objects: dict[tuple[int, int], Object], modes: tuple[Mode, ...], methods: tuple[int, ...]
) -> dict[tuple[int, int], Object]:
    """The objects, of which 6502h and 60E3h say what the drive can, where it has them.

    6060h and 6098h know it as well, to tell it to who writes something else.
    """
    possible = {"mode": (0, *map(int, modes)), "homing_method": (0, *methods)}
    told: dict[tuple[int, int], Object] = {}
    for (index, subindex), row in objects.items():
        if index == SUPPORTED_MODES and row.format:
            others = int(row.default) & ~KNOWN
            bits = others | sum(1 << mode_bit(mode) for mode in modes)
            row = replace(row, default=bits & (1 << 8 * row.size) - 1)  # some have UNSIGNED8
        elif index == SUPPORTED_METHODS and not subindex:
            row = replace(row, default=len(methods) if (index, 1) in objects else 0)
        elif index == SUPPORTED_METHODS:
            if subindex == 1:  # the others are like the first
                for n, method in enumerate(methods, 1):
                    named = f"{row.name.removesuffix('_1')}_{n}"
                    one = objects.get((index, n)) or replace(
                        row, subindex=n, name=named, area="constant", offset=0
                    )
                    bits = method & 0xFF if one.format.isupper() else method  # some have UNSIGNED8
                    told[index, n] = replace(one, default=bits)
            continue
        elif row.hook in possible:
            row = replace(row, possible=possible[row.hook])
        told[index, subindex] = row
    return told
