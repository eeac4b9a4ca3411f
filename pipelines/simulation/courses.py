"""Course and ground of a simulated walk, drawn from a seed; and the ground that a replay saw."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.control.following.pure_pursuit import FINISHED_M, checked_path
from quadlog.errors import QuadlogError, TooLarge, UnknownName, UnreadableFile
from quadlog.messages import Float
from quadlog.results.arrays import read_arrays
from quadlog.results.find_runs import run_name
from quadlog.results.tables import read_table
from quadlog.simulation.course_walk import COURSES, SPEED_MPS, TROT, Course, longest_s
from quadlog.simulation.robot import height_field as grounds
from quadlog.simulation.robot.height_field import Extent, HeightField, from_height_map
from quadlog.simulation.settings import RATE_HZ
from quadlog.storage.formats.path_file import read_path
from quadlog.storage.formats.ros_map import read_rosmap

LEAST_POINTS = 5
"""Cells with fewer points take the height of those around them: single points far away are unreliable."""
WALKED_M = 1.0
"""Distance from the way within which a foot may step; steep ground farther away is ignored."""


def seen_ground(run: Path) -> HeightField | None:
    """What a run saw of its ground, gaps filled by the nearest seen cell; None when nothing of it, as of a 2-D scanner.

    Raises NotARun and TooLarge.
    """
    if not (run / "ground.npz").is_file():
        return None
    seen = read_arrays(run, "ground")
    origin_m, cell_m, height_m = seen["origin_m"], float(seen["cell_m"]), seen["height_m"]
    blocked = _obstacles(run, origin_m, cell_m, height_m.shape)
    height_m = np.where((seen["count"] >= LEAST_POINTS) & ~blocked, height_m, np.nan)
    return from_height_map(height_m, cell_m, origin_m) if np.isfinite(height_m).any() else None


def _obstacles(run: Path, origin_m: Float, cell_m: float, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Cells (rows, cols) of the ground where the run's map has an obstacle: what looks like ground there is its top."""
    within = np.zeros(shape, np.bool_)
    if (run / "map.yaml").is_file():
        drawn = read_rosmap(run / "map.yaml")
        rows, cols = np.nonzero(drawn.blocked)
        centres_m = drawn.origin_m + drawn.cell_m * (np.column_stack([cols, rows]) + 0.5)
        cells = np.floor((centres_m - origin_m) / cell_m)
        col, row = cells[((cells >= 0) & (cells < within.shape[::-1])).all(axis=1)].astype(np.int64).T
        within[row, col] = True
    return within


def walkable_ground(run: Path, friction: float) -> tuple[HeightField, str]:
    """The ground a run saw, or a plane and why: it saw none, or feet would slip where it walked. As seen_ground."""
    seen = seen_ground(run)
    if seen is None:
        return grounds.flat(), "no ground was seen: the re-simulated robot walks on a plane"
    poses = read_table(run, "poses", ["x_m", "y_m"])
    walked_m = np.column_stack([poses["x_m"], poses["y_m"]])
    step_m = WALKED_M / 4
    places_m = step_m * np.unique(np.round(walked_m[np.isfinite(walked_m).all(axis=1)] / step_m), axis=0)
    for x_m, y_m in places_m.tolist():
        beside = seen.over(Extent(x_m - WALKED_M, y_m - WALKED_M, x_m + WALKED_M, y_m + WALKED_M))
        if (too_steep := beside.too_steep_for(friction)) is not None:
            return grounds.flat(), f"the re-simulated robot walks on a plane: {too_steep}"
    return seen, ""


# As re-simulation has it: a day at 50 Hz.
MAX_TICKS = 5_000_000
BANDS_M = {"3cm": 0.03, "6cm": 0.06}
MARGIN_M = 3.0


def find_course(name: str, config: Config) -> Course:
    """The course of that name, or the path of a file, at the configured speed or, without one, at its own.

    Raises UnknownName, UnreadableFile and TooLarge.
    """
    course = COURSES[name]() if name in COURSES else Course(run_name(Path(name).stem), _path_of(name), SPEED_MPS)
    if config.pursuit.speed_mps is not None:
        course = replace(course, speed_mps=config.pursuit.speed_mps)
    ticks = longest_s(course) * RATE_HZ
    if ticks > MAX_TICKS:
        raise TooLarge(f"ticks of a walk along {name}", int(ticks), MAX_TICKS)
    return course


def _path_of(name: str) -> Float:
    path = Path(name)
    if not path.suffix and not path.exists():
        raise UnknownName("course", name, [*COURSES, TROT, "a path in a .tum or .csv file"])
    try:
        points_m = checked_path(read_path(path))
    except ValueError as error:
        raise UnreadableFile(path, str(error)) from None
    length_m = float(np.hypot(*np.diff(points_m, axis=0).T).sum())
    if length_m <= FINISHED_M:
        raise UnreadableFile(path, f"is walked before it begins: {length_m:g} m, and {FINISHED_M:g} m off is arrived")
    return points_m


def make_ground(name: str, course: Course, config: Config, seed: int) -> HeightField:
    """The ground that [simulation] terrain names, drawn from the seed; name: of the course, as find_course has it.

    Raises QuadlogError for ground that feet would slip on, TooLarge for a path that spans too much of it.
    """
    terrain = config.simulation.terrain
    ground = grounds.s_course(seed=seed) if (terrain, name) == ("course", "s-curve") else grounds.flat()
    if terrain in BANDS_M:
        # The ground of [Tracking]'s line and circle draws the same for both.
        extent = grounds.COURSES if name in ("line", "circle") else _around(course)
        ground = grounds.undulating(BANDS_M[terrain], seed=seed, extent=extent)
    if (too_steep := ground.too_steep_for(config.simulation.friction)) is not None:
        raise QuadlogError(f"{too_steep}; raise it with  --set simulation.friction=...  or choose another terrain")
    return ground


def _around(course: Course) -> Extent:
    low_m, high_m = course.path_m.min(axis=0) - MARGIN_M, course.path_m.max(axis=0) + MARGIN_M
    return Extent(*low_m.tolist(), *high_m.tolist())
