"""Rows of the table following-lidar: ground, outliers and obstacle cells of both chains, place by place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.perception import Detection
from quadlog.pipelines.tables.judging import Interval, bootstrap_ratio, share_interval
from quadlog.pipelines.tables.lidar_scoring import (
    BLOCKING,
    CELL_M,
    METHODS,
    PLACES,
    UNCROPPED,
    WALLED,
    Score,
)
from quadlog.results.paper_rows import PaperRow, RowGroup
from quadlog.simulation.labelled_scans import SCANS_LIDAR


@dataclass(frozen=True, slots=True)
class Measure:
    """One number of a score. detections: which ones; part, whole: what is summed over scans, then divided."""

    name: str
    detections: Callable[[Score], tuple[Detection, ...]]
    part: Callable[[Detection], int]
    whole: Callable[[Detection], int]
    unit: str = "1"

    def of(self, score: Score) -> tuple[float, Interval]:
        """The number and its 95 % bootstrap interval over the scans; every number of a place draws the same scans."""
        detections = self.detections(score)
        parts, wholes = (self._counts(detections, count) for count in (self.part, self.whole))
        return bootstrap_ratio(parts, wholes, np.random.default_rng([score.seed, 4]))

    @staticmethod
    def _counts(detections: tuple[Detection, ...], count: Callable[[Detection], int]) -> Float:
        return np.array([count(each) for each in detections], dtype=np.float64)


GROUND_PRECISION = Measure("ground precision", lambda s: s.ground, lambda d: d.n_found, lambda d: d.n_called)
GROUND_RECALL = Measure("ground recall", lambda s: s.ground, lambda d: d.n_found, lambda d: d.n_true)
OUTLIERS_FOUND = Measure("outliers found", lambda s: s.outliers, lambda d: d.n_found, lambda d: d.n_true)
INLIERS_LOST = Measure("inliers lost", lambda s: s.outliers, lambda d: d.n_false, lambda d: d.n_all - d.n_true)
CELL_RECALL = Measure("obstacle cells found", lambda s: s.cells, lambda d: d.n_found, lambda d: d.n_true)
FALSE_CELLS = Measure("false cells per scan", lambda s: s.cells, lambda d: d.n_false, lambda _: 1, unit="cells")
MEASURES = (GROUND_PRECISION, GROUND_RECALL, OUTLIERS_FOUND, INLIERS_LOST, CELL_RECALL, FALSE_CELLS)

INTERVALS = "Intervals: bootstrap over the scans."


def ground_group(scores: list[Score]) -> RowGroup:
    """Precision and recall of the points called ground."""
    text = (
        "Precision: share of the points called ground that are. Recall: share of the ground's points that are called "
        f"so. {INTERVALS}"
    )
    rows = [
        _row(score, measure, _ground_note(score))
        for score in _plain(scores)
        for measure in (GROUND_PRECISION, GROUND_RECALL)
    ]
    return RowGroup("Ground", text, tuple(rows))


def outlier_group(scores: list[Score]) -> RowGroup:
    """False points found, and true ones that went with them."""
    text = (
        f"One return in a hundred is false, with a range drawn evenly from {SCANS_LIDAR.min_range_m:g} to "
        f"{SCANS_LIDAR.false_range_m:g} m. Found: share of them removed; some happen to lie on something real, where "
        f"no filter can tell. Lost: share of the true returns that are removed with them. {INTERVALS}"
    )
    rows = [_row(score, measure) for score in _plain(scores) for measure in (OUTLIERS_FOUND, INLIERS_LOST)]
    return RowGroup("Outliers", text, tuple(rows))


def cell_group(scores: list[Score]) -> RowGroup:
    """Cells that the map would hold against those that it should."""
    text = (
        f"Cells of {CELL_M:g} m in the front half of the 20 m window, as the map gets them from one scan. A true cell "
        f"holds at least one return of an obstacle that is {BLOCKING.min_height_m:g} to {BLOCKING.max_height_m:g} m "
        f"above the true ground below it; any other cell is false. {INTERVALS}"
    )
    rows = [
        _row(score, measure, _cells_note(score) if measure is CELL_RECALL else "")
        for score in _plain(scores)
        for measure in (CELL_RECALL, FALSE_CELLS)
    ]
    return RowGroup("Obstacle cells", text, tuple(rows))


def crop_group(scores: list[Score]) -> RowGroup:
    """What the plane of [Following] is near walls, after its crop and without it."""
    rows = []
    for score in scores:
        if score.place in WALLED and score.method in ("paper", UNCROPPED):
            n_scans = len(score.ground)
            share, interval = share_interval(score.n_steep, n_scans)
            note = f"{score.n_steep} of {n_scans} are steeper than 45°."
            rows.append(PaperRow(_quantity(score, "share of planes that are walls"), share, None, *interval, note=note))
            if score.method == UNCROPPED:
                rows += [_row(score, measure) for measure in (GROUND_PRECISION, GROUND_RECALL, CELL_RECALL)]
    text = (
        "The paper keeps the front half of a scan, then takes its largest plane for the ground. Here the same filter "
        "and plane also get the whole scan; what they make of its front half is judged. Shares of planes after "
        f"Wilson. {INTERVALS}"
    )
    return RowGroup("Near walls: what the crop does to the largest plane", text, tuple(rows))


def pooled(detections: tuple[Detection, ...]) -> Detection:
    """The counts of all scans together."""
    total = Detection(0, 0, 0, 0)
    for each in detections:
        total += each
    return total


def _plain(scores: list[Score]) -> list[Score]:
    return [score for score in scores if score.method in METHODS]


def _row(score: Score, measure: Measure, note: str = "") -> PaperRow:
    ours, interval = measure.of(score)
    return PaperRow(_quantity(score, measure.name, measure.unit), ours, None, *interval, note=note)


def _quantity(score: Score, what: str, unit: str = "1") -> str:
    return f"{PLACES[score.place]}: {what} ({unit}), {score.method}"


def _ground_note(score: Score) -> str:
    if score.method != "paper":
        return ""
    if score.n_steep:
        return f"In {score.n_steep} of {len(score.ground)} scans the largest plane is a wall."
    return "One plane cannot follow both the floor and the ramp." if score.place.startswith("ramp") else ""


def _cells_note(score: Score) -> str:
    return f"{pooled(score.cells).n_true / len(score.cells):.0f} true cells per scan."
