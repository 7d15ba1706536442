"""Records pictures to MP4, to GIF, or as PNGs into a folder; the suffix chooses."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from PIL import Image

from ...envs.view.overlay import STATE_COLOUR

NO_DITHER = Image.Dither.NONE  # that of Pillow would flicker
# Bayer's matrix prevents bands of colour where the brightness changes slowly
RASTER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 2.0 - 3.75


class Writer(Protocol):
    """Receives the frames of a recording."""

    def add(self, image: np.ndarray) -> None:
        """Append an image, shape ``(height, width, 3)`` uint8."""

    def close(self) -> None:
        """Finish the file."""


VIVID, PLACES = 48, 96  # least difference of the primaries; places in a palette for such colours


class Gif:
    """An animated GIF; a frame lasts a multiple of 10 ms, as the format requires."""

    def __init__(self, path: Path, fps: float):
        self._path, self._duration = path, max(round(100 / fps), 2) * 10
        self._frames: list[Image.Image] = []
        self._palette: Image.Image | None = None

    def add(self, image: np.ndarray) -> None:
        """Keep the image in the 256 colours of the first one, with a raster that stands still."""
        if self._palette is None:
            self._palette = _palette(image)
        height, width = image.shape[:2]
        raster = np.tile(RASTER, (-(-height // 4), -(-width // 4)))[:height, :width, None]
        rastered = np.clip(image + raster, 0, 255).astype(np.uint8)
        frame = Image.fromarray(rastered).quantize(palette=self._palette, dither=NO_DITHER)
        self._frames.append(frame)

    def close(self) -> None:
        """Write the file."""
        if self._frames:
            first, *others = self._frames
            first.save(
                self._path, save_all=True, append_images=others, duration=self._duration, loop=0
            )


def _palette(image: np.ndarray) -> Image.Image:
    """256 colours: of the whole image, of its vivid parts, however small, and of the states."""
    pixels = image.reshape(-1, 3)
    vivid = pixels[np.ptp(pixels, axis=1) > VIVID]
    colours = _colours(pixels, 256 - PLACES - len(STATE_COLOUR)) + _colours(vivid, PLACES)
    colours += [value for text in STATE_COLOUR.values() for value in bytes.fromhex(text[1:])]
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours)
    return palette


def _colours(pixels: np.ndarray, most: int) -> list[int]:
    """Red, green and blue of the colours to which pixels are reduced."""
    if not len(pixels):
        return []
    strip = Image.fromarray(np.ascontiguousarray(pixels[None])).quantize(most)
    return list(strip.getpalette() or [])[: 3 * most]


class Mp4:
    """H.264 by the ffmpeg that `imageio-ffmpeg` brings or finds."""

    def __init__(self, path: Path, fps: float):
        try:
            import imageio_ffmpeg
        except ImportError:
            raise ImportError(
                f"{path}: MP4 needs an encoder, pip install 'servogym[video]', or record a .gif"
            ) from None
        self._path = path
        self._open: Callable[[int, int], Any] = lambda width, height: imageio_ffmpeg.write_frames(
            str(path), (width, height), fps=fps, macro_block_size=2, ffmpeg_log_level="error"
        )
        self._pipe: Any = None

    def add(self, image: np.ndarray) -> None:
        """Encode the image."""
        if self._pipe is None:
            self._pipe = self._open(image.shape[1], image.shape[0])
            self._pipe.send(None)
        try:
            self._pipe.send(np.ascontiguousarray(image))
        except OSError:  # ffmpeg has said why, on stderr
            raise OSError(f"{self._path}: the encoder has stopped, see above") from None

    def close(self) -> None:
        """Finish the file."""
        if self._pipe is not None:
            self._pipe.close()


class Folder:
    """PNGs, numbered from 00000.png on."""

    def __init__(self, path: Path, fps: float):
        if path.exists() and not path.is_dir():
            raise ValueError(f"--record {path}: this is a file, name a folder, .gif or .mp4")
        path.mkdir(parents=True, exist_ok=True)
        self._path, self._count = path, 0

    def add(self, image: np.ndarray) -> None:
        """Write the next file."""
        Image.fromarray(image).save(self._path / f"{self._count:05d}.png")
        self._count += 1

    def close(self) -> None:
        """Do nothing: every file is complete."""


WRITERS: dict[str, Callable[[Path, float], Writer]] = {".gif": Gif, ".mp4": Mp4, "": Folder}


def recording(path: Path, fps: float) -> Writer:
    """Start a recording.

    Args:
        path: .gif, .mp4, or a folder.
        fps: images per second.

    Raises:
        ValueError: another suffix.
        ImportError: MP4 without an encoder.
    """
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise ValueError(f"--record {path}: use .mp4, .gif, or a folder for single images")
    if suffix:
        path.parent.mkdir(parents=True, exist_ok=True)
    return WRITERS[suffix](path, fps)
