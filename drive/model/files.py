"""Files from elsewhere: only regular files of a plausible size are opened.

Reading a pipe, a terminal or a device might wait forever or never end; a file of a gigabyte would
fill the memory. Both are refused before a byte is read.
"""

import os
import stat
from pathlib import Path

LARGEST = 16 * 2**20  # bytes of a text, a hundred times as many as our own have
KINDS = (
    (stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe (FIFO)"), (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"),
)


def regular(path: str | Path) -> int:
    """The size (bytes) of a regular file.

    Raises:
        ValueError: it is a folder, a pipe, a socket or a device.
        OSError: it does not exist, or cannot be inspected.
    """
    found = os.stat(path)
    if not stat.S_ISREG(found.st_mode):
        kind = next((name for of, name in KINDS if of(found.st_mode)), "something else")
        raise ValueError(f"{path} cannot be read: it is {kind}, give a file")
    return found.st_size


def content(path: str | Path, what: str = "a file", largest: int = LARGEST) -> bytes:
    """The bytes of a file.

    Args:
        path: path of the file.
        what: its kind for the error message, such as "a file of a model".
        largest: maximum size (bytes).

    Raises:
        ValueError: it is not a regular file, or it is larger.
        OSError: it does not exist, or cannot be read.
    """
    if (size := regular(path)) > largest:
        raise ValueError(f"{path} has {size} bytes, {what} has at most {largest}")
    with open(path, "rb") as file:
        data = file.read(largest + 1)  # it may have grown
    if len(data) > largest:
        raise ValueError(f"{path} has more bytes than {what} may have, {largest}")
    return data
