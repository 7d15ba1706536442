"""What might have been meant by a name that does not exist."""

from collections.abc import Iterable
from difflib import get_close_matches


def near(name: str, known: Iterable[str]) -> str:
    """``"did you mean X"``, else ``"choose one of …"``; empty where nothing is known."""
    names = list(known)
    found = get_close_matches(name, names, 3, 0.7)
    if found:
        return f"did you mean {' or '.join(found)}"
    return f"choose one of {', '.join(names)}" if names else ""
