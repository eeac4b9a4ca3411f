from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import apply_transform
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass
from quadlog.pipelines.tables.following import lidar_scores as lidar_scoring
from quadlog.pipelines.tables.following.lidar_scores import (
    FRONT,
    HELD_OUT_SEED,
    PLACES,
    WALLED,
    found_cells,
    in_front,
    score_place,
    true_cells,
)
from quadlog.simulation.synthetic import labelled_scans as places
from quadlog.simulation.synthetic.labelled_scans import is_true_obstacle, labelled_scans


@pytest.fixture(scope="module")
def corridor():
    return next(labelled_scans("corridor", HELD_OUT_SEED, 1))


def test_every_place_of_the_table_can_be_drawn_and_none_is_left_out():
    assert set(PLACES) == set(places.PLACES)
    assert set(WALLED) <= set(PLACES)


def test_only_valid_points_in_front_are_judged(corridor):
    judged = in_front(corridor)
    x_m = corridor.xyz_lidar_m[:, 0]
    range_m = np.linalg.norm(corridor.xyz_lidar_m, axis=1)
    np.testing.assert_array_equal(judged, (x_m >= 0) & (range_m >= 0.3) & (range_m <= 30.0))
    assert 0.3 < judged.mean() < 0.7


def test_true_cells_are_those_of_the_labelled_scan_in_the_front_half_of_the_window(corridor):
    rows, cols = np.nonzero(true_cells(corridor))
    got = {(col, row - 100) for col, row in zip(cols.tolist(), rows.tolist(), strict=True)}
    seen_m = apply_transform(corridor.transform_lidar_to_base, corridor.xyz_lidar_m[is_true_obstacle(corridor)])
    listed = np.floor(seen_m[:, :2] / 0.1).astype(int).tolist()
    assert got == {(col, row) for col, row in listed if 0 <= col < 100 and -100 <= row < 100}
    assert len(got) > 50
    assert FRONT.shape == (200, 100)


def test_the_truth_itself_scores_without_a_fault(corridor, monkeypatch):
    def told(scan):
        xyz_base_m = scan.xyz_lidar_m @ scan.transform_lidar_to_base[:3, :3].T + scan.transform_lidar_to_base[:3, 3]
        height_m = np.nan_to_num(scan.height_m)
        blocking = (scan.truth == PointClass.OBSTACLE) & (height_m >= 0.05) & (height_m <= 1.5)
        label = np.where((scan.truth == PointClass.OBSTACLE) & ~blocking, PointClass.CROPPED, scan.truth)
        lifted_m = np.column_stack([xyz_base_m[:, :2], np.where(blocking, 0.5, 0.0)])
        return ClassifiedScan(lifted_m, label.astype(np.uint8), None, lifted_m[:, 2], "told")

    made = told(corridor)
    np.testing.assert_array_equal(found_cells(made), true_cells(corridor))
    monkeypatch.setattr(lidar_scoring, "METHODS", {"told": told})
    (score,) = score_place("forest", 1, 0)
    assert (score.ground[0].precision, score.ground[0].recall) == (1.0, 1.0)
    assert (score.cells[0].precision, score.cells[0].recall) == (1.0, 1.0)
    assert score.outliers[0].recall == 1.0


def test_the_scans_are_held_out_and_follow_the_seed(monkeypatch):
    drawn = []

    def watched(place, seed, n):
        drawn.append((place, seed, n))
        return labelled_scans(place, seed, n)

    monkeypatch.setattr(lidar_scoring, "labelled_scans", watched)
    score_place("corridor", 1, 3)
    assert drawn == [("corridor", 1003, 1)]
