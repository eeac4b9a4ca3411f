"""The table tracking-courses: [Tracking]'s simulated line and circle, Figs 10 to 24, as FpMW walks them."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.tracked_courses import (
    CIRCLE_M,
    CIRCLE_S,
    COURSES,
    DESIRED_MPS,
    DRAWN,
    Measured,
    claim_group,
    course_group,
    curve_group,
    measure_courses,
)
from quadlog.pipelines.tables.tracked_curves import draw_curves
from quadlog.pipelines.tables.tracked_walks import CONDITIONS, held_out_seeds
from quadlog.pipelines.tables.tracking_pictures import draw_errors, draw_etas
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png

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


def _pictures(measured: Measured, seed: int) -> tuple[Picture, ...]:
    panels = {condition: {called: measured[condition, called] for called in COURSES} for condition in CONDITIONS}
    errors, etas = render_png(partial(draw_errors, panels)), render_png(partial(draw_etas, panels))
    curves = render_png(partial(draw_curves, measured[DRAWN][0]))
    assert errors is not None
    assert etas is not None
    assert curves is not None
    return (
        Picture(
            "errors",
            "Distance to the path over time on line and circle, undisturbed above, disturbed below.",
            f"The walks of seed {held_out_seeds(1, seed)[0]}. A cross: it fell there.",
            errors,
        ),
        Picture(
            "eta",
            "Mean error of each walk by course, with means and intervals, undisturbed and disturbed.",
            "A dot for each walk, hollow where it fell; above it the mean over the seeds and its 95 % interval.",
            etas,
        ),
        Picture(
            "curves",
            "A walk round the circle: its way, errors of position and yaw, speed and yaw rate, joint torques of a leg, "
            "k_v and k_w, and the look-ahead.",
            f"As Figs 21 to 24: the undisturbed walk of seed {held_out_seeds(1, seed)[0]} round the circle on 6 cm.",
            curves,
        ),
    )
