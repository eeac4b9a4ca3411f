"""Where a simulated robot walks: the course, and the ground under it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quadlog.config import Config
from quadlog.errors import NotARun, TooLarge, TooSteep, UnknownName, UnreadableFile
from quadlog.following.path_follower import FINISHED_M, checked_path
from quadlog.messages import Float
from quadlog.pipelines.simulation.seen_ground import LEAST_POINTS, SeenGround, seen_ground
from quadlog.results.names import run_name
from quadlog.results.path_file import read_path
from quadlog.simulation import ground as grounds
from quadlog.simulation.course_walk import longest_s
from quadlog.simulation.courses import COURSES, SPEED_MPS, TROT, Course
from quadlog.simulation.ground import Extent, Ground

# As re-simulation has it: a day at 50 Hz.
MAX_TICKS = 5_000_000
BANDS_M = {"3cm": 0.03, "6cm": 0.06}
PLANES = ("course", "flat")
MARGIN_M = 3.0


@dataclass(frozen=True, slots=True)
class Remarks:
    """What a run tells of its ground, and what a user should know before trusting it."""

    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


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


def make_ground(name: str, course: Course, config: Config, seed: int) -> Ground:
    """The ground that [simulation] terrain names, drawn from the seed; name: of the course, as find_course has it.

    Raises TooSteep for ground that feet would slip on, TooLarge for a path that spans too much of it, UnknownName for
    a terrain that is neither a name nor a folder, and NotARun for a folder without a ground.
    """
    terrain = config.simulation.terrain
    friction = config.simulation.friction
    if terrain in (*PLANES, *BANDS_M):
        ground = _drawn(terrain, name, course, seed)
        too_steep = ground.too_steep_for(friction)
    else:
        seen = _seen(terrain)
        ground = seen.ground.over(_around(course))
        too_steep = seen.too_steep_along(course.path_m, friction)
    if too_steep is not None:
        raise TooSteep(too_steep)
    return ground


def ground_remarks(course: Course, config: Config) -> Remarks:
    """What is to be said of the ground of a course, whatever the seed. Raises as make_ground does."""
    terrain = config.simulation.terrain
    if terrain in (*PLANES, *BANDS_M):
        return Remarks()
    seen = _seen(terrain)
    beyond = seen.beyond(course.path_m)
    return Remarks((seen.provenance(),), () if beyond is None else (beyond,))


def _drawn(terrain: str, name: str, course: Course, seed: int) -> Ground:
    if terrain in BANDS_M:
        return grounds.undulating(BANDS_M[terrain], seed=seed, extent=_extent(name, course))
    return grounds.s_course(seed=seed) if terrain == "course" and name == "s-curve" else grounds.flat()


def _seen(terrain: str) -> SeenGround:
    run = Path(terrain)
    if not run.is_dir():
        raise UnknownName("terrain", terrain, [*PLANES, *BANDS_M, "a run folder"])
    if not (run / "ground.npz").is_file():
        raise NotARun(run, "is no terrain without a ground.npz: no ground was seen there, or it was a plane")
    seen = seen_ground(run)
    if seen is None:
        raise NotARun(run, f"saw no ground: none of its cells holds {LEAST_POINTS} points")
    return seen


def _extent(name: str, course: Course) -> Extent:
    """The ground of [Tracking]'s line and circle, which draws the same for both; of another course what it needs."""
    return grounds.COURSES if name in ("line", "circle") else _around(course)


def _around(course: Course) -> Extent:
    low_m, high_m = course.path_m.min(axis=0) - MARGIN_M, course.path_m.max(axis=0) + MARGIN_M
    return Extent(*low_m.tolist(), *high_m.tolist())
