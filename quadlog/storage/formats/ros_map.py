"""A map as ROS map_server has it: a `.yaml` that says where it lies, and the picture it names; read and written."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, Field, model_validator

from quadlog.errors import QuadlogError, TooLarge, UnreadableFile
from quadlog.messages import Float
from quadlog.storage.atomic_write import write_whole
from quadlog.storage.plain_yaml import NotPlainYaml, read_model

_MAX_PIXELS = 1 << 26  # 8192 x 8192
_WHITE = 3 * 255


def read_picture(path: Path) -> tuple[NDArray[np.uint16], NDArray[np.bool_] | None]:
    """Brightness (rows, cols) as red + green + blue, the top row first, and which pixels are opaque (None: all).

    8 bits per channel or fewer, grey, coloured or with a palette. Raises UnreadableFile when there is no such file or
    it is damaged or of another kind; TooLarge, before decoding, for more than 2^26 pixels.
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


def _decode(path: Path, file: BinaryIO) -> tuple[NDArray[np.uint16], NDArray[np.bool_] | None]:
    from PIL import BmpImagePlugin, PngImagePlugin, PpmImagePlugin  # only pictures need it

    # No more of Pillow's decoders get to see the file, and none to warn of its size.
    pgm, bmp, png = PpmImagePlugin.PpmImageFile, BmpImagePlugin.BmpImageFile, PngImagePlugin.PngImageFile
    decoders: dict[bytes, Any] = {b"P2": pgm, b"P5": pgm, b"BM": bmp, b"\x89P": png}
    decoder = decoders.get(file.read(2))
    if decoder is None:
        raise UnreadableFile(path, "is no PGM, PNG or BMP picture")
    file.seek(0)
    image = decoder(file)
    cols, rows = image.size
    if cols * rows > _MAX_PIXELS:
        raise TooLarge(f"{path}: pixels", cols * rows, _MAX_PIXELS)
    if image.mode not in {"1", "L", "LA", "P", "RGB", "RGBA"}:
        raise UnreadableFile(path, "has more than 8 bits per channel")
    has_alpha = image.mode in {"LA", "RGBA"} or "transparency" in image.info
    pixels = np.asarray(image.convert("RGBA" if has_alpha else "RGB"))
    return pixels[..., :3].sum(axis=2, dtype=np.uint16), pixels[..., 3] == 255 if has_alpha else None


_UNKNOWN, _FREE, _OCCUPIED = -1, 0, 100  # nav_msgs/OccupancyGrid
_MAX_YAML_BYTES = 1 << 16
# A kilometre to a cell and a millimetre are beyond any map that a robot plans on.
_CellSize = Annotated[float, Field(ge=1e-3, le=1e3)]
_Share = Annotated[float, Field(ge=0, le=1)]
_Metres = Annotated[float, Field(ge=-1e9, le=1e9)]


@dataclass(frozen=True, slots=True)
class RosMap:
    """An occupancy map in the frame map; row = y upwards, column = x.

    cells (rows, columns) int8: -1 unknown, 0 free, 100 occupied, in modes scale
    and raw also the values between; origin_m (2,) is the lower-left corner.
    """

    cells: NDArray[np.int8]
    origin_m: Float
    cell_m: float

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """(rows, columns): only what is certainly occupied (100) blocks.

        Unknown cells and values below 100 do not, as in nav2 unless set
        otherwise: its static layer has lethal_cost_threshold 100 and
        trinary_costmap, its planners allow_unknown.
        """
        return self.cells == _OCCUPIED


class _About(BaseModel):
    """What the yaml file says."""

    image: Annotated[str, Field(min_length=1)]
    resolution: _CellSize
    origin: tuple[_Metres, _Metres, float]
    occupied_thresh: _Share
    free_thresh: _Share
    mode: Annotated[Literal["raw", "scale", "trinary"], BeforeValidator(lambda mode: str(mode).lower())] = "trinary"
    negate: bool = False

    @model_validator(mode="after")
    def _readable(self) -> _About:
        if self.origin[2] != 0:
            raise ValueError(f"the map is rotated by {self.origin[2]:g} rad, which quadlog does not read")
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("thresholds are not 0 <= free_thresh <= occupied_thresh <= 1")
        return self


def read_rosmap(path: Path) -> RosMap:
    """The map that the map_server file `path` describes, from a PGM, PNG or BMP of 8 bits per channel.

    A pixel's colours are averaged to a shade from 0 (black) to 1; its
    occupancy is 1 - shade, or the shade with `negate`. Then, by `mode`, as
    nav2's map_server does:

    trinary: 100 above `occupied_thresh`, 0 below `free_thresh`, else unknown.
    scale: the same, and between the thresholds from 0 to 100 in proportion.
    raw: the shade times 255 is the value, unknown above 100; `negate` has no say.

    A pixel that is not quite opaque is unknown, but in raw mode. (Map servers
    before that rule averaged alpha in as a colour in trinary mode.)

    Raises UnreadableFile when either file is missing, damaged or of another
    kind (a rotated origin included), TooLarge for more cells than memory should hold.
    """
    try:
        about = read_model(path, _About, _MAX_YAML_BYTES)
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error)) from error
    except NotPlainYaml as error:
        raise UnreadableFile(path, f"no map_server file: {error.reason}", error.line) from error
    sums, opaque = read_picture(path.parent / about.image)
    cells = _occupancy_of_sums(about)[sums]
    if opaque is not None and about.mode != "raw":
        cells[~opaque] = _UNKNOWN
    # A picture's first row is the top one.
    return RosMap(np.ascontiguousarray(cells[::-1]), np.array(about.origin[:2]), about.resolution)


def _occupancy_of_sums(about: _About) -> NDArray[np.int8]:
    """The cell's value for each sum of colours that a pixel can have, 0 to 765."""
    sums = np.arange(_WHITE + 1)
    table = np.full(len(sums), _UNKNOWN, np.int8)
    if about.mode == "raw":
        values = np.rint(sums / 3)
        table[values <= _OCCUPIED] = values[values <= _OCCUPIED]
        return table
    occupancy = (sums if about.negate else _WHITE - sums) / _WHITE
    if about.mode == "scale" and about.occupied_thresh > about.free_thresh:
        share = (occupancy - about.free_thresh) / (about.occupied_thresh - about.free_thresh)
        table[:] = np.rint(100 * share.clip(0, 1))
    table[occupancy < about.free_thresh] = _FREE
    table[occupancy > about.occupied_thresh] = _OCCUPIED
    return table


# map_server's own: occupied black, free almost white, unknown a grey just outside both thresholds.
_GREY = {100: 0, 0: 254, -1: 205}
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196


def write_rosmap(folder: Path, cells: NDArray[np.int8], origin_m: Float, cell_m: float) -> None:
    """`map.pgm` and, once that is whole, `map.yaml` in `folder`. Raises CannotWrite.

    cells (rows, columns) int8, row = y upwards, column = x: -1 unknown, 0 free,
    100 occupied; origin_m (2,) is the lower-left corner in the frame map.
    """
    grey = np.zeros(cells.shape, np.uint8)
    for value, shade in _GREY.items():
        grey[cells == value] = shade
    if not np.isin(cells, list(_GREY)).all():
        raise ValueError("cells are -1, 0 or 100")
    rows, columns = cells.shape
    # A picture's first row is the top one.
    write_whole(folder / "map.pgm", f"P5\n{columns} {rows}\n255\n".encode() + grey[::-1].tobytes())
    lines = (
        "image: map.pgm",
        "mode: trinary",
        f"resolution: {float(cell_m)!r}",
        f"origin: [{float(origin_m[0])!r}, {float(origin_m[1])!r}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {_OCCUPIED_ABOVE}",
        f"free_thresh: {_FREE_BELOW}",
    )
    write_whole(folder / "map.yaml", ("\n".join(lines) + "\n").encode())
