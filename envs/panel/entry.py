"""Parses numbers typed into fields, checks their range, and explains what is wrong."""

import math

LONGEST = 40  # characters of the input that a message repeats


def number(
    text: object, low: float = -math.inf, high: float = math.inf, unit: str = "", *,
    whole: bool = False,
) -> float:
    """Parse the number in a field.

    Whole numbers may be hexadecimal: ``0x1F`` or ``1Fh``. A decimal comma counts as a point.

    Raises:
        ValueError: invalid number; the message contains the range.
    """
    typed = str(text if text is not None else "").strip()
    shown = typed if len(typed) <= LONGEST else f"{typed[:LONGEST]}…"
    between = f"{_bound(low)}..{_bound(high)} {unit}".strip() if math.isfinite(low + high) else unit
    if not typed:
        raise ValueError(f"enter a number {between}".strip())
    value = _hexadecimal(typed) if whole else None
    if value is None:
        try:
            value = float(typed.replace(",", ".").replace("−", "-"))
        except ValueError:
            raise ValueError(f"“{shown}” is not a number {between}".strip()) from None
    if not math.isfinite(value):
        raise ValueError(f"“{shown}” is not a finite number")
    if whole and value != int(value):
        raise ValueError(f"“{shown}” is not a whole number")
    if not low <= value <= high:
        raise ValueError(f"{shown} is out of range {between}")
    return value


def _hexadecimal(typed: str) -> float | None:
    digits = typed.lower()
    if digits.startswith("0x"):
        digits = digits[2:]
    elif digits.endswith("h"):
        digits = digits[:-1]
    else:
        return None
    try:
        return float(int(digits, 16)) if digits.isalnum() else None
    except (ValueError, OverflowError):
        return None


def _bound(value: float) -> str:
    return f"{value:.0f}" if value == int(value) else f"{value:g}"
