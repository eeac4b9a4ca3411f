"""Both lidar chains on the same labelled scans: what each makes of points and of cells, scan by scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import apply_transform
from quadlog.lidar.classified_scan import ClassifiedReturns, ClassifiedScan, in_field_of_view, valid_points
from quadlog.lidar.deskew import Slots
from quadlog.lidar.paper_method import PaperSettings, classify_scan_paper
from quadlog.lidar.range_image_method import RangeImageSettings, classify_scan_range_image
from quadlog.lidar.ransac_plane import is_level
from quadlog.mapping.compact import CompactSettings, ObstacleSettings, ScanCompactor
from quadlog.mapping.grid import Grid, Window
from quadlog.mapping.placing import NO_TOP, ScanPlacer
from quadlog.messages import Float
from quadlog.metrics.intervals import Interval
from quadlog.metrics.perception import Detection, detect, ground_detection, outlier_detection
from quadlog.pipelines.tables.intervals import bootstrap_ratio, share_interval
from quadlog.results.papers.table import PaperRow, RowGroup
from quadlog.simulation.synthetic.labelled_scans import SCANS_LIDAR, LabelledScan, is_true_obstacle, labelled_scans

HELD_OUT_SEED = 1000
"""Seeds of the table start here; the chains' constants were chosen on seed 100."""
PLACES = {
    "flat": "flat",
    "undulating": "undulating ±6 cm",
    "ramp_15": "15° ramp ahead",
    "ramp_20": "20° ramp ahead",
    "slope_15": "15° slope",
    "slope_20": "20° slope",
    "corridor": "2 m corridor",
    "wall_ahead": "wall ahead",
    "forest": "forest",
}
"""Places of quadlog.simulation.synthetic.labelled_scans, and what the table calls them."""
FRONT_DEG = 180.0
PAPER = PaperSettings(field_of_view_deg=FRONT_DEG)
RANGE_IMAGE = RangeImageSettings(min_range_m=PAPER.min_range_m, max_range_m=PAPER.max_range_m)
BLOCKING = ObstacleSettings()
CELL_M, WINDOW_CELLS = 0.1, 200
# The front half of the robot's window, in base.
FRONT = Window(0, -WINDOW_CELLS // 2, CELL_M, (WINDOW_CELLS, WINDOW_CELLS // 2))


def paper(scan: LabelledScan) -> ClassifiedScan:
    """The chain as published: the front half is all it looks at."""
    return classify_scan_paper(scan.xyz_lidar_m, scan.transform_lidar_to_base, PAPER, seed=0)


def paper_uncropped(scan: LabelledScan) -> ClassifiedScan:
    """The published filter and plane on the whole scan."""
    whole = PaperSettings(field_of_view_deg=360.0)
    return classify_scan_paper(scan.xyz_lidar_m, scan.transform_lidar_to_base, whole, seed=0)


def range_image(scan: LabelledScan) -> ClassifiedScan:
    """The default chain: the whole scan, by its rings."""
    return classify_scan_range_image(scan.xyz_lidar_m, scan.ring, scan.transform_lidar_to_base, RANGE_IMAGE)


Method = Callable[[LabelledScan], ClassifiedScan]
METHODS: dict[str, Method] = {"paper": paper, "range_image": range_image}
UNCROPPED = "paper without the crop"
WALLED = ("corridor", "wall_ahead")
"""Where the crop decides, so that the paper's plane is also fitted to the whole scan."""


@dataclass(frozen=True, slots=True)
class LidarScore:
    """What one method makes of one place, one Detection per scan.

    n_steep: scans whose plane nobody could stand on. seed: of the table, from
    which intervals draw too.
    """

    place: str
    method: str
    seed: int
    ground: tuple[Detection, ...]
    outliers: tuple[Detection, ...]
    cells: tuple[Detection, ...]
    n_steep: int


def score_all(n_scans: int, seed: int) -> list[LidarScore]:
    """Scores of the first n_scans of every place: place by place, and method by method on the same scans."""
    return [score for place in PLACES for score in score_place(place, n_scans, seed)]


def score_place(place: str, n_scans: int, seed: int) -> list[LidarScore]:
    """Scores of all methods that are tried in one place."""
    methods = METHODS | ({UNCROPPED: paper_uncropped} if place in WALLED else {})
    scored: dict[str, list[tuple[Detection, Detection, Detection, bool]]] = {name: [] for name in methods}
    for scan in labelled_scans(place, HELD_OUT_SEED + seed, n_scans):
        for name, method in methods.items():
            scored[name].append(_score(scan, method(scan)))
    scores = []
    for name, scans in scored.items():
        ground, outliers, cells, steep = zip(*scans, strict=True)
        scores.append(LidarScore(place, name, seed, ground, outliers, cells, sum(steep)))
    return scores


def in_front(scan: LabelledScan) -> NDArray[np.bool_]:
    """The points (N,) that are judged: those that the paper's chain looks at."""
    valid = valid_points(scan.xyz_lidar_m, PAPER.min_range_m, PAPER.max_range_m)
    xyz_base_m = apply_transform(scan.transform_lidar_to_base, scan.xyz_lidar_m.astype(np.float64))
    return valid & in_field_of_view(xyz_base_m[:, 0], xyz_base_m[:, 1], FRONT_DEG)


def true_cells(scan: LabelledScan) -> Grid:
    """The cells of FRONT that hold a return of an obstacle within the heights that block."""
    blocks = is_true_obstacle(scan, BLOCKING.min_height_m, BLOCKING.max_height_m)
    xyz_base_m = apply_transform(scan.transform_lidar_to_base, scan.xyz_lidar_m[blocks].astype(np.float64))
    return _occupied(np.column_stack([xyz_base_m[:, :2], scan.height_m[blocks]]))


def found_cells(made: ClassifiedScan) -> Grid:
    """The cells of FRONT that this scan alone would occupy in the map."""
    slots = Slots(np.zeros(1, np.int64), None)
    returns = ClassifiedReturns.of_points(made, np.zeros(3), np.zeros(len(made.label), np.uint8), slots)
    compact = ScanCompactor(CompactSettings(BLOCKING)).compact(returns, 0)
    return ScanPlacer(1, 0.0).place(compact, np.zeros((1, 3)), np.full(2, np.nan), FRONT).top_mm > NO_TOP


def _occupied(points_m: Float) -> Grid:
    cells = FRONT.cell_of(points_m[:, :2])
    occupied = np.zeros(FRONT.shape, np.bool_)
    col, row = cells[FRONT.contains(cells)].T
    occupied[row, col] = True
    return occupied


def _score(scan: LabelledScan, made: ClassifiedScan) -> tuple[Detection, Detection, Detection, bool]:
    judged = in_front(scan)
    truth, label = scan.truth[judged], made.label[judged]
    cells = detect(true_cells(scan), found_cells(made))
    steep = made.ground is not None and not is_level(made.ground)
    return ground_detection(truth, label), outlier_detection(truth, label), cells, steep


@dataclass(frozen=True, slots=True)
class Measure:
    """One number of a score. detections: which ones; part, whole: what is summed over scans, then divided."""

    name: str
    detections: Callable[[LidarScore], tuple[Detection, ...]]
    part: Callable[[Detection], int]
    whole: Callable[[Detection], int]
    unit: str = "1"

    def of(self, score: LidarScore) -> tuple[float, Interval]:
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


def ground_group(scores: list[LidarScore]) -> RowGroup:
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


def outlier_group(scores: list[LidarScore]) -> RowGroup:
    """False points found, and true ones that went with them."""
    text = (
        f"One return in a hundred is false, with a range drawn evenly from {SCANS_LIDAR.min_range_m:g} to "
        f"{SCANS_LIDAR.false_range_m:g} m. Found: share of them removed; some happen to lie on something real, where "
        f"no filter can tell. Lost: share of the true returns that are removed with them. {INTERVALS}"
    )
    rows = [_row(score, measure) for score in _plain(scores) for measure in (OUTLIERS_FOUND, INLIERS_LOST)]
    return RowGroup("Outliers", text, tuple(rows))


def cell_group(scores: list[LidarScore]) -> RowGroup:
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


def crop_group(scores: list[LidarScore]) -> RowGroup:
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


def _plain(scores: list[LidarScore]) -> list[LidarScore]:
    return [score for score in scores if score.method in METHODS]


def _row(score: LidarScore, measure: Measure, note: str = "") -> PaperRow:
    ours, interval = measure.of(score)
    return PaperRow(_quantity(score, measure.name, measure.unit), ours, None, *interval, note=note)


def _quantity(score: LidarScore, what: str, unit: str = "1") -> str:
    return f"{PLACES[score.place]}: {what} ({unit}), {score.method}"


def _ground_note(score: LidarScore) -> str:
    if score.method != "paper":
        return ""
    if score.n_steep:
        return f"In {score.n_steep} of {len(score.ground)} scans the largest plane is a wall."
    return "One plane cannot follow both the floor and the ramp." if score.place.startswith("ramp") else ""


def _cells_note(score: LidarScore) -> str:
    return f"{pooled(score.cells).n_true / len(score.cells):.0f} true cells per scan."
