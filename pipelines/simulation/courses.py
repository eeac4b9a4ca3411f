"""Course and ground of a simulated walk; the ground is drawn from a seed or seen by an earlier run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from quadlog.config.schema import Config
from quadlog.control.following.pure_pursuit import FINISHED_M, checked_path
from quadlog.errors import NotARun, TooLarge, TooSteep, UnknownName, UnreadableFile
from quadlog.messages import Float
from quadlog.results.arrays import read_arrays
from quadlog.results.find_runs import run_name
from quadlog.results.record import describe_input
from quadlog.results.tables import read_table
from quadlog.simulation.course_walk import COURSES, SPEED_MPS, TROT, Course, longest_s
from quadlog.simulation.robot import height_field as grounds
from quadlog.simulation.robot.height_field import Extent, HeightField, from_height_map
from quadlog.storage.formats.path_file import read_path
from quadlog.storage.formats.ros_map import read_rosmap

LEAST_POINTS = 5
"""Cells with fewer points take the height of those around them: single points far away are unreliable."""
NEAR_M = 0.5
"""Distance from a seen cell within which its height is used without a warning."""
WALKED_M = 1.0
"""Distance from the course within which a foot may step; steep ground farther away is ignored."""
# Limits of plausible height maps, since a file may hold anything.
_MOST_M, _CELLS_M = 1e6, (1e-3, 1e3)


@dataclass(frozen=True, slots=True)
class SeenGround:
    """ground: gaps filled by the nearest seen cell. seen_m: centres (N, 2) of the cells that were seen. run: whose."""

    run: Path
    ground: HeightField
    seen_m: Float

    def beyond(self, path_m: Float) -> str | None:
        """How much of a path (K, 2) in map lies beyond what was seen, and from where on; None for nothing of it."""
        places_m, step_m = places_along(path_m, NEAR_M / 5)
        away_m, _ = cKDTree(self.seen_m).query(places_m, distance_upper_bound=NEAR_M)
        beyond = ~np.isfinite(away_m)
        if not beyond.any():
            return None
        x_m, y_m = places_m[beyond.argmax()]
        return (
            f"{beyond.sum() * step_m:.1f} of the course's {len(places_m) * step_m:.1f} m, the first at "
            f"({x_m:.1f}, {y_m:.1f}) m, lie beyond the ground that {self.run} saw: each such place is taken to be as "
            f"high as its nearest edge"
        )

    def too_steep_about(self, places_m: Float, friction: float) -> str | None:
        """Why a foot cannot hold beside places (N, 2) in map, None when it can; see HeightField.too_steep_for."""
        for x_m, y_m in places_m.tolist():
            beside = self.ground.over(Extent(x_m - WALKED_M, y_m - WALKED_M, x_m + WALKED_M, y_m + WALKED_M))
            if (reason := beside.too_steep_for(friction)) is not None:
                return reason
        return None


def seen_ground(run: Path) -> SeenGround | None:
    """What a run saw of its ground, None when nothing of it, as of a 2-D scanner. Raises NotARun and TooLarge."""
    if not (run / "ground.npz").is_file():
        return None
    seen = read_arrays(run, "ground")
    origin_m, cell_m, height_m = seen["origin_m"], float(seen["cell_m"]), seen["height_m"]
    if max(np.abs(origin_m).max(), np.nanmax(np.abs(height_m), initial=0.0)) > _MOST_M:
        raise NotARun(run / "ground.npz", "is damaged: its coordinates exceed 1e6 m")
    if not _CELLS_M[0] <= cell_m <= _CELLS_M[1]:
        raise NotARun(run / "ground.npz", f"is damaged: cells of {cell_m:g} m")
    blocked = _obstacles(run, origin_m, cell_m, height_m.shape)
    height_m = np.where((seen["count"] >= LEAST_POINTS) & ~blocked, height_m, np.nan)
    rows, cols = np.nonzero(np.isfinite(height_m))
    if not len(rows):
        return None
    seen_m = origin_m + (np.stack([cols, rows], axis=1) + 0.5) * cell_m
    return SeenGround(run, from_height_map(height_m, cell_m, origin_m), seen_m)


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
    too_steep = seen.too_steep_about(places_m, friction)
    if too_steep is not None:
        return grounds.flat(), f"the re-simulated robot walks on a plane: {too_steep}"
    return seen.ground, ""


def places_along(path_m: Float, step_m: float) -> tuple[Float, float]:
    """(N, 2) middles of equal pieces of a path, about step_m long, and how long they are."""
    arc_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
    pieces = max(math.ceil(arc_m[-1] / step_m), 1)
    step_m = float(arc_m[-1]) / pieces
    middles_m = (np.arange(pieces) + 0.5) * step_m
    return np.column_stack([np.interp(middles_m, arc_m, path_m[:, k]) for k in range(2)]), step_m


# As re-simulation has it: a day at 50 Hz.
MAX_TICKS = 5_000_000
BANDS_M = {"3cm": 0.03, "6cm": 0.06}
PLANES = ("course", "flat")
MARGIN_M = 3.0


def find_course(name: str, config: Config) -> Course:
    """The course of that name, or the path of a file, at the configured speed or, without one, at its own.

    Raises UnknownName, UnreadableFile and TooLarge.
    """
    course = COURSES[name]() if name in COURSES else Course(run_name(Path(name).stem), _path_of(name), SPEED_MPS)
    if config.pursuit.speed_mps is not None:
        course = replace(course, speed_mps=config.pursuit.speed_mps)
    ticks = longest_s(course) * config.pursuit.rate_hz
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

    Raises TooSteep for ground that feet would slip on, TooLarge for a path that spans too much of it, UnknownName for
    a terrain that is neither a name nor a folder, and NotARun for a folder without a ground.
    """
    terrain, friction = config.simulation.terrain, config.simulation.friction
    if terrain in (*PLANES, *BANDS_M):
        ground = grounds.s_course(seed=seed) if (terrain, name) == ("course", "s-curve") else grounds.flat()
        if terrain in BANDS_M:
            # The ground of [Tracking]'s line and circle draws the same for both.
            extent = grounds.COURSES if name in ("line", "circle") else _around(course)
            ground = grounds.undulating(BANDS_M[terrain], seed=seed, extent=extent)
        too_steep = ground.too_steep_for(friction)
    else:
        seen = _seen(terrain)
        ground = seen.ground.over(_around(course))
        too_steep = seen.too_steep_about(places_along(course.path_m, WALKED_M)[0], friction)
    if too_steep is not None:
        raise TooSteep(too_steep)
    return ground


def ground_remarks(course: Course, config: Config) -> tuple[list[str], list[str]]:
    """Notes and warnings on the ground of a course, the same for all seeds. Raises as make_ground does."""
    terrain = config.simulation.terrain
    if terrain in (*PLANES, *BANDS_M):
        return [], []
    seen = _seen(terrain)
    beyond, file = seen.beyond(course.path_m), describe_input(seen.run / "ground.npz")
    notes = [f"the ground is what {seen.run} saw (ground.npz, SHA-256 {file.sha256})"]
    return notes, [] if beyond is None else [beyond]


def _seen(terrain: str) -> SeenGround:
    run = Path(terrain)
    if not run.is_dir():
        raise UnknownName("terrain", terrain, [*PLANES, *BANDS_M, "a run folder"])
    seen = seen_ground(run)
    if seen is None:
        raise NotARun(run, f"saw no ground: it has no ground.npz, or none of its cells holds {LEAST_POINTS} points")
    return seen


def _around(course: Course) -> Extent:
    low_m, high_m = course.path_m.min(axis=0) - MARGIN_M, course.path_m.max(axis=0) + MARGIN_M
    return Extent(*low_m.tolist(), *high_m.tolist())
