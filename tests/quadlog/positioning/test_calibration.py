from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.positioning.anchor_bias import AnchorBias, estimate_anchor_bias, track_epochs
from quadlog.positioning.epochs import Epochs

BIAS_M = np.array([0.25, 0.0, 0.1, 0.18])


def estimate(lab, simulated, anchors_m: Float) -> AnchorBias:
    epochs = Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m)
    return estimate_anchor_bias(epochs, anchors_m, lab.TAG_HEIGHT_M, 0.1, 1.0)


def test_biases_are_found_without_truth(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 1, duration_s=60, bias_m=BIAS_M)
    got = estimate(lab, simulated, lab.SQUARE_M)
    np.testing.assert_allclose(got.bias_m, BIAS_M, atol=0.04)
    assert got.significant.all()
    np.testing.assert_array_equal(got.applied_m, got.bias_m)
    np.testing.assert_array_equal(got.n, 3000)


def test_links_are_corrected_together_or_not_at_all(lab):
    """A short log under the same biases: they cannot be told from the place, and none is applied."""
    short = estimate(lab, lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, 1, duration_s=3), lab.TRIANGLE_M)
    assert short.std_m.max() > 0.06
    assert not short.significant.any()
    np.testing.assert_array_equal(short.applied_m, 0)
    walk = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, 0, bias_m=np.array([0.3, 0.1, 0.2]))
    one_known = estimate(lab, walk, lab.TRIANGLE_M)
    assert one_known.bias_m[0] > 3 * one_known.std_m[0]
    assert one_known.std_m[0] < 0.05 < 0.1 < one_known.std_m[1]
    assert not one_known.significant.any()


def test_a_link_hardly_heard_does_not_keep_the_others_from_being_corrected(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 1, duration_s=60, bias_m=BIAS_M)
    simulated.range_m[2:, 3] = np.nan
    got = estimate(lab, simulated, lab.SQUARE_M)
    np.testing.assert_array_equal(got.significant, [True, True, True, False])
    assert got.applied_m[3] == 0


@pytest.mark.parametrize(
    ("layout", "bursts", "low", "high"), [("square", False, 0.4, 0.9), ("triangle", True, 0.6, 1.3)]
)
def test_std_is_the_scatter_over_many_logs(lab, layout, bursts, low, high):
    """White noise: a little cautious. Bursts: late ranges that pass for a bias are in it."""
    anchors_m = lab.SQUARE_M if layout == "square" else lab.TRIANGLE_M
    bias_m = BIAS_M[: len(anchors_m)]
    found = [
        estimate(
            lab,
            lab.simulate(lab.walk_figure_eight, anchors_m, s, duration_s=30, rate_hz=10, bias_m=bias_m, bursts=bursts),
            anchors_m,
        )
        for s in range(16)
    ]
    z = np.array([(each.bias_m - bias_m) / each.std_m for each in found])
    assert low < np.sqrt(np.mean(z**2)) < high


def test_a_short_walk_through_bursts_is_not_corrected(lab):
    """Seeds at which a track bent by its own wrong biases once seemed to tell them well, and tripled its error."""
    for seed in (39, 60, 72, 85):
        simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, seed, bursts=True)
        got = estimate(lab, simulated, lab.TRIANGLE_M)
        assert not got.significant.any()
        assert (np.abs(got.bias_m) < 4 * got.std_m).all()


def test_a_height_that_is_not_known_is_not_mistaken_for_a_bias(lab):
    """Six anchors at three heights, and a tag carried 0.35 m higher than it was written down, up and down."""
    anchors_m = np.array([(0, 0, 0.3), (8, 0, 2.5), (8, 7, 0.3), (0, 7, 2.5), (4, -1, 1.4), (4, 8, 2.6)], dtype=float)
    bias_m = np.array([0.25, 0.0, 0.1, 0.18, 0.3, 0.05])
    t_s = np.arange(600) / 10
    height_m = 1.35 + 0.3 * np.sin(2 * np.pi * t_s / 13)
    place_m = np.column_stack([lab.walk_figure_eight(t_s), height_m])
    range_m = np.linalg.norm(place_m[:, None] - anchors_m, axis=2) + bias_m
    range_m += 0.1 * np.random.default_rng(0).standard_normal(range_m.shape)
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    xyz_m, free_axes = track_epochs(Epochs(t_ns, t_ns, range_m - bias_m), anchors_m, 1.0, 0.1, 1.0, 0.5)
    assert free_axes == 3
    np.testing.assert_allclose(xyz_m, place_m, atol=0.3)
    held, free = (
        estimate_anchor_bias(Epochs(t_ns, t_ns, range_m), anchors_m, 1.0, 0.1, 1.0, std_m) for std_m in (0.0, 0.5)
    )
    assert np.abs(held.bias_m - bias_m).max() > 0.08
    np.testing.assert_allclose(free.bias_m, bias_m, atol=0.05)
    assert (np.abs(free.bias_m - bias_m) < 3.5 * free.std_m).all()
    assert free.significant.all()


def test_biases_do_not_depend_on_the_order_of_anchors(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 6, duration_s=30, rate_hz=10, bias_m=BIAS_M)
    straight = estimate(lab, simulated, lab.SQUARE_M)
    order = np.array([2, 0, 3, 1])
    simulated.range_m[:] = simulated.range_m[:, order]
    mixed = estimate(lab, simulated, lab.SQUARE_M[order])
    np.testing.assert_allclose(mixed.bias_m, straight.bias_m[order], atol=1e-3)
    np.testing.assert_allclose(mixed.std_m, straight.std_m[order], rtol=0.02)


def test_late_ranges_do_not_pass_for_a_bias(lab):
    """Three anchors, bursts, no bias: applying a bias that is not there would ruin the track."""
    for seed in range(8):
        simulated = lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, seed, duration_s=30, rate_hz=20, bursts=True)
        got = estimate(lab, simulated, lab.TRIANGLE_M)
        assert np.abs(got.applied_m).max() < 0.25


def test_a_standing_tag_shows_no_bias(lab):
    simulated = lab.simulate(
        lambda t_s: np.tile([2.0, 3.0], (len(t_s), 1)), lab.TRIANGLE_M, 3, bias_m=np.array([0.3, 0.1, 0.0])
    )
    got = estimate(lab, simulated, lab.TRIANGLE_M)
    assert not got.significant.any()
    assert got.std_m.min() > 0.05


def test_an_anchor_never_heard_and_an_empty_log(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 4, duration_s=30, rate_hz=20)
    simulated.range_m[:, 1] = np.nan
    got = estimate(lab, simulated, lab.SQUARE_M)
    assert got.n[1] == 0
    assert got.bias_m[1] == pytest.approx(0)
    assert got.std_m[1] == pytest.approx(0.2, abs=0.001)
    none = np.empty(0, dtype=np.int64)
    empty = estimate_anchor_bias(Epochs(none, none, np.empty((0, 4))), lab.SQUARE_M, 0.6, 0.1, 1.0)
    assert not empty.significant.any()
