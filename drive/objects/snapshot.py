"""Snapshots: a line with a checksum, a line of JSON with the identity, and arrays as bytes.

A snapshot that is truncated, altered, of another version or of another object is refused before
anything is restored. The checksum finds damage; it is not a signature. The arrays are the memory of
compiled code, so restore only snapshots that you or someone you trust has made.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from ..model import foreign
from ..model.foreign import Key

VERSION = 4  # of layout and content
MARK = b"servogym-snapshot"
HEAD = {"identity": Key(dict, True), "state": Key(dict, True), "sizes": Key(list, True)}


def seal(identity: Mapping[str, Any], state: Mapping[str, Any], parts: Sequence[bytes]) -> bytes:
    """Make a snapshot.

    Args:
        identity: identity of the object, which has to be equal when it is restored (JSON types).
        state: the part of the state that is text and numbers (JSON types).
        parts: the part of the state that is arrays.
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
        identity: identity of the object to be restored.
        state: keys of its state; others are refused.
        sizes: size of each part (bytes); None if it varies.

    Raises:
        ValueError: it is no snapshot, damaged, of another version, or of another object.
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
