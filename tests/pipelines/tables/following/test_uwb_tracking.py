from __future__ import annotations

import numpy as np
import pytest

from quadlog.pipelines.tables.following import uwb_estimators as uwb_tracking
from quadlog.pipelines.tables.following.uwb_estimators import _draw_walk, tracking_group

STILL_M = np.full((600, 2), [2.0, 0.0])


@pytest.fixture(scope="module")
def rows():
    return {row.quantity: row for row in tracking_group(12, seed=0).rows}


def test_time_helps_and_smoothing_helps_more(rows):
    for where in ("line of sight", "NLOS bursts"):
        fixed, causal, smoothed = (
            rows[f"{where}: RMSE, {each} (m)"].ours for each in ("fix by fix", "causal track", "smoothed track")
        )
        assert smoothed < causal < fixed
    assert rows["NLOS bursts: RMSE, smoothed track (m)"].ours <= 0.11
    assert rows["line of sight: RMSE, smoothed track (m)"].ours < 0.04


def test_no_track_is_lost_and_the_interval_says_what_so_few_runs_can_tell(rows):
    for where in ("line of sight", "NLOS bursts"):
        for estimate in ("causal track", "smoothed track"):
            row = rows[f"{where}: share of runs lost, {estimate}"]
            assert row.ours == 0
            assert row.high == pytest.approx(1.96**2 / (12 + 1.96**2), abs=0.001)  # Wilson with no success
            assert row.note == "0 of 12 runs."


def test_a_lost_track_is_called_lost(monkeypatch):
    def away(t_s, position_m, range_m):
        off_m = np.full(len(t_s), 2.0)
        return {"fix by fix": off_m, "causal track": off_m, "smoothed track": np.append(off_m[:-1], 0.5)}

    monkeypatch.setattr(uwb_tracking, "_errors", away)
    rows = {row.quantity: row.ours for row in tracking_group(3, seed=0).rows}
    assert rows["line of sight: share of runs lost, causal track"] == 1
    assert rows["line of sight: share of runs lost, smoothed track"] == 0
    assert rows["line of sight: RMSE, fix by fix (m)"] == 2


def test_a_burst_is_late_for_a_whole_slot_and_one_in_ten_slots_is():
    late = []
    for seed in range(40):
        clear_m = _draw_walk(STILL_M, False, np.random.default_rng(seed))
        extra_m = _draw_walk(STILL_M, True, np.random.default_rng(seed)) - clear_m
        slots_m = extra_m.reshape(20, 30, 3)
        np.testing.assert_allclose(slots_m, slots_m[:, :1].repeat(30, axis=1), atol=1e-12)
        late.append(slots_m[:, 0])
    extra_m = np.array(late)
    hidden = extra_m > 1e-9
    assert extra_m.min() > -1e-9
    assert hidden.mean() == pytest.approx(0.1, abs=0.02)
    assert extra_m[hidden].mean() == pytest.approx(0.5, abs=0.1)


def test_the_page_says_how_many_walks_and_the_seed_decides():
    first = tracking_group(2, seed=1)
    assert first.text.startswith("2 walks of 12 s at 0.4 m/s")
    assert first == tracking_group(2, seed=1)
    assert first.rows != tracking_group(2, seed=2).rows
