"""The trajectory as a chart: who walked where over the cells that stayed occupied, in metres of `map`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.results.chart_panels import rounded
from quadlog.results.plots.occupancy import seen_around
from quadlog.results.plots.run_data import RunData, Table
from quadlog.results.plots.style import thin_points

POINTS = 2000
"""Of one walk: 3 cm apart on a minute's walk."""
WALL_SHARE = 0.5
"""A cell is drawn where this share of the maps that covered it had it occupied: walls stay, what moved does not."""
MAX_RUNS = 20_000


def trajectory_chart(run: RunData) -> dict[str, Any] | None:
    """Paths of robot, target, re-simulated or simulated walk with their times; anchors; walls. None without paths.

    around: places that are to be seen, too.
    """
    walked = "simulated walk" if run.simulated else "re-simulated walk"
    wanted = [("course", "paths", "note")] if run.simulated else []
    wanted += [("robot", "poses", "robot"), ("target", "target", "target"), (walked, "control", "resim")]
    tables = [(label, run.table(name), color) for label, name, color in wanted]
    walks = [_walk(run, label, table, color) for label, table, color in tables if table is not None]
    walks = [walk for walk in walks if walk["x"]]
    if not walks:
        return None
    anchors = [{"label": str(anchor), "x": x_m, "y": y_m} for anchor, x_m, y_m in run.anchors()]
    walked_m = np.array([[x_m, y_m] for walk in walks for x_m, y_m in zip(walk["x"], walk["y"], strict=True)])
    around = [{"x": x_m, "y": y_m} for x_m, y_m in seen_around(walked_m, run.occupancy).tolist()]
    return {"walks": walks, "anchors": anchors, "around": around, "walls": _walls(run)}


def _walk(run: RunData, label: str, table: Table, color: str) -> dict[str, Any]:
    finite = np.flatnonzero(np.isfinite(table["x_m"]) & np.isfinite(table["y_m"]))
    keep = finite[thin_points(len(finite), POINTS)]
    seconds = [round(value, 3) for value in run.seconds(table["t_ns"])[keep].tolist()]
    return {
        "label": label,
        "color": color,
        "seconds": seconds,
        "x": rounded(table["x_m"][keep]),
        "y": rounded(table["y_m"][keep]),
    }


def _walls(run: RunData) -> dict[str, Any] | None:
    """Occupied cells as runs along x: flat triples of row, first column and length."""
    occupancy = run.occupancy
    if occupancy is None:
        return None
    runs = row_runs(np.nan_to_num(occupancy.share) >= WALL_SHARE)
    if len(runs) > MAX_RUNS:  # the picture has them all
        return None
    return {
        "cell_m": occupancy.cell_m,
        "x": float(occupancy.origin_m[0]),
        "y": float(occupancy.origin_m[1]),
        "runs": runs.ravel().tolist(),
    }


def row_runs(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Runs (R, 3) of row, first column and length of the true cells (rows, columns), in order."""
    edges = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(edges == 1)
    _, past = np.nonzero(edges == -1)
    return np.column_stack([row, first, past - first]).astype(np.int64)
