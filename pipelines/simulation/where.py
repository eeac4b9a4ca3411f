"""Where a simulated robot walks: the course, and the ground under it."""

from __future__ import annotations

from pathlib import Path

from quadlog.config import Config
from quadlog.errors import TooLarge, TooSteep, UnknownName, UnreadableFile
from quadlog.following.path_follower import checked_path
from quadlog.messages import Float
from quadlog.results.names import run_name
from quadlog.results.path_file import read_path
from quadlog.simulation import ground as grounds
from quadlog.simulation.course_walk import longest_s
from quadlog.simulation.courses import COURSES, Course
from quadlog.simulation.ground import Extent, Ground

# As re-simulation has it: a day at 50 Hz.
MAX_TICKS = 5_000_000
BANDS_M = {"3cm": 0.03, "6cm": 0.06}
MARGIN_M = 3.0


def find_course(name: str, config: Config) -> Course:
    """The course of that name, or the path of a file, at the configured speed or, without one, at its own.

    Raises UnknownName, UnreadableFile and TooLarge.
    """
    own_speed = "speed_mps" not in config.pursuit.model_fields_set
    if name in COURSES:
        course = COURSES[name]()
        course = course if own_speed else Course(course.name, course.path_m, config.pursuit.speed_mps)
    else:
        course = Course(run_name(Path(name).stem), _path_of(name), config.pursuit.speed_mps)
    ticks = longest_s(course) * config.pursuit.rate_hz
    if ticks > MAX_TICKS:
        raise TooLarge(f"ticks of a walk along {name}", int(ticks), MAX_TICKS)
    return course


def _path_of(name: str) -> Float:
    path = Path(name)
    if not path.suffix and not path.exists():
        raise UnknownName("course", name, [*COURSES, "a path in a .tum or .csv file"])
    try:
        return checked_path(read_path(path))
    except ValueError as error:
        raise UnreadableFile(path, str(error)) from None


def make_ground(name: str, course: Course, config: Config, seed: int) -> Ground:
    """The ground that [simulation] terrain names, drawn from the seed; name: of the course, as find_course has it.

    Raises TooSteep for ground that feet would slip on, and TooLarge for a path that spans too much of it.
    """
    terrain = config.simulation.terrain
    if terrain == "course" and name == "s-curve":
        ground = grounds.s_course(seed=seed)
    elif terrain in BANDS_M:
        ground = grounds.undulating(BANDS_M[terrain], seed=seed, extent=_extent(name, course))
    else:
        ground = grounds.flat()
    too_steep = ground.too_steep_for(config.simulation.friction)
    if too_steep is not None:
        raise TooSteep(too_steep)
    return ground


def _extent(name: str, course: Course) -> Extent:
    """The ground of [Tracking]'s line and circle, which draws the same for both; of another course what it needs."""
    if name in ("line", "circle"):
        return grounds.COURSES
    low_m, high_m = course.path_m.min(axis=0) - MARGIN_M, course.path_m.max(axis=0) + MARGIN_M
    return Extent(*low_m.tolist(), *high_m.tolist())
