"""The walks of the table tracking-courses: [Tracking]'s simulated courses, walked by FpMW."""

from __future__ import annotations

import math

from quadlog.pipelines.tables.tracked_walks import CONDITIONS, Steering, Task, Tracked, held_out_seeds, walk_all
from quadlog.pipelines.tables.tracking_figures import (
    ETA,
    ETA_TIME,
    HEIGHT,
    LOOKAHEAD,
    LOOKAHEAD_RANGE,
    PITCH,
    SATURATED,
    SIGMA,
    SIGMA_TIME,
    TIME,
    TORQUE,
    YAW_ERROR,
    Figure,
    fall_row,
    mean_row,
    ratio_row,
)
from quadlog.results.paper_rows import PaperRow, RowGroup

FPMW = Steering("FpMW", "fpmw")
COURSES = {
    "line, flat": ("line", "flat"),
    "line, 3 cm": ("line", "3cm"),
    "line, 6 cm": ("line", "6cm"),
    "circle, 6 cm": ("circle", "6cm"),
}
"""What the table calls them: course and terrain."""
CIRCLE_M = 10 * math.pi
CIRCLE_S = 62.0
"""The one number that is printed for Figs 10 to 24."""
DESIRED_MPS = 0.6
DRAWN = ("ideal", "circle, 6 cm")
"""Of its first walk all curves are kept."""
LARGEST = Figure("max_error_m", "largest distance to the path", "m")
SPEED = Figure("speed_mean_mps", "mean speed forward", "m/s")
SPEED_STD = Figure("speed_std_mps", "standard deviation of speed", "m/s")
YAW_RATE_STD = Figure("yaw_rate_std_radps", "standard deviation of yaw rate", "rad/s")
CURVED = (
    Figure("x_error_rms_m", "x error, rms", "m"),
    Figure("y_error_rms_m", "y error, rms", "m"),
    YAW_ERROR,
    SPEED_STD,
    YAW_RATE_STD,
    TORQUE,
    SATURATED,
    Figure("k_v_range", "range of k_v", "1"),
    Figure("k_w_range", "range of k_w", "1"),
    LOOKAHEAD,
    LOOKAHEAD_RANGE,
)
"""What the paper draws over time."""
CLAIMED = {
    "position errors, η": ETA,
    "yaw error, rms": YAW_ERROR,
    "fluctuation of speed": SPEED_STD,
    "fluctuation of yaw rate": YAW_RATE_STD,
    "range of the look-ahead": LOOKAHEAD_RANGE,
}
"""What the paper says increases slightly from 3 cm to 6 cm."""

Measured = dict[tuple[str, str], list[Tracked]]
"""By condition and course."""


def measure_courses(walks: int, seed: int) -> Measured:
    """Every course under every condition; without disturbances flat ground leaves nothing to be drawn."""
    tasks: dict[tuple[str, str], list[Task]] = {}
    for condition, disturbed in CONDITIONS.items():
        for called, (course, terrain) in COURSES.items():
            drawn = disturbed or terrain != "flat"
            seeds = held_out_seeds(walks if drawn else 1, seed)
            is_drawn = (condition, called) == DRAWN
            tasks[condition, called] = [
                Task(course, terrain, FPMW, disturbed, each, is_drawn and each == seeds[0]) for each in seeds
            ]
    done = iter(walk_all([task for mine in tasks.values() for task in mine]))
    return {which: [next(done) for _ in mine] for which, mine in tasks.items()}


def course_group(condition: str, measured: Measured) -> RowGroup:
    """Errors, times and falls of every course."""
    rows: list[PaperRow] = []
    for called in COURSES:
        walks, where = measured[condition, called], f"{condition}, {called}"
        for figure in (ETA, SIGMA, LARGEST, ETA_TIME, SIGMA_TIME):
            rows += mean_row(where, figure, walks)
        rows += _time_rows(where, walks)
        # What is not drawn has no interval, falls neither.
        rows += [fall_row(where, walks)] if len(walks) > 1 else []
        for figure in (PITCH, HEIGHT):
            rows += mean_row(where, figure, walks)
    grounds = (
        "The pose is known exactly and nothing pushes; the seed draws the ground. Flat ground leaves nothing to draw: "
        "one walk, without interval."
        if condition == "ideal"
        else "As `quadlog simulate --disturbed`: a push of 60 N to a side every 2 s, wrong velocities, a noisy and "
        "late pose, a wrong mass. The seed draws them and the ground."
    )
    text = (
        f"{grounds} η, σ: mean and standard deviation of the distance to the path; beside the place in time: to where "
        "a robot without delay would be. Intervals: 95 % after Student over the seeds; shares of walks after Wilson. "
        "Pitch and height rms are against what the controller wants on that ground."
    )
    return RowGroup(f"FpMW, {condition}", text, tuple(rows))


def _time_rows(where: str, walks: list[Tracked]) -> list[PaperRow]:
    paper_mps = f"{CIRCLE_M / CIRCLE_S:.3f} m/s"
    why_not = f"{CIRCLE_M:.1f} m in {CIRCLE_S:g} s are {paper_mps}, not the {DESIRED_MPS:g} m/s that are desired."
    printed = CIRCLE_S if "circle" in where else None
    return [
        *mean_row(where, TIME, walks, printed, 1.0, why_not=why_not),
        *mean_row(where, SPEED, walks, DESIRED_MPS, 0.1, note="Claimed: at the desired velocity."),
    ]


def curve_group(measured: Measured) -> RowGroup:
    """The curves of Figs 11 to 24 in numbers."""
    rows = [
        row
        for condition in CONDITIONS
        for called, (_, terrain) in COURSES.items()
        if terrain != "flat"
        for figure in CURVED
        for row in mean_row(f"{condition}, {called}", figure, measured[condition, called])
    ]
    text = (
        "The paper draws these over time and prints no number; of torques it says that they are within a reasonable "
        "range. Position errors are those to the nearest point of the path, along the map's axes; torques those of all "
        "twelve joints. Intervals: 95 % after Student over the seeds."
    )
    return RowGroup("Figs 11 to 24, curve by curve", text, tuple(rows))


def claim_group(measured: Measured) -> RowGroup:
    """What is said of 6 cm against 3 cm on the line."""
    rows: list[PaperRow] = []
    for condition in CONDITIONS:
        rough, smooth = (measured[condition, f"line, {band}"] for band in ("6 cm", "3 cm"))
        for called, figure in CLAIMED.items():
            quantity = f"{condition}, line: {called}, 6 cm / 3 cm (1)"
            rows += ratio_row(quantity, figure, rough, smooth, 1.0, "Claimed: slightly more than 1.")
    text = (
        "The paper says that all these increase slightly on the rougher ground, and prints no number. That reproduces "
        "where our ratio, with its interval, lies above 1. The same seed draws the same ground, twice as high, and the "
        "same disturbances. Intervals: 95 % after Student, of the logarithms over the seeds."
    )
    return RowGroup("What 6 cm changes against 3 cm", text, tuple(rows))
