"""Snapshots: a line with a checksum, a line of JSON that says whose it is, and arrays as bytes.

One that is truncated, altered, of another version or of something else is refused before anything
of it is taken over. The checksum finds damage; it is not a signature: the arrays are the memory of
compiled code, so only take snapshots that you or someone you trust has made.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from ..model import foreign
from ..model.foreign import Key

VERSION = 4  # of the layout, and of what is in it
MARK = b"servogym-snapshot"
HEAD = {"identity": Key(dict, True), "state": Key(dict, True), "sizes": Key(list, True)}


def seal(identity: Mapping[str, Any], state: Mapping[str, Any], parts: Sequence[bytes]) -> bytes:
    """A snapshot.

    Args:
        identity: of what it is taken; one with another identity refuses it. JSON's types.
        state: the part of the state that is words. JSON's types.
        parts: the part of it that is arrays.
    """
    head = {"identity": identity, "state": state, "sizes": [len(part) for part in parts]}
    body = json.dumps(head).encode() + b"\n" + b"".join(parts)
    return b" ".join((MARK, str(VERSION).encode(), _checksum(body))) + b"\n" + body


def unseal(
    snapshot: bytes, identity: Mapping[str, Any], state: Mapping[str, Key],
    sizes: Sequence[int | None],
) -> tuple[dict[str, Any], list[bytes]]:
    """State and parts of a snapshot.

    Args:
        snapshot: made by `seal`.
        identity: of what is to take it over.
        state: what its state says, and nothing else.
        sizes: bytes of each part; None where they vary.

    Raises:
        ValueError: it is none, damaged, of another version, or of something else.
    """
    if not isinstance(snapshot, bytes | bytearray | memoryview):
        raise ValueError(f"{snapshot!r:.40} is not a snapshot: give the bytes of one")
    title, _, body = bytes(snapshot).partition(b"\n")
    words = title.split(b" ")
    if len(words) != 3 or words[0] != MARK:
        raise ValueError(
            f"this is not a snapshot, it begins with {snapshot[:20]!r}: take a new one"
        )
    if words[1] != str(VERSION).encode():
        raise ValueError(
            f"this snapshot is of version {words[1].decode(errors='replace')[:10]}, version "
            f"{VERSION} is needed: take a new one"
        )
    if words[2] != _checksum(body):
        raise ValueError("this snapshot is damaged, its checksum does not match: take a new one")
    head, _, data = body.partition(b"\n")
    about = foreign.parsed(head, "this snapshot", HEAD)
    for name, own in identity.items():
        its = about["identity"].get(name)
        if its != own:
            raise ValueError(
                f"this snapshot is of another {identity['kind']}: its {name} is {_short(its)}, "
                f"here it is {_short(own)}: take a new one"
            )
    parts, at = [], 0
    for size, wanted in zip(_whole(about["sizes"], len(data)), sizes, strict=False):
        if wanted not in (None, size):
            raise ValueError(f"this snapshot is damaged: a part has {size} bytes, not {wanted}")
        parts.append(data[at : at + size])
        at += size
    if len(parts) != len(sizes) or len(parts) != len(about["sizes"]):
        raise ValueError(f"this snapshot is damaged: it has {len(about['sizes'])} parts")
    return foreign.checked(about["state"], "this snapshot, its state", state), parts


def _whole(sizes: list[Any], length: int) -> list[int]:
    """Sizes of parts that fill `length` bytes. Raises ValueError for others."""
    if any(type(size) is not int or size < 0 for size in sizes) or sum(sizes) != length:
        raise ValueError("this snapshot is damaged: its parts do not fill it")
    return sizes


def _checksum(body: bytes) -> bytes:
    return hashlib.sha256(body).hexdigest().encode()


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
