"""Both lidar chains on the same labelled scans: what each makes of points and of cells, scan by scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import apply_transform
from quadlog.lidar.classify import ClassifiedScan
from quadlog.lidar.deskew import Slots
from quadlog.lidar.ground import is_level
from quadlog.lidar.paper import PaperSettings, classify_scan_paper
from quadlog.lidar.points import in_field_of_view, valid_points
from quadlog.lidar.range_image import RangeImageSettings, classify_scan_range_image
from quadlog.lidar.returns import ClassifiedReturns
from quadlog.mapping.compact import CompactSettings, ScanCompactor
from quadlog.mapping.obstacles import ObstacleSettings
from quadlog.mapping.occupancy import Grid
from quadlog.mapping.placing import NO_TOP, ScanPlacer
from quadlog.mapping.window import Window
from quadlog.messages import Float
from quadlog.metrics.perception import Detection, detect, ground_detection, outlier_detection
from quadlog.simulation.labelled_scans import LabelledScan, is_true_obstacle, labelled_scans

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
"""Places of quadlog.simulation.places, and what the table calls them."""
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
class Score:
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


def score_all(n_scans: int, seed: int) -> list[Score]:
    """Scores of the first n_scans of every place: place by place, and method by method on the same scans."""
    return [score for place in PLACES for score in score_place(place, n_scans, seed)]


def score_place(place: str, n_scans: int, seed: int) -> list[Score]:
    """Scores of all methods that are tried in one place."""
    methods = METHODS | ({UNCROPPED: paper_uncropped} if place in WALLED else {})
    scored: dict[str, list[tuple[Detection, Detection, Detection, bool]]] = {name: [] for name in methods}
    for scan in labelled_scans(place, HELD_OUT_SEED + seed, n_scans):
        for name, method in methods.items():
            scored[name].append(_score(scan, method(scan)))
    scores = []
    for name, scans in scored.items():
        ground, outliers, cells, steep = zip(*scans, strict=True)
        scores.append(Score(place, name, seed, ground, outliers, cells, sum(steep)))
    return scores


def in_front(scan: LabelledScan) -> NDArray[np.bool_]:
    """The points (N,) that are judged: those that the paper's chain looks at."""
    valid = valid_points(scan.xyz_lidar_m, PAPER.min_range_m, PAPER.max_range_m)
    xyz_base_m = apply_transform(scan.transform_lidar_to_base, scan.xyz_lidar_m.astype(np.float64))
    return valid & in_field_of_view(xyz_base_m, FRONT_DEG)


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
    return ScanPlacer(1, 0.0).place(compact, np.zeros((1, 3)), None, FRONT).top_mm > NO_TOP


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
