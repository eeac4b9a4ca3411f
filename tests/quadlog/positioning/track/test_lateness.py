from __future__ import annotations

import numpy as np

from quadlog.positioning.track.rts_smoother import WINDOW_S, link_windows, weigh_lateness

STD_M = 0.1


def test_windows_are_those_of_a_plain_search():
    rng = np.random.default_rng(0)
    t_s, anchor = np.sort(rng.uniform(0, 3, 200)), rng.integers(0, 4, 200)
    windows = link_windows(t_s, anchor)
    for place, row in enumerate(windows.order):
        mine = np.flatnonzero((anchor == anchor[row]) & (np.abs(t_s - t_s[row]) <= WINDOW_S / 2))
        np.testing.assert_array_equal(windows.order[windows.first[place] : windows.end[place]], mine)


def test_white_noise_keeps_its_weight_and_a_burst_loses_it():
    """50 Hz: 30 ranges late by three std, a lateness that single residuals of a whole log would show now and then."""
    rng = np.random.default_rng(1)
    t_s = np.arange(500) / 50
    residual_m = STD_M * rng.standard_normal(500)
    windows = link_windows(t_s, np.zeros(500, dtype=np.int64))
    assert np.median(weigh_lateness(windows, residual_m, STD_M)) > 0.9
    residual_m[200:230] += 3 * STD_M
    weight = weigh_lateness(windows, residual_m, STD_M)
    assert weight[205:225].max() < 0.1
    assert np.median(weight[:190]) > 0.9


def test_early_ranges_are_trusted_much_longer_than_late_ones():
    windows = link_windows(np.arange(100) / 50, np.zeros(100, dtype=np.int64))
    late, early = (weigh_lateness(windows, np.full(100, side * 2 * STD_M), STD_M)[50] for side in (1, -1))
    assert late < 0.05
    assert early > 0.85


def test_one_wild_range_does_not_count_against_its_neighbours():
    windows = link_windows(np.arange(100) / 50, np.zeros(100, dtype=np.int64))
    residual_m = np.zeros(100)
    residual_m[50] = 30.0
    weight = weigh_lateness(windows, residual_m, STD_M)
    assert weight[50] < 1e-3
    assert np.delete(weight, 50).min() > 0.7


def test_a_link_heard_twice_a_second_is_judged_range_by_range():
    """One range in a window: half trusted where both its own limit and that of a mean of one say so."""
    windows = link_windows(np.arange(10) / 2, np.zeros(10, dtype=np.int64))
    weight = weigh_lateness(windows, np.array([0.0, 1.0, 2.0, 3.0, 0, 0, 0, 0, 0, 0]) * STD_M, STD_M)
    np.testing.assert_allclose(weight[:4], [1.0, 1 / 1.25 / (1 + 1 / 9), 0.5 / (1 + 4 / 9), 1 / 3.25 / 2])


def test_links_are_judged_apart_and_in_any_order_of_rows():
    rng = np.random.default_rng(2)
    t_s, anchor = np.repeat(np.arange(100) / 50, 3), np.tile(np.arange(3), 100)
    residual_m = STD_M * rng.standard_normal(300) + np.where(anchor == 1, 0.5, 0.0)
    weight = weigh_lateness(link_windows(t_s, anchor), residual_m, STD_M)
    assert weight[anchor == 1].max() < 0.1
    for each in range(3):
        mine = anchor == each
        alone = weigh_lateness(link_windows(t_s[mine], anchor[mine]), residual_m[mine], STD_M)
        np.testing.assert_allclose(weight[mine], alone, atol=1e-12)


def test_no_ranges():
    none = np.empty(0)
    assert len(weigh_lateness(link_windows(none, np.empty(0, dtype=np.int64)), none, STD_M)) == 0
