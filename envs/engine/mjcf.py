"""Robots from outside: any MJCF made ready for drives, through `mujoco.MjSpec`.

What is changed, and only for joints that get a drive:

- An actuator that is not a plain motor (position, velocity, general, ...), or whose gear is given,
  becomes one: gain 1, no bias, no dynamics, no delay. It keeps its name and its number in
  ``data.ctrl``. A joint without an actuator gets one, the last, with the name of the joint.
- Such a motor has the gear of `gears`, else `GEARS`; the joint's armature becomes the rotor inertia
  of the drive model times gear². A plain motor without a control range and without an entry in
  `gears` is the mechanics already: it keeps its gear, and the joint its armature. With a control
  range, as robots for learning have it, MuJoCo's `gear` is the torque of a control of 1 and says
  nothing of a reduction: that motor gets the usual gear.
- Limits of control, of actuator force and of the joint's actuator force are lifted, because the
  drive has limits of its own.
- The integrator RK4 becomes implicitfast: friction and drive act once a step.
- The timestep, where it does not fit into the velocity cycles: the next shorter one that does.
- Keyframes: the control of such an actuator is 0 Nm; their actuator activations are dropped where
  the number of these changes.

Everything else stays, other actuators too: they obey ``data.ctrl``.
"""

import functools
import html
import math
import re
from collections.abc import Iterator, Mapping
from numbers import Real
from pathlib import Path

import mujoco

from ...drive.model.files import content, regular
from ...drive.model.model import DriveModel
from ...drive.model.names import hint, named

GEAR_RANGE = 1e-3, 1e6  # rad per m or rad; outside it lie typing errors
JOINT_TYPES = {mujoco.mjtJoint.mjJNT_SLIDE: "m", mujoco.mjtJoint.mjJNT_HINGE: "rad"}  # units
ON_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
# motor angle per joint travel where nothing is said
GEARS = {
    mujoco.mjtJoint.mjJNT_HINGE: 100.0,  # rad/rad; strain wave gears have 30..160 (inferred)
    mujoco.mjtJoint.mjJNT_SLIDE: 2 * math.pi / 0.02,  # rad/m; a ball screw of 20 mm lead (inferred)
}
# what says whose actuator it is; everything else says how it acts
_IDENTITY = ("name", "target", "trntype", "group", "userdata", "info", "id", "signature")
_OBJECTS = ("classname", "compiler", "plugin")
WIDTH, HEIGHT = 960, 540  # of a picture, what it is drawn into has to have
LARGEST = 64 * 2**20  # bytes of a file of MJCF
LARGEST_ASSET = 512 * 2**20  # bytes of a file of a mesh, a picture or a height field
MOST_COPIES = 20_000  # elements that counts make of a few lines
MOST_BYTES = 2**30  # that numbers of the text ask for
# attributes that ask for memory: how many bytes for each; of more than one the product counts
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
_NAN = re.compile(  # a value of numbers among which one is none; what is only a word may be a name
    r"""(?i)([a-z_]+)\s*=\s*["']\s*(?:[-+.\de]+\s+)*(?<!name=["'])[-+]?nan(?:\s+[-+.\deNA]+)*\s*["']"""
)
# elements whose files MuJoCo opens while it parses, and where files of meshes are looked for
_OPENS = re.compile(r"""<(?:include|model|flexcomp)\b(?:[^"'>]|"[^"]*"|'[^']*')*""")
_FILE = re.compile(r"""\b(file|meshdir|assetdir)\s*=\s*("[^"]*"|'[^']*')""")


def read(mjcf: str | Path, folder: str | Path | None = None) -> mujoco.MjSpec:
    """An MJCF file, or text (anything that begins with ``<``), that brings only files of its own.

    Args:
        mjcf: the model.
        folder: what its includes, meshes, textures and height fields must lie in; if not given the
            folder of the file, of a text the working directory.

    Raises:
        ValueError: there is no such file, a file of it lies elsewhere or is too large, it declares
            entities, asks for more elements or memory than it may, or MuJoCo cannot read it.
    """
    if not isinstance(mjcf, str | Path):
        raise ValueError(f"mjcf = {mjcf!r}: give the path of an MJCF file, or its text")
    if not isinstance(folder, str | Path | None):
        raise ValueError(f"folder = {folder!r}: give the path of a folder")
    text, base, seen = str(mjcf), Path(), set[Path]()
    if not text.lstrip().startswith("<"):
        file = Path(mjcf)
        if not file.exists():
            raise ValueError(f"there is no MJCF file {mjcf}")
        regular(file)
        if not file.suffix:  # MuJoCo knows files by that
            raise ValueError(f"{mjcf}: a file of MJCF ends in .xml")
        base, text = file.parent, _text(file)
        seen.add(file.resolve())
    root = Path(base if folder is None else folder).resolve()
    _opened(text, base, root, seen, _Asked(), 1.0)
    try:
        spec = mujoco.MjSpec.from_file(str(mjcf)) if seen else mujoco.MjSpec.from_string(text)
    except ValueError as error:
        where, said = str(mjcf) if seen else "MJCF", " ".join(str(error).split())
        if "find decoder" in said:
            said = "a file of MJCF ends in .xml"
        raise ValueError(f"{where}: {said}") from None
    view = spec.visual.global_
    view.offwidth, view.offheight = max(view.offwidth, WIDTH), max(view.offheight, HEIGHT)
    for place, name in _assets(spec):
        _asset(_inside(base / place / name, root))
    return spec


def _asset(file: Path) -> None:
    """Refuse what becomes large when MuJoCo opens it."""
    if not file.exists():
        return  # MuJoCo says so
    asked = regular(file)
    if file.suffix.lower() == ".png":
        with file.open("rb") as picture:
            head = picture.read(24)
        width, height = (int.from_bytes(head[at : at + 4]) for at in (16, 20))
        asked = max(asked, 4 * width * height)
    if asked > LARGEST_ASSET:
        raise ValueError(f"{file} takes {asked} bytes, a file of a model at most {LARGEST_ASSET}")


class _Asked:
    """What the counts and sizes of a text ask for, its includes in their places."""

    def __init__(self) -> None:
        self.copies = self.bytes = 0.0

    def text(self, text: str, times: float) -> Iterator[tuple[str, float]]:
        """Count it, `times` as often; -> the files it includes, and how often each."""
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
    text: str, base: Path, root: Path, seen: set[Path], asked: _Asked, times: float
) -> None:
    """Look through what MuJoCo opens while it parses, one in the other."""
    if "<!ENTITY" in text:
        raise ValueError("it declares entities (<!ENTITY ...>), which MJCF has none of: write out "
                         "what they stand for")
    if found := _NAN.search(_SILENT.sub("", text)):  # MuJoCo writes a log, and goes on with it
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
                if name == "file" and not element.startswith("<flexcomp") and file not in seen:
                    seen.add(file)
                    if file.is_file():
                        _opened(_text(file), base, root, seen, asked, often.get(given, times))


def _inside(file: Path, root: Path) -> Path:
    file = file.resolve()
    if not file.is_relative_to(root):
        raise ValueError(
            f"it wants {file}, outside its folder {root}: copy that file there, or trust "
            "the model with folder=, a folder that has both"
        )
    return file


def _assets(spec: mujoco.MjSpec) -> Iterator[tuple[str, str]]:
    """Folder and name of the files that compiling opens."""
    for asset in (*spec.meshes, *spec.hfields, *spec.skins):
        if asset.file:
            yield spec.meshdir, asset.file
    for texture in spec.textures:
        for file in (texture.file, *texture.cubefiles):
            if file:
                yield spec.texturedir, file


def attach(
    spec: mujoco.MjSpec, drives: Mapping[str, DriveModel], gears: Mapping[str, float]
) -> None:
    """Put a motor on the joint of every drive, as the head of this file says.

    Args:
        spec: the robot; changed in place.
        drives: drive model by actuator or joint name; an actuator goes before a joint.
        gears: rad of motor shaft per m (slide) or rad (hinge) of the joint, by drive name.

    Raises:
        ValueError: a name that is missing, a joint or transmission that cannot take a drive, two
            actuators or drives on a joint, a gear out of `GEAR_RANGE`.
    """
    for name in named("gears", gears, '{"joint": 100}'):
        if name not in drives:
            raise ValueError(f"gears: there is no drive {name!r}: {hint(name, drives)}")
    names: dict[str, str] = {}  # drive by joint
    for name, drive in drives.items():
        joint, actuator = _place(spec, name)
        if joint.name in names:
            raise ValueError(
                f"drives {names[joint.name]!r} and {name!r} are both on joint {joint.name!r}: "
                "leave one out"
            )
        names[joint.name] = name
        if actuator is None or name in gears or not _plain(actuator):
            gear = _gear(name, gears.get(name, GEARS[joint.type]), JOINT_TYPES[joint.type])
            _install(spec, joint, actuator, gear)
            joint.armature = drive.rotor_inertia * gear**2
        else:
            actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT  # in its parent it is the same
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.timestep = fitting_timestep(spec.option.timestep, drives)


def fitting_timestep(timestep: float, drives: Mapping[str, DriveModel]) -> float:
    """The longest physics step (s) not above `timestep` that fits into all velocity cycles."""
    if not (math.isfinite(timestep) and timestep > 0.0):
        raise ValueError(f"option timestep = {timestep} s must be finite and above 0")
    nanoseconds = {round(drive.cycle_time["velocity"] * 1e9) for drive in drives.values()}
    cycle = functools.reduce(math.gcd, nanoseconds) * 1e-9
    steps = math.ceil(cycle / timestep - 1e-9)
    return timestep if abs(steps * timestep - cycle) < 1e-9 * cycle else cycle / steps


def actuator_of(model: mujoco.MjModel, name: str) -> int:
    """Number of the actuator called `name`, else of the only one on the joint called so.

    Raises ValueError with the names there are.
    """
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    if number >= 0:
        return number
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    if joint < 0:
        actuators = [model.actuator(i).name for i in range(model.nu)]
        joints = [model.joint(i).name for i in range(model.njnt)]
        raise ValueError(_missing(name, actuators, joints))
    on_it = [
        i
        for i in range(model.nu)
        if model.actuator_trntype[i] in map(int, ON_JOINT) and model.actuator_trnid[i, 0] == joint
    ]
    if len(on_it) != 1:
        raise ValueError(
            f"joint {name!r} has {len(on_it)} actuators, a drive needs one: "
            "name the actuator, or use Machine.from_mjcf, which adds a missing one"
        )
    return on_it[0]


def _missing(name: str, actuators: list[str], joints: list[str]) -> str:
    return (
        f"there is no actuator or joint {name!r}: the model has "
        f"the actuators {[n for n in actuators if n]} and the joints {[n for n in joints if n]}"
    )


def _place(spec: mujoco.MjSpec, name: str):
    """The joint that `name` means and its actuator, None where it has none."""
    actuator = spec.actuator(name)
    if actuator is not None and actuator.trntype not in ON_JOINT:
        kind = actuator.trntype.name.removeprefix("mjTRN_").lower()
        raise ValueError(
            f"actuator {name!r} acts on a {kind}, a drive needs a slide or hinge joint: "
            "name such a joint"
        )
    joint = spec.joint(name if actuator is None else actuator.target)
    if joint is None:
        raise ValueError(
            _missing(name, [a.name for a in spec.actuators], [j.name for j in spec.joints])
        )
    if joint.type not in JOINT_TYPES:
        kind = joint.type.name.removeprefix("mjJNT_").lower()
        raise ValueError(
            f"joint {joint.name!r} is a {kind} joint, a drive needs a slide or hinge joint: "
            "drive another one, or make hinges of it"
        )
    on_it = [a for a in spec.actuators if a.trntype in ON_JOINT and a.target == joint.name]
    if len(on_it) > 1:
        raise ValueError(
            f"joint {joint.name!r} has {len(on_it)} actuators {[a.name for a in on_it]}: "
            "the drive is its only controller, so delete all but one from the MJCF"
        )
    return joint, on_it[0] if on_it else None


def _plain(actuator) -> bool:
    """Whether it is a motor that knows its reduction: gain 1, no bias, no dynamics, no range."""
    return (
        actuator.ctrllimited != mujoco.mjtLimited.mjLIMITED_TRUE
        and actuator.ctrlrange[0] == actuator.ctrlrange[1]
        and actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
        and actuator.gainprm[0] == 1.0
        and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
        and actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE
    )


def _gear(name: str, gear: float, unit: str) -> float:
    low, high = GEAR_RANGE
    if not isinstance(gear, Real) or not low <= abs(gear) <= high:
        raise ValueError(
            f"gears[{name!r}] = {gear!r} rad/{unit} is out of range {low:g}..{high:g}: "
            f"it is the motor's angle per {unit} of joint travel, negative to turn the direction"
        )
    return float(gear)


def _install(spec: mujoco.MjSpec, joint, actuator, gear: float) -> None:
    """Make `actuator` a plain motor with `gear`; a new one on `joint` if it is None."""
    number = len(spec.actuators) if actuator is None else spec.actuators.index(actuator)
    if actuator is None:
        actuator = spec.add_actuator(name=joint.name, target=joint.name)
    stateful = actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE
    # `set_to_motor` leaves limits, delays and the like; an actuator of an empty model has none
    pristine = mujoco.MjSpec().add_actuator()
    for field in dir(pristine):
        if not field.startswith(("_", "set_")) and field not in (*_IDENTITY, *_OBJECTS):
            setattr(actuator, field, getattr(pristine, field))
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.plugin.active = False
    actuator.ctrllimited = actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    actuator.gear = [gear, 0.0, 0.0, 0.0, 0.0, 0.0]
    for key in spec.keys:
        if len(key.ctrl):
            ctrl = [*key.ctrl, 0.0][: len(spec.actuators)]
            ctrl[number] = 0.0
            key.ctrl = ctrl
        if stateful:
            key.act = []
