"""Text panels of a picture: a line for each drive, and the distance to the goal.

A line shows state and mode by name, the following error within its window 6065h, and the active
internal limit; the fault of a drive is shown above the lines. The bar of the following error has a
square-root scale, so that a small error is visible in a wide window: ticks at 1 %, 10 % and at the
window.
"""

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ...drive.drive import Drive
from ...drive.kernel.words import Limit, State
from ..engine.machine import Machine

STATE_COLOUR = {
    State.NOT_READY_TO_SWITCH_ON: "#8c8c8c",
    State.SWITCH_ON_DISABLED: "#cfcfcf",
    State.READY_TO_SWITCH_ON: "#c6dbef",
    State.SWITCHED_ON: "#7fb2dd",
    State.OPERATION_ENABLED: "#8fd19e",
    State.QUICK_STOP_ACTIVE: "#fdae61",
    State.FAULT_REACTION_ACTIVE: "#f4827a",
    State.FAULT: "#d62728",
}
LIMIT_NAME = {
    Limit.TORQUE: "torque",
    Limit.SPEED: "speed",
    Limit.SOFTWARE_POSITION_MIN: "software min",
    Limit.SOFTWARE_POSITION_MAX: "software max",
    Limit.NEGATIVE_LIMIT_SWITCH: "switch −",
    Limit.POSITIVE_LIMIT_SWITCH: "switch +",
    Limit.I2T: "I²t",
    Limit.VELOCITY_AMOUNT: "velocity amount",
    Limit.VOLTAGE: "voltage",
}
PANEL, TRACK, WINDOW = "#14181e", "#2b313a", "#3c4a5c"
TEXT, DIM, INSIDE, OUTSIDE, LIMITED = "#f2f4f7", "#a9b1bb", "#6fc3df", "#ff5a4f", "#ffb454"
OPACITY = 205  # of the panels, of 255
HEAD, TITLES, ROW = 32, 22, 28  # heights (px)
NAME, STATE, MODE, BAR, ERROR, LIMIT = 12, 80, 272, 438, 594, 776  # left edges (px)
BAR_WIDTH = 146  # px
INSET, FRAME = 190, 28  # of the view from above (px)
SHARE = 0.86  # share of half the bar that is the window
TICKS = (0.01, 0.1)  # of the window


class Line(NamedTuple):
    """The data of a drive that a picture shows."""

    name: str
    state: State
    mode: str
    error: float  # following error (mm or mrad)
    window: float  # 6065h (mm or mrad), inf: off
    unit: str
    limits: str  # active limits, empty without one
    fault: str  # code and meaning, empty without one

    @property
    def numbers(self) -> str:
        """Following error and its window with unit, as a text."""
        window = f"±{self.window:g}" if math.isfinite(self.window) else "off"
        return f"{self.error:+.3f} / {window} {self.unit}".replace("-", "−")


def lines(machine: Machine) -> list[Line]:
    """Return a line for each drive, with the values of the last position cycle."""
    return [
        _line(machine, i, name, drive) for i, (name, drive) in enumerate(machine.drives.items())
    ]


def _line(machine: Machine, i: int, name: str, drive: Drive) -> Line:
    coupling, axis, model = machine.couplings[i], drive.axis, machine.model
    joint = model.dof_jntid[coupling.dof]
    sliding = model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    scale = 1e3 / float(coupling.gear)  # mm or mrad per rad of the motor shaft
    active = int(axis.od.active_limits)
    mode = drive.mode
    return Line(
        name, drive.state, mode.name.lower().replace("_", " ") if mode else "no mode",
        float(axis.following_error) * scale,
        float(f"{float(axis.following_error_window) * abs(scale):.4g}"),
        "mm" if sliding else "mrad",
        ", ".join(text for limit, text in LIMIT_NAME.items() if active & limit), drive.fault,
    )


class Overlay:
    """Draws the panels into images of one size: a head above, a line for each drive below.

    Args:
        drives: names of the drives.
        width: of the images (px).
    """

    def __init__(self, drives: list[str], width: int):
        self._width = width
        self._head = Image.new("RGB", (width, HEAD), PANEL)
        self._foot = Image.new("RGB", (width, TITLES + ROW * len(drives) + 6), PANEL)
        draw = ImageDraw.Draw(self._foot)
        for x, title in (
            (NAME, "drive"), (STATE, "state"), (MODE, "mode"),
            (BAR, "following error (root scale) / window"), (LIMIT, "active limit"),
        ):
            draw.text((x, 13), title, DIM, _font(13), "lm")
        for i, name in enumerate(drives):
            y = TITLES + ROW * i
            room = STATE - NAME - 8
            fits = (size for size in (16, 14, 12) if _font(size, True).getlength(name) <= room)
            _write(draw, (NAME, y + 14), name, room, TEXT, _font(next(fits, 12), True))
            draw.rectangle((BAR, y + 6, BAR + BAR_WIDTH, y + 22), TRACK)
            draw.rectangle((_place(-1.0), y + 6, _place(1.0), y + 22), WINDOW)
            for tick in TICKS:
                for side in (-tick, tick):
                    draw.line((_place(side), y + 18, _place(side), y + 22), DIM)

    @property
    def heights(self) -> tuple[int, int]:
        """Heights of the panels above and below (px)."""
        return HEAD, self._foot.height

    def draw(
        self, image: np.ndarray, machine: list[Line], title: str, goal: str, right: str
    ) -> None:
        """Draw into `image`, shape ``(height, width, 3)`` uint8."""
        draw, strip = self._open(image[:HEAD], self._head)
        middle, bold, plain = HEAD // 2, _font(16, True), _font(16)
        draw.text((NAME, middle), title, TEXT, bold, "lm")
        begin = NAME + round(bold.getlength(title)) + 24
        end = self._width - 12 - round(plain.getlength(right))
        _write(draw, (begin, middle), goal, end - 24 - begin, TEXT, plain)
        draw.text((end, middle), right, TEXT, plain, "lm")
        image[:HEAD] = strip
        foot = image[len(image) - self._foot.height :]
        draw, strip = self._open(foot, self._foot)
        for i, line in enumerate(machine):
            self._line(draw, TITLES + ROW * i, line)
        foot[:] = strip
        faults = [f"FAULT {line.name}: {line.fault}" for line in machine if line.fault]
        for i, fault in enumerate(faults):
            self._banner(image[HEAD + ROW * i : HEAD + ROW * (i + 1)], fault)

    def inset(self, image: np.ndarray, wanted: np.ndarray, tracks: list[np.ndarray]) -> None:
        """Draw a contour from above into the upper right corner, with X to the right.

        Args:
            image: the image, shape ``(height, width, 3)`` uint8.
            wanted: the contour, ``(n, 2)`` (m).
            tracks: the paths travelled, each ``(m, 2)`` (m).
        """
        left, top = self._width - INSET - 12, HEAD + 12
        pixels = image[top : top + INSET, left : left + INSET]
        draw, strip = self._open(pixels, Image.new("RGB", (INSET, INSET), PANEL))
        low, high = wanted.min(axis=0), wanted.max(axis=0)
        room = INSET - 2 * FRAME
        zoom = room / max(float((high - low).max()), 1e-6)  # px/m

        def pixels_of(places: np.ndarray) -> list[tuple[float, float]]:
            x, y = ((places - (low + high) / 2) * zoom).T
            return list(zip(INSET / 2 + x, INSET / 2 - 6 - y, strict=True))

        draw.line(pixels_of(wanted), DIM, 4, "curve")
        for track in tracks:
            if len(track) > 1:
                draw.line(pixels_of(track), OUTSIDE, 2, "curve")
            if len(track):
                ((x, y),) = pixels_of(track[-1:])
                draw.ellipse((x - 4, y - 4, x + 4, y + 4), TEXT)
        step = 10.0 ** math.floor(math.log10(room / zoom / 2))  # m
        end = float(FRAME + step * zoom)
        draw.line([(FRAME, INSET - 12), (end, INSET - 12)], TEXT, 2)
        draw.text((end + 6, INSET - 12), f"{1e3 * step:g} mm", TEXT, _font(13), "lm")
        pixels[:] = strip

    def _open(
        self, pixels: np.ndarray, panel: Image.Image
    ) -> tuple[ImageDraw.ImageDraw, Image.Image]:
        """Blend a panel over the pixels; -> an object to draw with, and the result."""
        strip = Image.blend(Image.fromarray(pixels), panel, OPACITY / 255)
        return ImageDraw.Draw(strip), strip

    def _line(self, draw: ImageDraw.ImageDraw, y: int, line: Line) -> None:
        middle = y + 14
        draw.rounded_rectangle((STATE, y + 4, MODE - 10, y + 24), 5, STATE_COLOUR[line.state])
        draw.text(((STATE + MODE - 10) // 2, middle), line.state.name.lower().replace("_", " "),
                  "white" if line.state == State.FAULT else "black", _font(15), "mm")
        draw.text((MODE, middle), line.mode, TEXT, _font(15), "lm")
        inside = abs(line.error) <= line.window
        share = line.error / line.window if line.window else line.error * math.inf
        zero, end = _place(0.0), _place(share if line.error else 0.0)
        draw.rectangle(
            (min(zero, end), y + 9, max(zero, end), y + 17), INSIDE if inside else OUTSIDE
        )
        draw.line((zero, y + 6, zero, y + 22), TEXT)
        colour = TEXT if inside else OUTSIDE
        _write(draw, (ERROR, middle), line.numbers, LIMIT - ERROR - 8, colour, _font(15))
        width, colour = self._width - LIMIT - 8, LIMITED if line.limits else DIM
        _write(draw, (LIMIT, middle), line.limits or "none", width, colour, _font(15))

    def _banner(self, pixels: np.ndarray, text: str) -> None:
        strip = Image.new("RGB", (self._width, len(pixels)), STATE_COLOUR[State.FAULT])
        place = NAME, ROW // 2
        _write(ImageDraw.Draw(strip), place, text, self._width - 24, "white", _font(16, True))
        pixels[:] = strip


def _place(share: float) -> int:
    """Place in the bar (px) of a following error, given as a share of the window."""
    root = math.copysign(math.sqrt(abs(share)) * SHARE, share)
    return BAR + round(BAR_WIDTH / 2 * (1 + min(max(root, -1.0), 1.0)))


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Return DejaVu Sans of matplotlib, which is the same everywhere and has ±, − and ²."""
    import matplotlib  # only when it is needed, because it takes a while

    file = f"fonts/ttf/DejaVuSans{'-Bold' * bold}.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / file, size)


def _write(
    draw: ImageDraw.ImageDraw, place: tuple[int, int], text: str, width: int, colour: str,
    font: ImageFont.FreeTypeFont,
) -> None:
    """Write text from `place` (left, middle), shortened to `width` (px) with an ellipsis."""
    if font.getlength(text) > width:
        while text and font.getlength(text + "…") > width:
            text = text[:-1]
        text += "…"
    draw.text(place, text, colour, font, "lm")
