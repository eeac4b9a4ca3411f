from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.metrics.perception import Detection
from quadlog.pipelines.tables.following.lidar_scores import (
    CELL_RECALL,
    FALSE_CELLS,
    GROUND_PRECISION,
    GROUND_RECALL,
    INLIERS_LOST,
    MEASURES,
    METHODS,
    OUTLIERS_FOUND,
    PLACES,
    UNCROPPED,
    WALLED,
    LidarScore,
    cell_group,
    crop_group,
    ground_group,
    outlier_group,
    pooled,
)

GROUND = (Detection(100, 50, 40, 30), Detection(100, 10, 60, 10))
OUTLIERS = (Detection(100, 4, 5, 3), Detection(300, 1, 1, 1))
CELLS = (Detection(1000, 20, 30, 18), Detection(1000, 10, 4, 4))
SCORE = LidarScore("corridor", "paper", 0, GROUND, OUTLIERS, CELLS, 1)


@pytest.mark.parametrize(
    ("measure", "expected"),
    [
        (GROUND_PRECISION, 40 / 100),
        (GROUND_RECALL, 40 / 60),
        (OUTLIERS_FOUND, 4 / 5),
        (INLIERS_LOST, 2 / 395),
        (CELL_RECALL, 22 / 30),
        (FALSE_CELLS, 12 / 2),
    ],
)
def test_a_number_is_that_of_all_scans_together_and_lies_in_its_interval(measure, expected):
    ours, (low, high) = measure.of(SCORE)
    assert ours == pytest.approx(expected, rel=1e-12)
    assert low <= ours <= high
    assert low < high
    assert measure.of(SCORE) == (ours, (low, high))


def test_two_scans_bootstrap_to_their_two_shares():
    _, interval = FALSE_CELLS.of(SCORE)
    assert interval == (0.0, 12.0)
    _, (low, high) = GROUND_RECALL.of(SCORE)
    assert (low, high) == (30 / 50, 10 / 10)


def test_the_seed_draws_the_interval():
    many = replace(SCORE, ground=tuple(Detection(100, 50, 40, n) for n in range(9, 40)))
    one, other = GROUND_RECALL.of(many), GROUND_RECALL.of(replace(many, seed=1))
    assert one[0] == other[0]
    assert one[1] != other[1]


def test_every_place_and_method_has_a_row_for_every_number():
    scores = [replace(SCORE, place=place, method=method) for place in PLACES for method in METHODS]
    rows = [row for group in (ground_group, outlier_group, cell_group) for row in group(scores).rows]
    assert len({row.quantity for row in rows}) == len(rows) == len(PLACES) * len(METHODS) * len(MEASURES)
    for row in rows:
        assert row.paper is None
        assert row.reproduces is None
        assert row.low <= row.ours <= row.high
        assert ("(cells)" in row.quantity) == ("false cells" in row.quantity)


def test_what_is_no_method_of_the_table_is_only_in_the_group_of_the_crop():
    scores = [replace(SCORE, place=place, method=name) for place in WALLED for name in (*METHODS, UNCROPPED)]
    for group in (ground_group, outlier_group, cell_group):
        assert not any(UNCROPPED in row.quantity for row in group(scores).rows)
    rows = {row.quantity: row for row in crop_group(scores).rows}
    assert not any(name.endswith("range_image") for name in rows)
    walls = rows[f"wall ahead: share of planes that are walls (1), {UNCROPPED}"]
    assert walls.ours == 0.5
    assert "1 of 2" in walls.note


def test_notes_say_why_a_plane_fails():
    rows = {row.quantity: row.note for row in ground_group([SCORE, replace(SCORE, method="range_image")]).rows}
    assert "1 of 2 scans" in rows["2 m corridor: ground recall (1), paper"]
    assert rows["2 m corridor: ground recall (1), range_image"] == ""
    (ramp, _) = ground_group([replace(SCORE, place="ramp_20", n_steep=0)]).rows
    assert "ramp" in ramp.note
    (flat, _) = ground_group([replace(SCORE, place="flat", n_steep=0)]).rows
    assert flat.note == ""


def test_pooling_adds_every_count():
    assert pooled(GROUND) == Detection(200, 60, 100, 40)
    assert pooled(()) == Detection(0, 0, 0, 0)
    assert np.isnan(pooled(()).recall)
