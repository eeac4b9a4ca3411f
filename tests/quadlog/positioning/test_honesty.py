"""Whether 95 % ellipses of tracks hold 95 % of the errors, and whether smoothing is never worse than no smoothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.messages import RangeSeries
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, TagResult, locate

LAYOUTS_M = {
    "four anchors": np.array([[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [8.0, 7.0, 1.2], [0.0, 7.0, 1.2]]),
    "six anchors": np.array(
        [[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [8.0, 7.0, 1.2], [0.0, 7.0, 1.2], [4.0, -1.0, 1.2], [4.0, 8.0, 1.2]]
    ),
}


@pytest.mark.parametrize("layout", LAYOUTS_M)
@pytest.mark.parametrize("smooth", [True, False])
def test_ellipses_hold_errors_that_depend_on_the_place(lab, layout, smooth):
    """Reflections lengthen ranges by what depends on the place, 0.06 m, beside constant biases: no noise shows that."""
    anchors_m, inside, squares = LAYOUTS_M[layout], [], []
    anchors = Anchors(np.arange(len(anchors_m)), anchors_m, np.zeros(len(anchors_m)))
    for seed in range(100, 110 if smooth else 103):
        simulated = lab.simulate(
            lab.walk_figure_eight, anchors_m, seed, duration_s=45, rate_hz=10, std_m=0.05,
            bias_m=np.random.default_rng(seed).uniform(0.05, 0.2, len(anchors_m)),
        )  # fmt: skip
        rng = np.random.default_rng([7, seed])
        waves, phase = rng.normal(0, 1.2, (len(anchors_m), 20, 2)), rng.uniform(0, 6.3, (len(anchors_m), 20))
        field = np.cos(np.einsum("akd,td->tak", waves, simulated.position_m) + phase).sum(axis=2)
        simulated.series.range_m[:] += (0.06 * np.sqrt(2 / 20) * field).ravel()
        got = locate(simulated.series, anchors, [TagInfo(0, lab.TAG_HEIGHT_M)], LocateSettings(smooth=smooth)).tags[0]
        track = got.track
        error_m = track.position_m - simulated.truth_at(track.t_ns)
        inside.append(lab.share_in_ellipses(error_m, track.covariance_m2))
        squares += list(np.einsum("ni,nij,nj->n", error_m, np.linalg.inv(track.covariance_m2), error_m))
    assert 0.8 < np.mean(squares) < 2.6  # of two coordinates; measured 1.0 to 1.9
    assert np.mean(inside) > 0.93
    assert np.min(inside) > 0.75


def cut(trolley, tag: int, begin_s: float, length_s: float) -> RangeSeries:
    series = trolley.series
    since_s = (series.t_ns - series.t_ns[0]) * 1e-9
    keep = (series.tag == tag) & (since_s >= begin_s) & (since_s < begin_s + length_s)
    return RangeSeries(series.t_ns[keep], series.tag[keep], series.anchor[keep], series.range_m[keep])


def locate_trolley(trolley, series: RangeSeries, tag: int, **settings) -> tuple[TagResult, float, float]:
    """The tag, and the RMSE of its fixes and of its track."""
    anchors = Anchors(np.arange(8), trolley.anchors_m, np.zeros(8))
    got = locate(series, anchors, [TagInfo(tag, 0.97)], LocateSettings(**settings)).tags[0]
    solved = got.fixes.solved
    errors = (
        got.fixes.position_m[solved] - trolley.truth_at(tag, got.fix_t_ns[solved]),
        got.track.position_m - trolley.truth_at(tag, got.track.t_ns),
    )
    return got, *(float(np.sqrt((each**2).sum(axis=1).mean())) for each in errors)


@pytest.mark.parametrize("tag", range(3))
def test_ellipses_of_the_trolley_hold_its_errors(lab, trolley, tag):
    """Measured 0.93, 0.99 and 0.99; the first tag's stamps are 0.08 s off, which makes half of its error."""
    got, _, _ = locate_trolley(trolley, cut(trolley, tag, 0.0, np.inf), tag)
    error_m = got.track.position_m - trolley.truth_at(tag, got.track.t_ns)
    assert lab.share_in_ellipses(error_m, got.track.covariance_m2) > 0.88
    assert got.bias.applied.all()


@pytest.mark.parametrize(("length_s", "worst"), [(5.0, 1.25), (10.0, 1.05), (30.0, 0.6)])
def test_windows_are_smoothed_below_their_fixes_without_calibration(trolley, length_s, worst):
    """Biases of 0.08 to 0.31 m are no blocked paths. Measured, means of all windows: 0.57, 0.55 and 0.52 of the fixes'
    RMSE; of 78 windows of 5 s one is worse than its fixes, which happened to be 0.06 m off only."""
    ratios = []
    for tag in range(3):
        for begin_s in np.arange(0.0, 130.0, 3 * length_s):
            series = cut(trolley, tag, begin_s, length_s)
            _, fixes_m, track_m = locate_trolley(trolley, series, tag, calibrate=False)
            ratios.append(track_m / fixes_m)
    assert np.mean(ratios) < 0.7
    assert np.max(ratios) < worst


def test_a_link_that_is_blocked_half_of_the_time_is_not_calibrated_away(lab):
    """0.8 m late for 4 s, on time for 4 s: no constant bias. Measured 0.09 m."""
    simulated = lab.simulate(lab.walk_figure_eight, LAYOUTS_M["six anchors"], 5, duration_s=40, rate_hz=20)
    series = replace(simulated.series, range_m=simulated.series.range_m.copy())
    late = (series.anchor == 2) & (np.floor((series.t_ns - series.t_ns[0]) * 1e-9 / 4) % 2 == 1)
    series.range_m[late] += 0.8
    anchors = Anchors(np.arange(6), LAYOUTS_M["six anchors"], np.zeros(6))
    got = locate(series, anchors, [TagInfo(0, lab.TAG_HEIGHT_M)], LocateSettings()).tags[0]
    assert lab.rmse(got.track.position_m - simulated.truth_at(got.track.t_ns)) < 0.1
    assert np.median(got.ranges.weight[late]) < 0.3
