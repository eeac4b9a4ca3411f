"""A map as ROS map_server reads it: `map.pgm` (grey values) and `map.yaml` (where it lies). Read by `map_files`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.results.files import write_whole

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
