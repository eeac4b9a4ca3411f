"""tracking-courses: line and circle on uneven ground, walked by FpMW [Tracking, Figs 10-24]."""

from __future__ import annotations

import math

from quadlog.pipelines.tables.claims import Claim, Group, Point, Ratio, Study, StudyTable, held_out_seeds
from quadlog.pipelines.tables.judge import EXACT, SIZE, beyond, number, rests
from quadlog.pipelines.tables.tracking_5 import CONDITIONS, ERRORS, FIGURES, GROUNDS, fall_row, track

COURSES = {
    "line, flat": ("line", "flat"),
    "line, 3 cm": ("line", "3cm"),
    "line, 6 cm": ("line", "6cm"),
    "circle, 6 cm": ("circle", "6cm"),
}
"""What the table calls them: course and terrain."""
CIRCLE_M, CIRCLE_S, DESIRED_MPS = 10 * math.pi, 62.0, 0.6
"""62 s is the one number that is printed for Figs 10 to 24."""
OURS = ("eta_m", "sigma_m", "eta_time_m", "sigma_time_m")
SLIGHTLY_MORE = {
    "position errors, η": "eta_m",
    "yaw error, rms": "heading_rmse_rad",
    "fluctuation of speed": "speed_std_mps",
    "fluctuation of yaw rate": "yaw_rate_std_radps",
    "range of the look-ahead": "lookahead_range_m",
}
"""What the paper says increases slightly from 3 cm to 6 cm."""


def course_rows(condition: str, called: str) -> list[Claim]:
    """Time, speed and errors of one course."""
    course, terrain = COURSES[called]
    where, which = {"course": course, "terrain": terrain, "condition": condition}, f"{condition}, {called}"
    is_drawn = (condition, terrain) != ("ideal", "flat")
    statistic = SIZE if is_drawn else EXACT
    time = number(CIRCLE_S, 1.0) if course == "circle" else None
    why = f"{CIRCLE_M:.1f} m in {CIRCLE_S:g} s are {CIRCLE_M / CIRCLE_S:.3f} m/s, not the {DESIRED_MPS:g} m/s desired."
    speed = rests(number(DESIRED_MPS, 0.1), "Claimed: at the desired velocity, which is commanded here.")
    timed = f"{which}: {FIGURES['completion_time_s']}"
    fast = f"{which}: {FIGURES['speed_mean_mps']}"
    return [
        Claim(timed, "completion_time_s", where, time, statistic, why_not=why, of="time round the circle"),
        Claim(fast, "speed_mean_mps", where, speed, statistic, of="speed"),
        *(Claim(f"{which}: {FIGURES[column]}", column, where, statistic=statistic) for column in OURS),
        fall_row(which, where),
    ]


def rougher_row(condition: str, called: str) -> Claim:
    """The claims on 6 cm against 3 cm on the line."""
    return Ratio(
        f"{condition}, line: {called}, 6 cm / 3 cm (1)",
        SLIGHTLY_MORE[called],
        {"course": "line", "condition": condition},
        beyond(1.0, why="Claimed: slightly more than 1."),
        of=f"{called}, 6 cm / 3 cm",
        part={"terrain": "6cm"},
        whole={"terrain": "3cm"},
    )


def table(fast: bool, seed: int) -> StudyTable:
    """Fast walks each course on fewer seeds, and the circle, the longest, with disturbances alone.

    Without them flat ground leaves nothing to be drawn.
    """
    seeds = held_out_seeds(2 if fast else 10, seed)
    points: list[Point] = [
        {"course": course, "terrain": terrain, "steering": "FpMW", "condition": condition, "seed": each}
        for course, terrain in COURSES.values()
        for condition in CONDITIONS
        if not (fast and (course, condition) == ("circle", "ideal"))
        for each in (seeds[:1] if (condition, terrain) == ("ideal", "flat") else seeds)
    ]
    return StudyTable(
        title="Line and circle on uneven ground [Tracking, Figs 10-24]",
        caption="Fuzzy pure pursuit, MPC and whole-body control (FpMW) take a simulated quadruped along a line from "
        "(0, 0) to (10, 10) m and round a circle of 5 m radius, at 0.6 m/s. The paper shows curves and prints hardly a "
        'number. Its ground is not described: here "3 cm" is the middle 95 % of the heights of filtered noise that '
        "correlates over 0.25 m. Gains and weights are ours.",
        sizes=f"{len(seeds)} walks of every course under either condition, one where nothing is drawn, "
        f"{'the circle with disturbances alone, ' if fast else ''}seed {seed}: "
        f"walks drawn from seeds {seeds[0]} to {seeds[-1]}.",
        study=Study(track, points),
        groups=[
            *(
                Group(
                    f"FpMW, {condition}",
                    f"{GROUNDS[condition]} {ERRORS}",
                    [row for called in COURSES for row in course_rows(condition, called)],
                )
                for condition in CONDITIONS
            ),
            Group(
                "What 6 cm changes against 3 cm",
                "The paper says that all these increase slightly on the rougher ground, and prints no number. The same "
                "seed draws the same ground, twice as high, and the same disturbances. Geometric means; intervals: "
                "Student, of the logarithms.",
                [rougher_row(condition, called) for condition in CONDITIONS for called in SLIGHTLY_MORE],
            ),
        ],
    )
