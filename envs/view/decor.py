"""Decoration that makes a plant look like a machine, and shows its size in pictures.

Parts are boxes and cylinders at the bodies of the supplied plants, which are found by the name of
the model. They are not geoms of the model, which would cost time in every step of the physics. A
machine of the user only gets the scale on the floor.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import mujoco
import numpy as np

BOX, CYLINDER = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
STEEL, DARK, BELT = (0.60, 0.63, 0.67, 1.0), (0.16, 0.17, 0.19, 1.0), (0.08, 0.08, 0.09, 1.0)
INK, WHITE, SIGNAL = (0.07, 0.08, 0.10, 1.0), (0.93, 0.94, 0.96, 1.0), (0.85, 0.20, 0.16, 1.0)
SQUARE = 0.1  # m, of the floor's pattern
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class Part(NamedTuple):
    """A decorative shape that is drawn with a body."""

    body: int
    kind: int  # mjtGeom
    size: tuple[float, float, float]  # as of a geom (m)
    place: tuple[float, float, float]  # in the frame of the body (m)
    colour: tuple[float, float, float, float]
    turned: tuple[float, float, float, float] = UPRIGHT  # quaternion
    label: str = ""


def parts(model: mujoco.MjModel) -> list[Part]:
    """Return the decoration of a model by its name; nothing for an unknown one."""
    make = PLANTS.get(_name(model))
    return [*make(model)] if make else []


def _name(model: mujoco.MjModel) -> str:
    return model.names.partition(b"\0")[0].decode(errors="replace")


def _linear_axis(model: mujoco.MjModel) -> Iterator[Part]:
    """Guides, belt and a ruler on the rail, the flange of the motor, feet."""
    rail, half = model.geom("rail").pos, model.geom("rail").size
    x, top, front = float(rail[0]), float(rail[2] + half[2]), float(rail[1] - half[1])
    for side in (-1, 1):
        yield Part(0, BOX, (half[0] - 0.012, 0.004, 0.003), (x, 0.024 * side, top + 0.003), STEEL)
    yield Part(0, BOX, (half[0], 0.008, 0.0012), (x, 0.0, top + 0.0012), BELT)
    yield Part(0, CYLINDER, (0.022, 0.02, 0.0), (-0.115, -0.015, 0.035), STEEL,
               (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0))
    yield Part(0, BOX, (0.034, 0.004, 0.034), (-0.115, -0.033, 0.036), STEEL)
    for place in (x - half[0] + 0.04, x, x + half[0] - 0.04):
        yield Part(0, BOX, (0.02, 0.05, 0.005), (place, 0.0, 0.005), DARK)
    yield Part(0, BOX, (0.262, 0.0006, 0.012), (0.25, front - 0.0006, 0.036), WHITE)
    for number in range(51):  # a tick each 10 mm, where the middle of the carriage stands
        long = 0.009 if number % 10 == 0 else 0.006 if number % 5 == 0 else 0.0035
        yield Part(0, BOX, (0.0009 if number % 5 == 0 else 0.0005, 0.0006, long),
                   (0.01 * number, front - 0.0014, 0.047 - long), INK)
    for number in range(0, 501, 100):
        yield Part(0, BOX, (1e-4, 1e-4, 1e-4), (1e-3 * number, front - 0.002, 0.014), INK,
                   label=f"{number}")
    carriage = model.body("carriage").id
    yield Part(carriage, BOX, (0.0015, 0.0006, 0.013), (0.0, -0.0456, -0.003), SIGNAL)
    for corner in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        yield Part(carriage, CYLINDER, (0.004, 0.0015, 0.0),
                   (0.042 * corner[0], 0.037 * corner[1], 0.0145), STEEL)


def _rotary_axis(model: mujoco.MjModel) -> Iterator[Part]:
    """A graduation, slots and a hub on the table; gear, base plate and a pointer under it."""
    table, height = model.body("table").id, float(model.body("motor_side").pos[2])
    thick, radius = 0.015, 0.25
    yield Part(table, CYLINDER, (radius * 0.998, 0.0012, 0.0), (0.0, 0.0, thick), STEEL)
    yield Part(table, CYLINDER, (radius - 0.03, 0.0014, 0.0), (0.0, 0.0, thick + 0.0004),
               tuple(map(float, model.mat("table").rgba)))  # type: ignore[arg-type]
    yield Part(table, CYLINDER, (0.055, 0.006, 0.0), (0.0, 0.0, thick + 0.004), STEEL)
    yield Part(table, CYLINDER, (0.02, 0.007, 0.0), (0.0, 0.0, thick + 0.006), DARK)
    for degree in range(0, 360, 10):
        long = 0.013 if degree % 30 == 0 else 0.008
        angle = math.radians(degree)
        at = radius - 0.001 - long
        yield Part(
            table, BOX, (long, 0.0012 if degree % 30 == 0 else 0.0007, 0.0006),
            (at * math.cos(angle), at * math.sin(angle), thick + 0.0018), INK, _about_z(angle),
            f"{degree}" if degree % 90 == 0 else "",
        )
    for number in range(6):
        angle = math.radians(30 + 60 * number)
        place = (0.125 * math.cos(angle), 0.125 * math.sin(angle), thick + 0.0018)
        yield Part(table, BOX, (0.05, 0.005, 0.0006), place, INK, _about_z(angle))
    yield Part(0, CYLINDER, (0.1, 0.006, 0.0), (0.0, 0.0, height - thick - 0.006), STEEL)
    yield Part(0, BOX, (0.2, 0.2, 0.006), (0.0, 0.0, 0.006), STEEL)
    yield Part(0, BOX, (0.02, 0.006, height / 2 + 0.006), (radius + 0.03, 0.0, height / 2), DARK)
    yield Part(0, BOX, (0.016, 0.0025, 0.002), (radius + 0.016, 0.0, height + thick + 0.004),
               SIGNAL)


def _gantry(model: mujoco.MjModel) -> Iterator[Part]:
    """Posts and cross members under the rails, guides, belts, motors."""
    for name, side in (("rail_front", -1), ("rail_back", 1)):
        place, half = model.geom(name).pos, model.geom(name).size
        x, y, z = map(float, place)
        top, under = z + float(half[2]), z - float(half[2])
        for end in (-1, 1):
            yield Part(0, BOX, (0.025, 0.025, under / 2),
                       (x + end * (float(half[0]) - 0.03), y, under / 2), STEEL)
            yield Part(0, BOX, (0.05, 0.05, 0.006), (x + end * (float(half[0]) - 0.03), y, 0.006),
                       DARK)
        yield Part(0, BOX, (float(half[0]) - 0.01, 0.006, 0.004), (x, y, top + 0.002), DARK)
        yield Part(0, BOX, (0.03, 0.035, 0.03), (x - float(half[0]) - 0.03, y + 0.01 * side, z),
                   DARK)
        for number in range(9):  # a tick each 100 mm
            yield Part(0, BOX, (0.0015, 0.0008, 0.014),
                       (0.1 * number, y + side * (float(half[1]) + 0.0008), z + 0.012), INK,
                       label=f"{100 * number}" if side < 0 and number % 2 == 0 else "")
    bridge = model.body("bridge").id
    for beam in ("beam1", "beam2"):
        x = float(model.geom(beam).pos[0])
        yield Part(bridge, BOX, (0.006, 0.34, 0.003), (x, 0.25, 0.032), DARK)
    for y in (-0.12, 0.62):
        yield Part(bridge, BOX, (0.09, 0.012, 0.034), (0.0, y, 0.0), DARK)
    slide = model.body("slide").id
    yield Part(slide, BOX, (0.03, 0.022, 0.03), (-0.02, 0.0, 0.09), DARK)
    gripper = model.body("gripper").id
    yield Part(gripper, BOX, (0.004, 0.021, 0.24), (0.0, 0.0, 0.05), DARK)
    yield Part(gripper, BOX, (0.034, 0.034, 0.006), (0.0, 0.0, -0.196), DARK)


PLANTS: dict[str, Callable[[mujoco.MjModel], Iterator[Part]]] = {
    "linear axis": _linear_axis, "rotary axis": _rotary_axis, "gantry": _gantry,
}


def scale(low: np.ndarray, high: np.ndarray, floor: float) -> list[Part]:
    """Return a scale with steps of 0.1 m on the floor, in front of a machine in this box (m)."""
    steps = int(np.clip((high[0] - low[0]) // SQUARE, 2, 5))
    begin = SQUARE * math.floor(float(low[0]) / SQUARE + 1.0)
    y = float(low[1]) - 0.06
    rows = []
    for number in range(steps):
        rows.append(
            Part(0, BOX, (SQUARE / 2, 0.008, 0.0015),
                 (begin + SQUARE * (number + 0.5), y, floor + 0.0015), (INK, WHITE)[number % 2])
        )
    end = (begin + SQUARE * (steps + 0.4), y, floor + 1e-3)
    rows.append(Part(0, BOX, (1e-4, 1e-4, 1e-4), end, INK, label=f"{steps * SQUARE:.1f} m"))
    return rows


def _about_z(angle: float) -> tuple[float, float, float, float]:
    return math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)
