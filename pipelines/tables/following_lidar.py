"""The table following-lidar: ground, outliers and obstacle cells of the paper's chain and of the default one."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.lidar_figures import (
    cell_group,
    crop_group,
    ground_group,
    outlier_group,
    pooled,
)
from quadlog.pipelines.tables.lidar_pictures import draw_measures, draw_scans
from quadlog.pipelines.tables.lidar_scoring import HELD_OUT_SEED, PLACES, UNCROPPED, Score, score_all
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png

FULL_SCANS, FAST_SCANS = 60, 8


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast takes fewer scans of every place."""
    n_scans = FAST_SCANS if fast else FULL_SCANS
    scores = score_all(n_scans, seed)
    return PaperTable(
        name="following-lidar",
        title="Ground, outliers and obstacles of a 16-beam scan [Following]",
        caption="The paper prints pictures of its lidar chain and no number. Here both chains get the same simulated "
        "scans, in which the class of every point is known: `paper` as published (front half, statistical outliers, "
        "the largest plane is the ground), and `range_image`, quadlog's default, which gets the whole scan. Only the "
        "front half is judged, for both. Neither is told how the gait tilts the body in every other scan.",
        sizes=f"{count(n_scans)} scans of each of {len(PLACES)} places, every one with a layout and a pose of its own, "
        f"seed {seed}: scans drawn from seed {HELD_OUT_SEED + seed}, constants chosen on seed 100.",
        seed=seed,
        fast=fast,
        groups=(ground_group(scores), outlier_group(scores), cell_group(scores), crop_group(scores)),
        pictures=_pictures(scores, seed),
        errata=(_wall_erratum(scores),),
    )


def _wall_erratum(scores: list[Score]) -> str:
    ground = {(score.place, score.method): pooled(score.ground) for score in scores}
    ahead, beside = ((ground[place, "paper"], ground[place, UNCROPPED]) for place in ("wall_ahead", "corridor"))
    return (
        "Near a wall the largest plane of the front half is the wall, not the floor, and the wall leaves the map. Of "
        f"the points that the published chain calls ground, {_percent(ahead[0].precision)} are ground with a wall "
        f"ahead and {_percent(beside[0].precision)} in a 2 m corridor. The crop to 180° does it with a wall ahead "
        f"({_percent(ahead[1].precision)} without it), not in the corridor ({_percent(beside[1].precision)})."
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _pictures(scores: list[Score], seed: int) -> tuple[Picture, ...]:
    measures, scans = render_png(partial(draw_measures, scores)), render_png(partial(draw_scans, seed))
    assert measures is not None
    assert scans is not None
    return (
        Picture(
            "measures",
            "Bars of both methods by place: ground precision and recall, outliers found, inliers lost, obstacle cells "
            "found, false cells.",
            "Both methods in every place, with 95 % intervals. More is better but for inliers lost and false cells, "
            "whose scale is logarithmic above one.",
            measures,
        ),
        Picture(
            "scans",
            "Two scans from above, in a corridor and before a wall, coloured by true class and as each method has it.",
            "The first scan of the corridor and of the wall ahead. The published chain paints the nearest wall in the "
            "colour of the ground, and leaves out what lies behind the robot.",
            scans,
        ),
    )
