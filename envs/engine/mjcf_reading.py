"""Reads MJCF that may come from strangers, and refuses what could harm before MuJoCo opens it.

A model may only open files of its own folder, none of them too large, and its counts and sizes may
only ask for a limited number of elements and of bytes. Entities of XML are refused.
"""

import html
import math
import re
from collections.abc import Iterator
from pathlib import Path

import mujoco

from ...drive.model.files import content, regular

WIDTH, HEIGHT = 960, 540  # px, of a picture; the off-screen buffer of the model has to hold it
LARGEST = 64 * 2**20  # bytes of an MJCF file
LARGEST_ASSET = 512 * 2**20  # bytes of the file of a mesh, a texture or a height field
MOST_COPIES = 20_000  # elements that a few lines may make by their counts
MOST_BYTES = 2**30  # that the sizes in the text may ask for
# attributes that ask for memory, with the bytes for each; several stand for their product
_ASKS = {
    "size": {name: 1 for name in ("memory", "nstack")} | {
        name: 1000 for name in ("njmax", "nconmax", "nuserdata", "nkey", "nuser_body", "nuser_jnt",
            "nuser_geom", "nuser_site", "nuser_cam", "nuser_tendon", "nuser_actuator",
            "nuser_sensor")},
    "numeric": {"size": 8},
    "user": {"dim": 8},
    "texture": {"width height": 18},
    "hfield": {"nrow ncol": 32},
}
_COPIES = ("replicate", "composite", "flexcomp", "attach")
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
_SILENT = re.compile(r"(?s)<!--.*?-->|<!\[CDATA\[.*?\]\]>")
_TAG = re.compile(r"""<(/?)([a-z]+)((?:[^"'>]|"[^"]*"|'[^']*')*)>""")
_ATTRIBUTE = re.compile(r"""([a-z_]+)\s*=\s*("[^"]*"|'[^']*')""")
_NAN = re.compile(  # numbers one of which is not a number; a word alone may be a name
    r"""(?i)([a-z_]+)\s*=\s*["']\s*(?:[-+.\de]+\s+)*(?<!name=["'])[-+]?nan(?:\s+[-+.\deNA]+)*\s*["']"""
)
# elements whose files MuJoCo opens while it parses, and the folders in which it looks for meshes
_OPENS = re.compile(r"""<(?:include|model|flexcomp)\b(?:[^"'>]|"[^"]*"|'[^']*')*""")
_FILE = re.compile(r"""\b(file|meshdir|assetdir)\s*=\s*("[^"]*"|'[^']*')""")


def read(mjcf: str | Path, folder: str | Path | None = None) -> mujoco.MjSpec:
    """Read an MJCF file, or text (anything that begins with ``<``).

    Args:
        mjcf: the path or the text of the model.
        folder: folder that must contain its includes, meshes, textures and height fields; by
            default the folder of the file, for text the working directory.

    Raises:
        ValueError: the file does not exist, one of its files lies outside the folder or is too
            large, the model declares entities or asks for too many elements or too much memory, or
            MuJoCo cannot read it.
    """
    if not isinstance(mjcf, str | Path):
        raise ValueError(f"mjcf = {mjcf!r}: give the path of an MJCF file, or its text")
    if not isinstance(folder, str | Path | None):
        raise ValueError(f"folder = {folder!r}: give the path of a folder")
    text, base, files = str(mjcf), Path(), set[Path]()
    if not text.lstrip().startswith("<"):
        file = Path(mjcf)
        if not file.exists():
            raise ValueError(f"there is no MJCF file {mjcf}")
        regular(file)
        if not file.suffix:  # by which MuJoCo recognises the format
            raise ValueError(f"{mjcf}: a file of MJCF ends in .xml")
        base, text = file.parent, _text(file)
        files.add(file.resolve())
    root = Path(base if folder is None else folder).resolve()
    _opened(text, base, root, files, _Asked(), 1.0)
    try:
        spec = mujoco.MjSpec.from_file(str(mjcf)) if files else mujoco.MjSpec.from_string(text)
    except ValueError as error:
        where, said = str(mjcf) if files else "MJCF", " ".join(str(error).split())
        if "find decoder" in said:
            said = "a file of MJCF ends in .xml"
        raise ValueError(f"{where}: {said}") from None
    view = spec.visual.global_
    view.offwidth, view.offheight = max(view.offwidth, WIDTH), max(view.offheight, HEIGHT)
    for place, name in _assets(spec):
        _asset(_inside(base / place / name, root))
    return spec


def _asset(file: Path) -> None:
    """Raise ValueError for the file of an asset that is large, or a picture with many pixels."""
    if not file.exists():
        return  # MuJoCo reports it
    asked = regular(file)
    if file.suffix.lower() == ".png":
        with file.open("rb") as picture:
            head = picture.read(24)
        width, height = (int.from_bytes(head[at : at + 4]) for at in (16, 20))
        asked = max(asked, 4 * width * height)
    if asked > LARGEST_ASSET:
        raise ValueError(f"{file} takes {asked} bytes, a file of a model at most {LARGEST_ASSET}")


class _Asked:
    """Sums of what the counts and sizes of a model ask for, with its includes in their places."""

    def __init__(self) -> None:
        self.copies = self.bytes = 0.0

    def text(self, text: str, times: float) -> Iterator[tuple[str, float]]:
        """Add a text that occurs `times` times; -> its includes, and how often each occurs."""
        around = [times]
        for closes, element, rest in _TAG.findall(_SILENT.sub("", text)):
            values = {name: html.unescape(value[1:-1]) for name, value in _ATTRIBUTE.findall(rest)}
            if closes:
                around = around[: -1 if element == "replicate" and len(around) > 1 else None]
                continue
            times = around[-1]
            if element in _COPIES:
                times *= _product(values.get("count", "1"))
                self._add(element, times, 0.0)
            for names, each in _ASKS.get(element, {}).items():
                amounts = [_product(values.get(name, "0")) for name in names.split()]
                self._add(element, 0.0, each * math.prod(amounts) * around[-1])
            if element == "replicate" and not rest.endswith("/"):
                around.append(times)
            if element == "include" and "file" in values:
                yield values["file"], times

    def _add(self, element: str, copies: float, size: float) -> None:
        self.copies += copies if copies > 1 else 0.0
        self.bytes += size
        if self.copies > MOST_COPIES:
            raise ValueError(
                f"<{element}>: its counts make {self.copies:.3g} elements, {MOST_COPIES} at most"
            )
        if self.bytes > MOST_BYTES:
            raise ValueError(
                f"<{element}>: its sizes ask for {self.bytes:.3g} bytes, {MOST_BYTES} at most"
            )


def _product(text: str) -> float:
    """Multiply the numbers of an attribute, with units of memory; other text counts as 1."""
    product = 1.0
    for word in text.split():
        unit = _UNITS.get(word[-1:].upper(), 1)
        try:
            number = float(word[:-1] if unit > 1 else word)
        except ValueError:
            number = 1.0
        product *= max(number, 1.0 if number > 0 else 0.0) * unit
    return product


def _text(file: Path) -> str:
    return content(file, "an MJCF file", LARGEST).decode("utf-8", "replace")


def _opened(
    text: str, base: Path, root: Path, files: set[Path], asked: _Asked, times: float
) -> None:
    """Check a text and, recursively, the files that MuJoCo opens while it parses."""
    if "<!ENTITY" in text:
        raise ValueError("it declares entities (<!ENTITY ...>), which MJCF has none of: write out "
                         "what they stand for")
    if found := _NAN.search(_SILENT.sub("", text)):  # MuJoCo only logs it
        raise ValueError(f"{found[1]} has a NaN: give a number")
    attributes = [(name, html.unescape(value[1:-1])) for name, value in _FILE.findall(text)]
    places = ["", *(value for name, value in attributes if name != "file")]
    often = dict(asked.text(text, times))  # an include is one of a kind
    for element in _OPENS.findall(text):
        for name, value in _FILE.findall(element):
            for place in places if element.startswith("<flexcomp") else [""]:
                given = html.unescape(value[1:-1])
                file = _inside(base / place / given, root)
                if file.exists() and not file.is_dir():
                    regular(file)
                if name == "file" and not element.startswith("<flexcomp") and file not in files:
                    files.add(file)
                    if file.is_file():
                        _opened(_text(file), base, root, files, asked, often.get(given, times))


def _inside(file: Path, root: Path) -> Path:
    file = file.resolve()
    if not file.is_relative_to(root):
        raise ValueError(
            f"it wants {file}, outside its folder {root}: copy that file there, or trust "
            "the model with folder=, a folder that has both"
        )
    return file


def _assets(spec: mujoco.MjSpec) -> Iterator[tuple[str, str]]:
    """Folder and name of each file that MuJoCo opens while it compiles."""
    for asset in (*spec.meshes, *spec.hfields, *spec.skins):
        if asset.file:
            yield spec.meshdir, asset.file
    for texture in spec.textures:
        for file in (texture.file, *texture.cubefiles):
            if file:
                yield spec.texturedir, file
