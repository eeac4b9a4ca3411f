from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadlog.config.schema import Config
from quadlog.messages import PoseSeries, RangeSeries
from quadlog.pipelines.stages.positions.uwb_tags import dilution_of, errors_of_tags
from quadlog.positioning.locate import Anchors, Located, LocateSettings, TagInfo, locate

ANCHORS_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [8.0, 7.0, 1.2], [0.0, 7.0, 1.2], [50.0, 50.0, 1.2]])
SETTINGS = LocateSettings(calibrate=False)


def walk(seed: int, tags: tuple[int, ...] = (0,)) -> tuple[Located, PoseSeries]:
    """Ranges of tags at the origin of a robot that stands, and its true poses over the middle of the log."""
    rng = np.random.default_rng(seed)
    t_ns = 1_700_000_000_000_000_000 + np.arange(400, dtype=np.int64) * 20_000_000
    true_m = np.linalg.norm(np.array([3.0, 3.0, 0.6]) - ANCHORS_M[:4], axis=1)
    columns = [
        RangeSeries(np.repeat(t_ns, 4), np.full(1600, tag), np.tile(np.arange(4), 400), np.empty(0)) for tag in tags
    ]
    series = RangeSeries(
        *(np.concatenate([getattr(each, name) for each in columns]) for name in ("t_ns", "tag", "anchor")),
        np.tile(true_m, 400 * len(tags)) + 0.1 * rng.standard_normal(1600 * len(tags)),
    )
    order = np.argsort(series.t_ns, kind="stable")
    series = RangeSeries(*(getattr(series, name)[order] for name in ("t_ns", "tag", "anchor", "range_m")))
    anchors = Anchors(np.arange(5), ANCHORS_M, np.zeros(5))
    located = locate(series, anchors, [TagInfo(tag, 0.6) for tag in tags], SETTINGS)
    known_ns = t_ns[100:300]
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    return located, PoseSeries(known_ns, np.tile([3.0, 3.0, 0.3], (200, 1)), quat)


def test_errors_are_those_of_instants_with_a_truth():
    located, reference = walk(0)
    errors = errors_of_tags(located, {0: (0.0, 0.0)}, reference)[0]
    fixes = located.tags[0].fixes
    assert len(errors["fixes"].t_ns) == 200
    assert (errors["fixes"].t_ns[0], errors["fixes"].t_ns[-1]) == (reference.t_ns[0], reference.t_ns[-1])
    assert_allclose(errors["fixes"].error_m, fixes.position_m[100:300] - 3.0)
    assert_allclose(errors["fixes"].distance_m, np.hypot(*errors["fixes"].error_m.T))
    assert len(errors["track"].t_ns) == 200


def test_white_noise_stays_within_the_claimed_bound():
    """19 in 20 fixes; the track of a robot that stands is one long error, so it is only asked to be smaller."""
    inside, sharper = [], []
    for seed in range(5):
        located, reference = walk(seed)
        errors = errors_of_tags(located, {0: (0.0, 0.0)}, reference)[0]
        inside.append(np.mean(errors["fixes"].distance_m <= errors["fixes"].bound_m))
        sharper.append(np.median(errors["track"].bound_m) < np.median(errors["fixes"].bound_m))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert all(sharper)


def test_only_tags_on_the_robot_have_errors_and_only_with_a_reference():
    located, reference = walk(0, (0, 1))
    assert set(errors_of_tags(located, {1: (0.0, 0.0)}, reference)) == {1}
    assert errors_of_tags(located, {0: (0.0, 0.0)}, None) == {}
    nothing = PoseSeries(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)))
    assert errors_of_tags(located, {0: (0.0, 0.0)}, nothing) == {}


def config() -> Config:
    anchors = [{"id": i, "x_m": x, "y_m": y, "z_m": z} for i, (x, y, z) in enumerate(ANCHORS_M.tolist())]
    return Config.model_validate({"uwb": {"anchors": anchors}})


def test_the_map_rests_on_the_anchors_that_were_heard():
    """Anchor 4 is far away and silent: with it the map would reach to 50 m."""
    located, _ = walk(0)
    grid = dilution_of(located, 0, config(), 40, 40)
    assert grid is not None
    assert grid.tag_height_m == 0.6
    top_m = grid.origin_m + np.array(grid.hdop.shape[::-1]) * grid.cell_m
    assert (top_m < 12).all()


def test_another_tag_stands_in_for_one_that_was_not_heard():
    located, _ = walk(0, (0, 1))
    assert dilution_of(located, 9, config(), 40, 40) is not None
    nobody: Any = SimpleNamespace(tags=())
    assert dilution_of(nobody, 0, config(), 40, 40) is None
