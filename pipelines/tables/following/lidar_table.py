"""The table following-lidar: every number by place, and pictures of single scans as both chains see them."""

from __future__ import annotations

from quadlog.pipelines.tables.following.lidar_scores import (
    FALSE_CELLS,
    HELD_OUT_SEED,
    MEASURES,
    METHODS,
    PLACES,
    UNCROPPED,
    LidarScore,
    cell_group,
    crop_group,
    ground_group,
    outlier_group,
    pooled,
    score_all,
)
from quadlog.pipelines.tables.pictures import drawn
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperTable, TablePicture
from quadlog.results.view import Panel, Spread, forest, look


def measure_panels(scores: list[LidarScore]) -> list[Panel]:
    """A forest plot for each number: a row for each place and method, with its 95 % interval."""
    panels = []
    for measure in MEASURES:
        rows = {}
        for score in scores:
            if score.method in METHODS:
                value, interval = measure.of(score)
                color = look(list(METHODS).index(score.method))["color"]
                rows[f"{PLACES[score.place]}, {score.method}"] = Spread(value, interval, color=color)
        unit = "cells per scan" if measure is FALSE_CELLS else "share (1)"
        panels.append(forest(f"{measure.name}, {unit}", rows, unit))
    return panels


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
        "front half is judged, for both. Neither knows how the gait tilts the body in every other scan.",
        sizes=f"{count(n_scans)} scans of each of {len(PLACES)} places, every one with a layout and a pose of its own, "
        f"seed {seed}: scans drawn from seed {HELD_OUT_SEED + seed}, constants chosen on seed 100.",
        seed=seed,
        fast=fast,
        groups=(ground_group(scores), outlier_group(scores), cell_group(scores), crop_group(scores)),
        pictures=_pictures(scores),
        errata=(_wall_erratum(scores),),
    )


def _wall_erratum(scores: list[LidarScore]) -> str:
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


def _pictures(scores: list[LidarScore]) -> tuple[TablePicture, ...]:
    return (
        drawn(
            "measures",
            "Both methods by place: ground precision and recall, outliers found, inliers lost, obstacle cells found, "
            "false cells.",
            "Both methods in every place, with 95 % intervals. More is better but for inliers lost and false cells.",
            measure_panels(scores),
        ),
    )
