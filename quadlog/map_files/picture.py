"""How bright each pixel of a map's picture is: PGM, PNG or BMP, which is what map_server saves."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import QuadlogError, TooLarge, UnreadableFile

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

_MAX_PIXELS = 1 << 26  # 8192 x 8192


@dataclass(frozen=True, slots=True)
class Picture:
    """Brightness, the top row first.

    sums (rows, cols) uint8 or uint16: the pixel's colour channels added up, without alpha.
    white: the sum of a white pixel; 0 is black.
    opaque (rows, cols) bool; None for a picture without transparency.
    """

    sums: NDArray[np.uint8] | NDArray[np.uint16]
    white: int
    opaque: NDArray[np.bool_] | None


def read_picture(path: Path) -> Picture:
    """Decode 8 bits per channel (or fewer), grey, coloured or with a palette.

    Raises UnreadableFile when there is no such file or it is damaged or of
    another kind; TooLarge, before decoding, for more than 2^26 pixels.
    """
    try:
        # The path comes from another file: a pipe or a device there would be waited for.
        if not stat.S_ISREG(path.stat().st_mode):
            raise UnreadableFile(path, "is no regular file")
        with path.open("rb") as file:
            return _decode(path, file)
    except QuadlogError:
        raise
    except OSError as error:
        raise UnreadableFile(path, error.strerror or f"is damaged: {error}") from error
    except Exception as error:  # Pillow's decoders have no class of their own for damage
        raise UnreadableFile(path, f"is damaged: {type(error).__name__} {error}") from error


def _decode(path: Path, file: BinaryIO) -> Picture:
    image = _reader(path, file)
    cols, rows = image.size
    if cols * rows > _MAX_PIXELS:
        raise TooLarge(f"{path}: pixels", cols * rows, _MAX_PIXELS)
    if image.mode not in {"1", "L", "LA", "P", "RGB", "RGBA"}:
        raise UnreadableFile(path, "has more than 8 bits per channel")
    if image.mode in {"LA", "RGBA"} or "transparency" in image.info:
        pixels = np.asarray(image.convert("RGBA"))
        return Picture(pixels[..., :3].sum(axis=2, dtype=np.uint16), 3 * 255, pixels[..., 3] == 255)
    if image.mode in {"1", "L"}:
        return Picture(np.asarray(image.convert("L")), 255, None)
    return Picture(np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16), 3 * 255, None)


def _reader(path: Path, file: BinaryIO) -> ImageFile:
    """The header, read by the one decoder that the first bytes name: none of Pillow's others gets to see the file."""
    from PIL import BmpImagePlugin, PngImagePlugin, PpmImagePlugin  # only pictures need it

    decoders: dict[bytes, type[ImageFile]] = {
        b"P2": PpmImagePlugin.PpmImageFile,
        b"P5": PpmImagePlugin.PpmImageFile,
        b"\x89PNG\r\n\x1a\n": PngImagePlugin.PngImageFile,
        b"BM": BmpImagePlugin.BmpImageFile,
    }
    first = file.read(8)
    file.seek(0)
    for magic, decoder in decoders.items():
        if first.startswith(magic):
            return decoder(file)
    raise UnreadableFile(path, "is no PGM, PNG or BMP picture")
