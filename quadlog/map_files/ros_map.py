"""A map as ROS map_server reads it: a `.yaml` that says where the map lies, and the picture it names."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import UnreadableFile
from quadlog.map_files.picture import Picture, read_picture
from quadlog.messages import Float

_UNKNOWN, _FREE, _OCCUPIED = -1, 0, 100  # nav_msgs/OccupancyGrid
_MODES = ("raw", "scale", "trinary")
_MAX_YAML_BYTES = 1 << 16


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

        Unknown cells and values below 100 do not, as in nav2 unless told
        otherwise: its static layer has lethal_cost_threshold 100 and
        trinary_costmap, its planners allow_unknown.
        """
        return self.cells == _OCCUPIED


@dataclass(frozen=True, slots=True)
class _About:
    """What the yaml file says."""

    picture: Path
    origin_m: tuple[float, float]
    cell_m: float
    mode: str
    negate: bool
    occupied_above: float
    free_below: float


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
    about = _about(path)
    picture = read_picture(about.picture)
    cells = _occupancy_of_sums(about, picture)[picture.sums]
    if picture.opaque is not None and about.mode != "raw":
        cells[~picture.opaque] = _UNKNOWN
    # A picture's first row is the top one.
    return RosMap(np.ascontiguousarray(cells[::-1]), np.array(about.origin_m), about.cell_m)


def _occupancy_of_sums(about: _About, picture: Picture) -> NDArray[np.int8]:
    """The cell's value for each sum of colours that a pixel can have, 0 to white."""
    sums = np.arange(picture.white + 1)
    table = np.full(len(sums), _UNKNOWN, np.int8)
    if about.mode == "raw":
        values = np.rint(sums * 255 / picture.white)
        table[values <= _OCCUPIED] = values[values <= _OCCUPIED]
        return table
    occupancy = (sums if about.negate else picture.white - sums) / picture.white
    if about.mode == "scale" and about.occupied_above > about.free_below:
        share = (occupancy - about.free_below) / (about.occupied_above - about.free_below)
        table[:] = np.rint(100 * share.clip(0, 1))
    table[occupancy < about.free_below] = _FREE
    table[occupancy > about.occupied_above] = _OCCUPIED
    return table


def _about(path: Path) -> _About:
    content = _read_yaml(path)
    try:
        name, mode = content["image"], content.get("mode", "trinary")
        x_m, y_m, yaw_rad = (float(value) for value in content["origin"])
        cell_m = float(content["resolution"])
        occupied_above, free_below = float(content["occupied_thresh"]), float(content["free_thresh"])
        negate = bool(int(content.get("negate", 0)))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UnreadableFile(path, f"no map_server file: {type(error).__name__} {str(error)[:200]}") from error
    if not isinstance(name, str) or not name:
        raise UnreadableFile(path, "no map_server file: image is no file name")
    if not isinstance(mode, str) or mode.lower() not in _MODES:
        said = repr(mode[:50]) if isinstance(mode, str) else "no word"
        raise UnreadableFile(path, f"mode is {said}; choose one of: {', '.join(_MODES)}")
    if not all(map(math.isfinite, (x_m, y_m, cell_m))) or cell_m <= 0 or yaw_rad != 0:
        raise UnreadableFile(path, "resolution or origin is impossible, or the map is rotated")
    if not 0 <= free_below <= occupied_above <= 1:
        raise UnreadableFile(path, "thresholds are not 0 <= free_thresh <= occupied_thresh <= 1")
    return _About(path.parent / name, (x_m, y_m), cell_m, mode.lower(), negate, occupied_above, free_below)


def _read_yaml(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML  # only maps need it
    from ruamel.yaml.error import MarkedYAMLError

    try:
        with path.open("rb") as file:
            content = file.read(_MAX_YAML_BYTES + 1)
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error)) from error
    if len(content) > _MAX_YAML_BYTES:
        raise UnreadableFile(path, "is too long for a map_server file")
    try:
        about = YAML(typ="safe", pure=True).load(content)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise UnreadableFile(path, f"is no YAML: {error.problem or error.context}", line) from error
    except Exception as error:  # a wrong tag (!!int x) makes ruamel.yaml raise whatever int() and the like do
        first = (str(error).splitlines() or [""])[0]
        raise UnreadableFile(path, f"is no YAML: {type(error).__name__} {first[:200]}") from error
    if not isinstance(about, dict):
        raise UnreadableFile(path, "is no map_server file")
    return about
