from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.messages import RangeSeries
from quadlog.positioning.locate import Anchors, Located, LocateSettings, TagInfo, locate

TAG = TagInfo(0, 0.6)


def anchors(position_m, first_id: int = 0) -> Anchors:
    return Anchors(np.arange(len(position_m)) + first_id, position_m, np.zeros(len(position_m)))


def join(*parts: RangeSeries) -> RangeSeries:
    order = np.argsort(np.concatenate([part.t_ns for part in parts]), kind="stable")
    columns = ("t_ns", "tag", "anchor", "range_m")
    return RangeSeries(*(np.concatenate([getattr(part, name) for part in parts])[order] for name in columns))


def fixes_rmse(lab, located: Located, truth, i: int = 0) -> float:
    tag = located.tags[i]
    solved = tag.fixes.solved
    return lab.rmse(tag.fixes.position_m[solved] - truth(tag.fix_t_ns[solved]))


def test_a_known_bias_is_taken_out_and_comes_back_in_the_prediction(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 1, bias_m=0.4)
    known = replace(anchors(lab.SQUARE_M), known_bias_m=np.full(4, 0.4))
    got = locate(simulated.series, known, [TAG], LocateSettings(calibrate=False))
    assert fixes_rmse(lab, got, simulated.truth_at) < 0.12
    assert np.abs(np.median(got.tags[0].ranges.range_m - got.tags[0].ranges.predicted_m)) < 0.03


def test_tags_are_kept_apart_and_anchors_may_come_in_any_order(lab):
    one = lab.simulate(lab.walk_straight, lab.SQUARE_M, 2)
    other = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 3)
    moved = replace(other.series, tag=np.full(len(other.series), 9), t_ns=other.series.t_ns + 3_000_000)
    together = locate(join(one.series, moved), anchors(lab.SQUARE_M), [TAG, TagInfo(9, 0.6)], LocateSettings())
    alone = locate(one.series, anchors(lab.SQUARE_M), [TAG], LocateSettings())
    order = np.array([3, 1, 0, 2])
    mixed = locate(one.series, Anchors(order, lab.SQUARE_M[order], np.zeros(4)), [TAG], LocateSettings())
    np.testing.assert_allclose(mixed.tags[0].track.position_m, alone.tags[0].track.position_m, atol=1e-4)
    np.testing.assert_array_equal(together.tags[0].track.position_m, alone.tags[0].track.position_m)
    np.testing.assert_array_equal(together.tags[0].fixes.position_m, alone.tags[0].fixes.position_m)
    assert together.tags[1].tag == 9


@pytest.mark.parametrize(("cut_s", "calibrate"), [(2.0, False), (7.3, True)])
def test_causal_tracks_and_fixes_do_not_see_the_future(lab, cut_s, calibrate):
    """Biases too are as they were known then: fixes of the first seconds are not corrected by what the rest shows."""
    simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, 5, rate_hz=10, bias_m=0.3, bursts=True)
    cut = int((simulated.series.t_ns < simulated.t_ns[0] + cut_s * 1e9).sum())
    begun = RangeSeries(*(getattr(simulated.series, name)[:cut] for name in ("t_ns", "tag", "anchor", "range_m")))
    settings = LocateSettings(calibrate=calibrate, smooth=False)
    whole, part = (locate(each, anchors(lab.TRIANGLE_M), [TAG], settings).tags[0] for each in (simulated.series, begun))
    np.testing.assert_array_equal(part.track.position_m, whole.track.position_m[: len(part.track)])
    np.testing.assert_allclose(part.fixes.position_m, whole.fixes.position_m[: len(part.fixes.position_m)], atol=1e-9)


def test_a_tag_that_appears_half_way_and_one_that_never_does(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 6)
    late = replace(simulated.series, tag=np.where(simulated.series.t_ns > simulated.t_ns[300], 4, 0))
    got = locate(late, anchors(lab.SQUARE_M), [TagInfo(4, 0.6), TagInfo(5, 0.6)], LocateSettings())
    assert got.tags[0].track.t_ns[0] == simulated.t_ns[301]
    assert len(got.tags[1].track) == len(got.tags[1].fix_t_ns) == 0
    assert got.counts.other_tags == ((0, 301 * 4),)


def test_epochs_without_a_fix_are_counted_by_cause(lab):
    simulated = lab.simulate(lab.walk_straight, np.vstack([lab.SQUARE_M, [[4.0, 0.0, 1.2]]]), 7)
    range_m = simulated.range_m.copy()
    range_m[10:15, 2:] = 0.0
    range_m[20:22, 2:4] = np.nan
    series = replace(simulated.series, range_m=range_m.ravel())
    five = anchors(np.vstack([lab.SQUARE_M, [[4.0, 0.0, 1.2]]]))
    got = locate(series, five, [TAG], LocateSettings(epoch_s=0.001))
    assert (got.tags[0].n_too_few, got.tags[0].n_degenerate, got.tags[0].n_untracked) == (5, 2, 0)
    assert got.counts.not_positive == 15
    assert got.counts.not_finite == 4
