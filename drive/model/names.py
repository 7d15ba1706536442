"""Names that a user gives: values by name, and suggestions for misspelt names."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

MOST = 30  # names in a message


def hint(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """``"did you mean X"``, otherwise `otherwise`, or ``"choose one of …"``, or nothing."""
    names = list(known)
    found = get_close_matches(name, names, 3, 0.7)
    if found:
        return f"did you mean {' or '.join(found)}"
    shown = [*names[:MOST], f"… ({len(names)} in all)"] if len(names) > MOST else names
    return otherwise or (f"choose one of {', '.join(shown)}" if names else "")


def named(name: str, given: Any, example: str) -> dict[str, Any]:
    """Values by name, empty for None. Raises ValueError for anything but a mapping."""
    if given is None:
        return {}
    if not (isinstance(given, Mapping) and all(isinstance(key, str) for key in given)):
        raise ValueError(f"{name} = {given!r}: give values by name, as {example}")
    return dict(given)
