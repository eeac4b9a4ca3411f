from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.track.covariance_inflation import PRIOR_DOF, ResidualSums, excess_variance, total_excess

STD_M, LINKS, PER_BLOCK = 0.1, 6, 20
ANGLES = 2 * np.pi * np.arange(LINKS) / LINKS + 0.3
UNIT = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
COVARIANCE = np.eye(2) * STD_M**2 / (LINKS / 2 * PER_BLOCK * 0.75 * 0.999)
"""That of a place of which three quarters come from PER_BLOCK instants: so long is a block."""


NONE = ResidualSums()


def ask(residual_m, weight=None, slope=None, tally=NONE, std_m=STD_M):
    """residual_m (T, LINKS), one per instant and link."""
    instants = len(residual_m)
    weight = np.ones(residual_m.shape) if weight is None else weight
    return excess_variance(
        tally, np.arange(instants + 1) * LINKS, np.tile(np.arange(LINKS), instants), residual_m.ravel(),
        weight.ravel(), (weight if slope is None else slope).ravel(), np.tile(UNIT, (instants, 1)),
        np.tile(COVARIANCE, (instants, 1, 1)), std_m,
    )  # fmt: skip


def white(instants, seed=0):
    return STD_M * np.random.default_rng(seed).standard_normal((instants, LINKS))


def test_white_noise_has_no_excess_and_its_scale_is_found():
    factor, tally = ask(white(4000))
    assert factor.shape == (4000,)
    np.testing.assert_array_equal(factor[:PER_BLOCK], 1.0)
    assert tally.dof == 200 * (LINKS - 2)
    assert total_excess(tally, STD_M) == pytest.approx(1.0, abs=0.12)
    assert total_excess(ask(3 * white(4000))[1], STD_M) == pytest.approx(9.0, rel=0.12)


def test_errors_that_last_for_a_block_count_as_often_as_it_has_ranges():
    held_m = np.repeat(white(200), PER_BLOCK, axis=0)
    assert total_excess(ask(held_m)[1], STD_M) == pytest.approx(PER_BLOCK, rel=0.12)


def test_what_the_track_has_absorbed_makes_no_difference():
    """A shift of the place changes residuals by unit . shift; an estimate takes out what it can of them."""
    residual_m = np.repeat(white(200), PER_BLOCK, axis=0)
    absorbed_m = residual_m - residual_m @ np.linalg.pinv(UNIT).T @ UNIT.T
    assert (absorbed_m**2).mean() < 0.8 * (residual_m**2).mean()
    got, want = (total_excess(ask(each)[1], STD_M) for each in (absorbed_m, residual_m))
    assert got == pytest.approx(want, rel=1e-6)


def test_the_factor_at_an_instant_knows_nothing_later():
    residual_m = np.repeat(white(20), PER_BLOCK, axis=0)
    whole, _ = ask(residual_m)
    part, tally = ask(residual_m[:170])
    np.testing.assert_array_equal(part, whole[:170])
    rest, total = ask(residual_m[160:], tally=ask(residual_m[:160])[1])
    np.testing.assert_allclose(rest, whole[160:])
    assert total.dof == ask(residual_m)[1].dof
    assert tally.dof < total.dof


def test_robust_weights_give_the_sandwich():
    """A Huber mean of each block, without a place to fit: its true variance over that of the weights."""
    rng = np.random.default_rng(4)
    residual_m = np.where(rng.random((40000, LINKS)) < 0.1, 0.5, 0.1) * rng.standard_normal((40000, LINKS))
    limit_m = 0.15
    weight = np.minimum(1, limit_m / np.abs(residual_m))
    slope = (np.abs(residual_m) < limit_m).astype(float)
    got = total_excess(ask(residual_m, weight, slope)[1], STD_M)
    score = (weight * residual_m) ** 2
    assert got == pytest.approx(score.mean() * weight.mean() / slope.mean() ** 2 / STD_M**2, rel=0.05)


def test_few_links_show_nothing():
    """Two links fix a place and leave nothing over."""
    instants = 500
    factor, tally = excess_variance(
        ResidualSums(), np.arange(instants + 1) * 2, np.tile(np.arange(2), instants), np.full(2 * instants, 0.5),
        np.ones(2 * instants), np.ones(2 * instants), np.tile(UNIT[:2], (instants, 1)),
        np.tile(COVARIANCE, (instants, 1, 1)), STD_M,
    )  # fmt: skip
    np.testing.assert_array_equal(factor, 1.0)
    assert tally.dof == 0


def test_a_short_log_stays_near_one():
    found = [total_excess(ask(3 * white(PER_BLOCK, seed))[1], STD_M) for seed in range(300)]
    assert np.mean(found) == pytest.approx((9 * (LINKS - 2) + PRIOR_DOF) / (LINKS - 2 + PRIOR_DOF), rel=0.1)


class Counted(np.ndarray):
    """An array that counts how many rows are cut out of it."""

    rows = 0

    def __getitem__(self, key):
        cut = super().__getitem__(key)
        if isinstance(key, slice):
            Counted.rows += len(cut)
        return np.asarray(cut)


def test_the_search_for_ends_of_blocks_is_linear_after_a_long_block():
    """Ranges without weight make one block of half the log; then each instant is one."""
    instants = 8192
    weight = np.repeat([1e-9, float(PER_BLOCK)], instants // 2)[:, None] * np.ones(LINKS)
    residual_m = white(instants)
    Counted.rows = 0
    excess_variance(
        ResidualSums(), np.arange(instants + 1) * LINKS, np.tile(np.arange(LINKS), instants), residual_m.ravel(),
        weight.ravel(), weight.ravel(), np.tile(UNIT, (instants, 1)),
        np.tile(COVARIANCE, (instants, 1, 1)).view(Counted), STD_M,
    )  # fmt: skip
    assert Counted.rows < 20 * instants


def test_no_ranges():
    none = np.empty(0, dtype=np.int64)
    factor, tally = excess_variance(
        ResidualSums(),
        np.zeros(1, dtype=np.int64),
        none,
        *[np.empty(0)] * 3,
        np.empty((0, 2)),
        np.empty((0, 2, 2)),
        STD_M,
    )
    assert len(factor) == 0
    assert total_excess(tally, STD_M) == 1.0
