from __future__ import annotations

import numpy as np

from quadlog.positioning.robust import (
    WINDOW_S,
    lateness_weights,
    link_medians,
    link_windows,
    persistence,
    symmetric_weights,
)

STD_M = 0.1


def windows_at(rate_hz: float, count: int):
    return link_windows(np.arange(count) / rate_hz, np.zeros(count, dtype=np.int64))


def test_windows_and_medians_are_those_of_a_plain_search():
    rng = np.random.default_rng(0)
    link = np.sort(rng.choice([0, 1, 3], 200))
    t_s = np.concatenate([np.sort(rng.uniform(0, 3, np.count_nonzero(link == each))) for each in (0, 1, 3)])
    residual_m, windows = rng.standard_normal(200), link_windows(t_s, link)
    for row in range(200):
        mine = np.flatnonzero((link == link[row]) & (np.abs(t_s - t_s[row]) <= WINDOW_S / 2))
        np.testing.assert_array_equal(np.arange(windows.first[row], windows.end[row]), mine)
    wanted = [np.median(residual_m[link == each]) if each != 2 else 0.0 for each in range(4)]
    np.testing.assert_allclose(link_medians(residual_m, link), wanted)


def test_white_noise_keeps_its_weight_and_a_burst_loses_it():
    """50 Hz: 30 ranges late by three std, a lateness that single residuals of a whole log would show now and then."""
    residual_m, windows = STD_M * np.random.default_rng(1).standard_normal(500), windows_at(50, 500)
    assert np.median(lateness_weights(windows, residual_m, STD_M)) > 0.9
    residual_m[200:230] += 3 * STD_M
    weight = lateness_weights(windows, residual_m, STD_M)
    assert weight[205:225].max() < 0.1
    assert np.median(weight[:190]) > 0.9


def test_early_ranges_are_trusted_longer_and_one_wild_range_does_not_count_against_its_neighbours():
    late, early = (lateness_weights(windows_at(50, 100), np.full(100, s * 2 * STD_M), STD_M)[50] for s in (1, -1))
    assert late < 0.05
    assert early > 0.85
    residual_m = np.zeros(100)
    residual_m[50] = 30.0
    weight = lateness_weights(windows_at(50, 100), residual_m, STD_M)
    assert weight[50] < 1e-3
    assert np.delete(weight, 50).min() > 0.7


def test_weights_for_biases_are_alike_on_both_sides_of_a_links_median():
    offsets_m = 0.3 + STD_M * np.array([-5.0, -1.0, 0.0, 1.0, 5.0])
    weight = symmetric_weights(offsets_m, np.zeros(5, dtype=np.int64), STD_M)
    np.testing.assert_allclose(weight, weight[::-1])
    assert weight[2] == 1.0
    assert weight[0] < 0.1


def test_persistence_is_how_many_ranges_share_an_error():
    """100 Hz for 60 s: white noise, and errors that are the same for 0.5 s each, which is 50 ranges."""
    rng, t_s, link = np.random.default_rng(2), np.arange(6000) / 100, np.zeros(6000, dtype=np.int64)
    assert persistence(t_s, link, rng.standard_normal(6000), np.ones(6000), 1.0) < 2.0
    lasting = np.repeat(rng.standard_normal(120), 50)
    assert 30 < persistence(t_s, link, lasting, np.ones(6000), 1.0) < 90
