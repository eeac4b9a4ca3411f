"""The table tracking-5: [Tracking]'s Table 5, three controllers on the S-curve, beside fixed look-aheads."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.s_curve_rows import NAMES, honesty_group, number_group, order_group, scan_group
from quadlog.pipelines.tables.tracked_s_curve import (
    FAST_RIVAL_WALKS,
    RIVALS,
    Measured,
    measure_controllers,
)
from quadlog.pipelines.tables.tracked_walks import CHOOSING_SEEDS, CONDITIONS, held_out_seeds
from quadlog.pipelines.tables.tracking_pictures import draw_errors, draw_etas
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png

FULL_WALKS, FAST_WALKS = 10, 2
ERRATUM = (
    "Eq. 45 does not say which predicted position an error is measured from: both the nearest point of the path and "
    "the place in time are given. Eqs 46 and 47 sum to N and divide by N_e; here both are all ticks."
)


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast walks less often, and hardly ever with another look-ahead."""
    walks = FAST_WALKS if fast else FULL_WALKS
    measured, scan = measure_controllers(walks, seed, fast)
    scanned = (scan_group(scan),) if scan else ()
    seeds = held_out_seeds(walks, seed)
    return PaperTable(
        name="tracking-5",
        title="Three controllers on an S-curve [Tracking, Table 5]",
        caption="A quadruped follows an S-curve, up 15° and down 20°, by fuzzy pure pursuit with MPC and whole-body "
        "control (FpMW), without whole-body control (FpM), and with a fixed look-ahead instead of the fuzzy one (pMW, "
        "l = 2 m). The paper did it outdoors with a robot of its own, once each. Here it is simulated, on a course of "
        "the same slopes and roughness whose lengths are ours (30.8 m at 0.5 m/s).",
        sizes=f"{count(walks)} walks of each controller, ideal and disturbed, seed {seed}: walks drawn from seeds "
        f"{seeds[0]} to {seeds[-1]}. "
        + (
            f"Other look-aheads: {count(FAST_RIVAL_WALKS)} ideal walk each, the best fixed one from an earlier full "
            f"run, chosen on seeds {CHOOSING_SEEDS[0]} and {CHOOSING_SEEDS[1]}."
            if fast
            else f"Other look-aheads walk as often, the best fixed one is chosen on seeds {CHOOSING_SEEDS[0]} and "
            f"{CHOOSING_SEEDS[1]}."
        ),
        seed=seed,
        fast=fast,
        groups=(
            *(number_group(condition, measured) for condition in CONDITIONS),
            order_group(measured),
            honesty_group(measured, scan),
            *scanned,
        ),
        pictures=_pictures(measured, seed),
        errata=(ERRATUM,),
    )


def _pictures(measured: Measured, seed: int) -> tuple[Picture, ...]:
    three = {condition: {name: measured[condition, name] for name in NAMES} for condition in CONDITIONS}
    everything = {
        condition: {name: measured[condition, name] for name in (*NAMES, *RIVALS) if (condition, name) in measured}
        for condition in CONDITIONS
    }
    errors, etas = render_png(partial(draw_errors, three)), render_png(partial(draw_etas, everything))
    assert errors is not None
    assert etas is not None
    return (
        Picture(
            "errors",
            "Distance to the path over time of FpMW, FpM and pMW, undisturbed above, disturbed below.",
            f"The walks of seed {held_out_seeds(1, seed)[0]}. It grows where bends begin and end. A cross: a fall.",
            errors,
        ),
        Picture(
            "eta",
            "Mean error of each walk by controller and by rival look-ahead, with means and intervals.",
            "A dot for each walk, hollow where it fell; above it the mean over the seeds and its 95 % interval. The "
            "rivals below the three controllers have MPC and whole-body control.",
            etas,
        ),
    )
