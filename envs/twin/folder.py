"""Writing a twin: ``twin.json`` with a checksum; the same log gives the same bytes."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..engine import parameters
from ..plants.twins import FILE, SCHEMA, checksum
from .candidates import LAG
from .families import GAINS
from .fit import Fitted
from .words import ALWAYS, doubts, verdict

COMMISSIONED = (*GAINS, "velocity_filter_time", "velocity_feed_forward",
                "acceleration_feed_forward", "backlash")
DIGITS = 6  # of what is written


def content(
    fitted: Fitted, drive: str, logs: Sequence[Path] = (), tried: Sequence[Fitted] = ()
) -> dict[str, Any]:
    """Return the content of ``twin.json``."""
    assert fitted.candidates is not None
    joint = fitted.candidates.joint
    free = {each.name for each in fitted.estimate.free}
    rows: dict[str, Any] = {}
    for name, value in fitted.values.items():
        if name == LAG:
            continue
        low, high = value, value
        if name in free and fitted.complete and not fitted.increment:
            low, high = fitted.estimate.interval(name)
        rows[name] = _row(value, low, high, parameters.unit(joint, name))
    for name in COMMISSIONED:  # values of the drive that the fit assumed
        if name not in rows and parameters.PARAMETERS[name].there(joint):
            value = parameters.PARAMETERS[name].get(joint)
            rows[name] = _row(value, value, value, parameters.unit(joint, name))
    noise = fitted.noise
    rows["encoder_noise"] = _row(noise, noise, noise, parameters.unit(joint, "encoder_noise"))
    experiment = fitted.whole[0]
    held, inside = fitted.shares(), fitted.shares(held=False)
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "drive": drive,
        "mechanics": fitted.family.name,
        "machine": {
            "builder": fitted.family.builder,
            "arguments": {**fitted.family.arguments, **fitted.family.built},
            "axis": fitted.family.axis,
        },
        "parameters": rows,
        "objects": {**fitted.family.objects, **experiment.objects},
        "held_out": {
            "position_rms": _short(fitted.held_position),
            "torque_rms": _short(fitted.held_torque),
            "fit": _short(100 * fitted.share),
            "floor": _short(fitted.floor_position),
            "floor_torque": _short(fitted.floor_torque),
            "following_error_left": _short(held["following_error"]),
            "torque_left": _short(held["torque"]),
            "fitted_position_rms": _short(inside["position_rms"]),
            "fitted_ratio": _short(fitted.fitted_ratio),
            "increment": _short(fitted.increment),
        },
        "verdict": fitted.verdict,
        "said": verdict(fitted),
        "doubts": [*doubts(fitted), ALWAYS] if fitted.complete else [ALWAYS],
        "notes": [note for each in fitted.whole for note in each.notes],
        "cycle": experiment.period,
        "lag": _short(fitted.values.get(LAG, 0.0)),
        "logs": [{"name": log.name, "sha256": _digest(log)} for log in logs],
        "tried": {
            each.family.name: {"position_rms": _short(each.held_position),
                               "ratio": _short(each.misfit), "verdict": each.verdict}
            for each in tried
        },
    }
    found["checksum"] = checksum(json.loads(json.dumps(found)))
    return found


def _row(value: float, low: float, high: float, unit: str) -> Mapping[str, Any]:
    return {"value": _short(value), "low": _short(low), "high": _short(high), "unit": unit}


def _short(value: float) -> float:
    return float(f"{float(value):.{DIGITS}g}")


def _digest(log: Path) -> str:
    return hashlib.sha256(log.read_bytes()).hexdigest()


def save(
    folder: str | Path, fitted: Fitted, drive: str, logs: Sequence[Path] = (),
    tried: Sequence[Fitted] = (),
) -> Path:
    """Write ``twin.json`` into a folder, created if necessary, and return its path."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / FILE
    text = json.dumps(content(fitted, drive, logs, tried), indent=1, ensure_ascii=False)
    file.write_text(text + "\n", encoding="utf-8")
    return file
