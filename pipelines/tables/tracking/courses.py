"""The table tracking-courses: [Tracking]'s simulated courses, walked by FpMW."""

from __future__ import annotations

import math

from quadlog.messages import Float
from quadlog.pipelines.tables.pictures import drawn
from quadlog.pipelines.tables.tracking.walks import (
    CONDITIONS,
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
    Steering,
    Tracked,
    TrackingStatistic,
    TrackingTask,
    error_panels,
    eta_panels,
    fall_row,
    held_out_seeds,
    mean_row,
    ratio_row,
    walk_all,
)
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture
from quadlog.results.view import Panel, Series, look

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
LARGEST = TrackingStatistic("max_error_m", "largest distance to the path", "m")
SPEED = TrackingStatistic("speed_mean_mps", "mean speed forward", "m/s")
SPEED_STD = TrackingStatistic("speed_std_mps", "standard deviation of speed", "m/s")
YAW_RATE_STD = TrackingStatistic("yaw_rate_std_radps", "standard deviation of yaw rate", "rad/s")
CURVED = (
    TrackingStatistic("x_error_rms_m", "x error, rms", "m"),
    TrackingStatistic("y_error_rms_m", "y error, rms", "m"),
    YAW_ERROR,
    SPEED_STD,
    YAW_RATE_STD,
    TORQUE,
    SATURATED,
    TrackingStatistic("k_v_range", "range of k_v", "1"),
    TrackingStatistic("k_w_range", "range of k_w", "1"),
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
    tasks: dict[tuple[str, str], list[TrackingTask]] = {}
    for condition, disturbed in CONDITIONS.items():
        for called, (course, terrain) in COURSES.items():
            drawn = disturbed or terrain != "flat"
            seeds = held_out_seeds(walks if drawn else 1, seed)
            is_drawn = (condition, called) == DRAWN
            tasks[condition, called] = [
                TrackingTask(course, terrain, FPMW, disturbed, each, is_drawn and each == seeds[0]) for each in seeds
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
            rows += ratio_row(quantity, figure, rough, smooth, note="Claimed: slightly more than 1.", is_claimed=True)
    text = (
        "The paper says that all these increase slightly on the rougher ground, and prints no number. That reproduces "
        "where our ratio, with its interval, lies above 1. The same seed draws the same ground, twice as high, and the "
        "same disturbances. Intervals: 95 % after Student, of the logarithms over the seeds."
    )
    return RowGroup("What 6 cm changes against 3 cm", text, tuple(rows))


LINES: dict[str, tuple[str, ...]] = {
    "speed (m/s)": ("vx_mps",),
    "yaw rate (rad/s)": ("yaw_rate_radps",),
    "torque (N m)": ("tau_00_nm", "tau_01_nm", "tau_02_nm"),
    "fuzzy gain (1)": ("k_v", "k_w"),
    "look-ahead (m)": ("lookahead_m",),
}
CALLED = {"tau_00_nm": "abduction", "tau_01_nm": "hip", "tau_02_nm": "knee", "k_v": "k_v", "k_w": "k_w"}


def curve_panels(walk: Tracked) -> list[Panel]:
    """Seven panels; the walk must have its curves."""
    position: dict[str, Float] = {axis: walk.curves[f"{axis}_m"] - walk.curves[f"ref_{axis}_m"] for axis in "xy"}
    yaw: dict[str, Float] = {"yaw": walk.curves["heading_error_rad"]}
    lines: dict[str, dict[str, Float]] = {"position error (m)": position, "yaw error (rad)": yaw}
    lines |= {label: {CALLED.get(name, name): walk.curves[name] for name in names} for label, names in LINES.items()}
    return [
        Panel(what, [Series(name, x=walk.t_s, y=values, **look(k)) for k, (name, values) in enumerate(mine.items())])
        for what, mine in lines.items()
    ]


FULL_WALKS, FAST_WALKS = 10, 2
ERRATUM = (
    f"The circle of 5 m radius is {CIRCLE_M:.1f} m long; at the stated {DESIRED_MPS:g} m/s it takes "
    f"{CIRCLE_M / DESIRED_MPS:.1f} s. The printed {CIRCLE_S:g} s are {CIRCLE_M / CIRCLE_S:.3f} m/s."
)


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast walks each course on fewer seeds."""
    walks = FAST_WALKS if fast else FULL_WALKS
    measured = measure_courses(walks, seed)
    return PaperTable(
        name="tracking-courses",
        title="Line and circle on uneven ground [Tracking, Figs 10-24]",
        caption="Fuzzy pure pursuit, MPC and whole-body control (FpMW) take a simulated quadruped along a line from "
        "(0, 0) to (10, 10) m and round a circle of 5 m radius, at 0.6 m/s. The paper shows curves and prints hardly a "
        'number. Its ground is not described: here "3 cm" is the middle 95 % of the heights of filtered noise that '
        "correlates over 0.25 m. Gains and weights are ours.",
        sizes=f"{count(walks)} walks of every course under either condition, one where nothing is drawn, seed {seed}: "
        f"walks drawn from seeds {held_out_seeds(walks, seed)[0]} to {held_out_seeds(walks, seed)[-1]}.",
        seed=seed,
        fast=fast,
        groups=(
            *(course_group(condition, measured) for condition in CONDITIONS),
            claim_group(measured),
            curve_group(measured),
        ),
        pictures=_pictures(measured, seed),
        errata=(ERRATUM,),
    )


def _pictures(measured: Measured, seed: int) -> tuple[TablePicture, ...]:
    panels = {condition: {called: measured[condition, called] for called in COURSES} for condition in CONDITIONS}
    return (
        drawn(
            "errors",
            "Distance to the path over time on line and circle, undisturbed above, disturbed below.",
            f"The walks of seed {held_out_seeds(1, seed)[0]}; one that fell ends there.",
            error_panels(panels),
        ),
        drawn(
            "eta",
            "Mean error of each walk by course, with means and intervals, undisturbed and disturbed.",
            "A small dot for each walk; a large one for the mean over the seeds and its 95 % interval.",
            eta_panels(panels),
        ),
        drawn(
            "curves",
            "A walk round the circle: errors of position and yaw, speed and yaw rate, joint torques of a leg, "
            "k_v and k_w, and the look-ahead.",
            f"As Figs 21 to 24: the undisturbed walk of seed {held_out_seeds(1, seed)[0]} round the circle on 6 cm.",
            curve_panels(measured[DRAWN][0]),
        ),
    )
