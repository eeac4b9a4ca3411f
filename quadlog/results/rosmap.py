"""A map as ROS map_server reads it: `map.pgm` (grey values) and `map.yaml` (where it lies)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import TooLarge, UnreadableFile
from quadlog.messages import Float
from quadlog.results.files import write_whole

# map_server's own: occupied black, free almost white, unknown a grey just outside both thresholds.
_GREY = {100: 0, 0: 254, -1: 205}
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196
_MAX_CELLS = 1 << 28
_MAX_YAML_BYTES = 1 << 16


@dataclass(frozen=True, slots=True)
class RosMap:
    """An occupancy map in the frame map; row = y upwards, column = x.

    cells (rows, columns) int8: -1 unknown, 0 free, 100 occupied; origin_m (2,) is the lower-left corner.
    """

    cells: NDArray[np.int8]
    origin_m: Float
    cell_m: float


def write_rosmap(folder: Path, cells: NDArray[np.int8], origin_m: Float, cell_m: float) -> None:
    """`map.pgm` and, once that is whole, `map.yaml` in `folder`; arguments as in RosMap. Raises CannotWrite."""
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


def read_rosmap(path: Path) -> RosMap:
    """The map that the map_server file `path` describes, in trinary mode, from an 8-bit binary PGM.

    Raises UnreadableFile when either file is missing, damaged or of another
    kind (a rotated origin included), TooLarge for more cells than memory should hold.
    """
    about = _read_yaml(path)
    try:
        image = path.parent / str(about["image"])
        cell_m = float(about["resolution"])
        x_m, y_m, yaw_rad = (float(value) for value in about["origin"])
        occupied_above, free_below = float(about["occupied_thresh"]), float(about["free_thresh"])
        negate = bool(about.get("negate", 0))
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableFile(path, f"no map_server file: {type(error).__name__} {error}") from error
    if str(about.get("mode", "trinary")) != "trinary":
        raise UnreadableFile(path, f"mode is {about['mode']}, and quadlog reads trinary")
    if not all(map(math.isfinite, (x_m, y_m, cell_m))) or cell_m <= 0 or yaw_rad != 0:
        raise UnreadableFile(path, "resolution or origin is impossible, or the map is rotated")
    grey = _read_pgm(image)[::-1]
    darkness = (grey if negate else 255 - grey) / 255.0
    cells = np.full(grey.shape, -1, np.int8)
    cells[darkness < free_below] = 0
    cells[darkness > occupied_above] = 100
    return RosMap(cells, np.array([x_m, y_m]), cell_m)


def _read_yaml(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML  # only maps need it
    from ruamel.yaml.error import YAMLError

    try:
        with path.open("rb") as file:
            content = file.read(_MAX_YAML_BYTES + 1)
        if len(content) > _MAX_YAML_BYTES:
            raise UnreadableFile(path, "is too long for a map_server file")
        about = YAML(typ="safe", pure=True).load(content)
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error)) from error
    except (YAMLError, ValueError, RecursionError) as error:
        raise UnreadableFile(path, f"is no YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(about, dict):
        raise UnreadableFile(path, "is no map_server file")
    return about


def _read_pgm(path: Path) -> NDArray[np.uint8]:
    """(rows, columns) grey values, the top row first."""
    try:
        with path.open("rb") as file:
            head = file.read(4096)
            # Comments may stand between the numbers, and one white space ends the header.
            match = re.match(rb"P5(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+255\s", head)
            if match is None:
                raise UnreadableFile(path, "is no binary PGM with 255 as its white")
            columns, rows = int(match[1]), int(match[2])
            if rows * columns > _MAX_CELLS:
                raise TooLarge(f"{path}: cells", rows * columns, _MAX_CELLS)
            file.seek(match.end())
            body = file.read(rows * columns)
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error)) from error
    if len(body) != rows * columns or not body:
        raise UnreadableFile(path, f"holds {len(body)} of {rows * columns} cells")
    return np.frombuffer(body, np.uint8).reshape(rows, columns)
