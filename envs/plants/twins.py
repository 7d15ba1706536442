"""Reads twins: machines identified from a log, which `servogym.envs.twin` stores in folders.

A folder holds ``twin.json``, a report and pictures. The JSON has a schema and a checksum, and its
names and ranges are checked one by one; nothing in it runs as code.
"""

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...drive.model.model import DriveModel, load
from ...drive.model.names import hint
from ..engine import parameters
from ..engine.machine import Machine
from .axis_parameters import LinearAxisParameters, family
from .rotary_parameters import ROTARY_FAMILY, RotaryParameters

FILE = "twin.json"
SCHEMA = "servogym.twin/1"
LARGEST = 1 << 20  # bytes of the file
VERDICTS = ("good", "fair", "refused", "interrupted")
BUILT = {
    "load_stiffness": "stiffness",
    "load_damping": "structural_damping",
}  # parameter of a twin: parameter of the builder
DRAWN_ALONE = ("encoder_noise",)  # parameters without an interval


@dataclass(frozen=True)
class Value:
    """An identified parameter."""

    value: float
    low: float  # of the 95 % interval
    high: float
    unit: str


@dataclass(frozen=True)
class Twin:
    """The contents of a folder of `servogym twin`, as `read` returns them."""

    folder: Path
    drive: str
    builder: str
    arguments: Mapping[str, Any]
    axis: str
    parameters: Mapping[str, Value]
    objects: Mapping[str, float]
    held_out: Mapping[str, float]
    verdict: str
    cycle: float  # s, of the bus
    lag: float  # s, from a set-point to the sample that shows it
    mechanics: str = ""  # the family of `servogym twin`

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name."""
        return {name: each.value for name, each in self.parameters.items()}

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Intervals of the identified parameters, for ``randomise``."""
        return {
            name: (each.low, each.high)
            for name, each in self.parameters.items()
            if name not in DRAWN_ALONE and each.low < each.high
        }

    def datasheet(self) -> LinearAxisParameters | RotaryParameters | None:
        """Return the identified parameters of a linear or rotary axis; None for other machines."""
        values = {BUILT.get(name, name): value for name, value in self.values.items()}
        given = {n: v for n, v in self.arguments.items() if n not in ("mechanics", "tuned")}
        if self.builder == "rotary_axis":
            plain = ROTARY_FAMILY[self.arguments["mechanics"]]
            known = {n: v for n, v in values.items() if hasattr(plain, n)}
            return replace(plain, **given, **known)  # type: ignore[arg-type]
        if self.builder != "linear_axis":
            return None
        preset = family(self.arguments["mechanics"], **given)
        known = {n: v for n, v in values.items() if hasattr(preset, n)}
        if preset.static_friction and "static_friction" not in known:
            ratio = preset.static_friction / preset.coulomb_friction
            known["static_friction"] = ratio * known.get("coulomb_friction", 0.0)
        return replace(preset, **known)  # type: ignore[arg-type]

    def give(self, machine: Machine) -> None:
        """Set the identified parameters and objects in a machine of the same structure."""
        machine.drives[self.axis].commission(dict(self.objects))
        parameters.apply(machine, self.values, self.axis)
        machine.reset()

    def machine(
        self, make: Callable[..., Machine], drive: str | Path | DriveModel | None = None
    ) -> Machine:
        """Build the machine of the twin, commissioned and at rest.

        Args:
            make: the function that `builder` names.
            drive: drive model instead of that of the twin.
        """
        model = load(self.drive if drive is None else drive)
        plant = self.datasheet()
        # its gains are those of the log, not those that suit plant and motor
        given = dict(self.arguments) if plant is None else {"parameters": plant, "tuned": False}
        machine = make(model, **given)
        self.give(machine)
        return machine


def machine_of(
    folder: str | Path, make: Callable[..., Machine], drive: str | Path | DriveModel
) -> Machine:
    """Build the machine of a twin by `make`; the drive "generic" stands for that of the twin.

    Raises ValueError for another kind of machine, and as `read`.
    """
    twin = read(folder)
    if twin.builder != make.__name__:
        raise ValueError(f"twin = {str(folder)!r} is a {twin.builder}, no {make.__name__}")
    return twin.machine(make, None if drive == "generic" else drive)


def read(folder: str | Path) -> Twin:
    """Read the twin in a folder that `servogym twin` has written.

    Raises:
        ValueError: the folder has no twin, or the twin is damaged, has another version or unknown
            parameters.
    """
    file = Path(folder) / FILE if Path(folder).suffix != ".json" else Path(folder)
    if not file.is_file():
        raise ValueError(
            f"twin = {str(folder)!r}: there is no {FILE} in it; servogym twin makes one"
        )
    if file.stat().st_size > LARGEST:
        raise ValueError(f"{file}: larger than {LARGEST} bytes, this is not a twin")
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        schema = content["schema"]
    except (ValueError, KeyError, TypeError):
        raise ValueError(f"{file}: damaged, or no twin; make it again from the log") from None
    if schema != SCHEMA:
        raise ValueError(f"{file}: schema {schema!r}, this version reads {SCHEMA!r}")
    if content.get("checksum") != checksum(content):
        raise ValueError(f"{file}: the checksum does not fit: it was changed by hand or cut off")
    try:
        return _checked(file, content)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{file}: lacks {error}, or it is of the wrong kind") from None


def _checked(file: Path, content: Mapping[str, Any]) -> Twin:
    if content["verdict"] not in VERDICTS:
        raise ValueError(f"{file}: verdict {content['verdict']!r}, not one of {VERDICTS}")
    machine = content["machine"]
    if machine["builder"] not in ("linear_axis", "rotary_axis", "gantry"):
        raise ValueError(f"{file}: no machine is called {machine['builder']!r}")
    found = {}
    for name, row in content["parameters"].items():
        if name not in parameters.PARAMETERS:
            raise ValueError(
                f"{file}: no parameter is called {name!r}: {hint(name, parameters.PARAMETERS)}"
            )
        value = Value(float(row["value"]), float(row["low"]), float(row["high"]), str(row["unit"]))
        if not all(map(math.isfinite, (value.value, value.low, value.high))):
            raise ValueError(f"{file}: {name} is not a number")
        found[name] = value
    return Twin(
        file.parent, str(content["drive"]), machine["builder"], dict(machine["arguments"]),
        str(machine["axis"]), found, {k: float(v) for k, v in content["objects"].items()},
        {k: float(v) for k, v in content["held_out"].items()}, content["verdict"],
        float(content["cycle"]), float(content["lag"]), str(content.get("mechanics", "")),
    )


def checksum(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the contents without the checksum, as sorted JSON."""
    plain = {name: value for name, value in content.items() if name != "checksum"}
    text = json.dumps(plain, sort_keys=True, ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()
