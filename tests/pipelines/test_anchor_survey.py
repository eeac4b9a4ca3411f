from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import RangeSeries
from quadlog.pipelines.stages.positions.check_anchors import check_located, fault_warnings
from quadlog.positioning.anchor_survey import AnchorShift, SurveyFaults
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate

ANCHORS_M = np.array([[0.0, 0, 1.2], [9, 0.5, 1.2], [8, 7, 1.2], [-0.5, 6, 1.2], [4, -2, 1.2], [3, 9, 1.2]])
IDS = np.array([10, 11, 12, 13, 14, 15])


def walk_log(seed: int = 0) -> RangeSeries:
    """40 s of ranges to where the anchors truly stand."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(800) / 20
    phase = 2 * np.pi * t_s / 30
    tag_m = np.column_stack([4 + 2.5 * np.sin(phase), 3.5 + 1.8 * np.sin(2 * phase), np.full(800, 0.6)])
    range_m = np.linalg.norm(tag_m[:, None] - ANCHORS_M, axis=2) + 0.05 * rng.standard_normal((800, 6))
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    return RangeSeries(np.repeat(t_ns, 6), np.zeros(4800, np.int64), np.tile(IDS, 800), range_m.reshape(-1))


def warnings_with(anchors_m: np.ndarray) -> list[str]:
    anchors, settings = Anchors(IDS, anchors_m, np.zeros(6)), LocateSettings()
    located = locate(walk_log(), anchors, [TagInfo(0, 0.6)], settings)
    return fault_warnings(check_located(located, anchors, settings, {}, None), anchors)


def test_a_right_survey_raises_nothing() -> None:
    assert warnings_with(ANCHORS_M) == []


def test_swapped_anchors_are_named_by_their_ids() -> None:
    swapped_m = ANCHORS_M[[0, 4, 2, 3, 1, 5]]
    assert warnings_with(swapped_m) == ["anchors 11 and 14 seem to be swapped in [[uwb.anchors]]"]


def test_a_displaced_anchor_is_named_with_the_place_it_seems_to_stand_at() -> None:
    moved_m = ANCHORS_M.copy()
    moved_m[2, :2] += [0.9, -0.6]
    text = warnings_with(moved_m)[0]
    assert text.startswith("anchor 12 seems to stand at x_m = ")
    x_m, y_m = (float(word.split(",")[0]) for word in text.split(" = ")[1:3])
    assert (x_m, y_m) == pytest.approx((8.0, 7.0), abs=0.15)


def test_alternatives_are_said_to_be_such() -> None:
    anchors = Anchors(IDS, ANCHORS_M, np.zeros(6))
    shifted = AnchorShift(3, np.array([0.3, 0.4]), 0.01 * np.eye(2), 60.0)
    texts = fault_warnings(SurveyFaults(((0, 5),), (2,), (shifted,)), anchors)
    assert len(texts) == 4
    assert "anchors 10 and 15" in texts[0]
    assert "turned around by 2" in texts[1]
    assert "0.50 +- 0.10 m" in texts[2]
    assert "cannot distinguish" in texts[3]
