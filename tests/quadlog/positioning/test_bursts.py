"""Three anchors, and one of them behind something for 0.6 s at a time: 50 Hz, constant velocity, 12 s, 40 runs.

One epoch of three ranges cannot tell a late one; time can. A filter with a
hard gate loses such a tag for good (1.9 m rms on average). `make bench
PARTS=estimators` does the same with other seeds.
"""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate

SEEDS = range(40)
LAST = 50


@pytest.fixture(scope="module", params=[True, False], ids=["smoothed", "causal"])
def runs(request, lab) -> tuple[bool, list[Float]]:
    """Whether smoothed, and the distance to the truth (T,) of each run; from fixes on, as in a replay."""
    settings = LocateSettings(smooth=request.param, calibrate=False)
    return request.param, [track_errors(lab, seed, settings) for seed in (SEEDS if request.param else SEEDS[:6])]


def track_errors(lab, seed: int, settings: LocateSettings) -> Float:
    simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, seed, bursts=True)
    anchors = Anchors(np.arange(3), lab.TRIANGLE_M, np.zeros(3))
    track = locate(simulated.series, anchors, [TagInfo(0, lab.TAG_HEIGHT_M)], settings).tags[0].track
    assert len(track) == len(simulated.t_ns)
    return np.linalg.norm(track.position_m - simulated.truth_at(track.t_ns), axis=1)


def test_tracks_through_bursts(runs):
    smoothed, errors_m = runs
    rms_m = np.sqrt(np.mean(np.square(errors_m)))
    assert rms_m <= (0.06 if smoothed else 0.20)


def test_no_run_locks_out(runs):
    """However far a burst pulls, the track comes back: no run ends, or stays, away from the truth."""
    smoothed, errors_m = runs
    ends_m = [np.median(each[-LAST:]) for each in errors_m]
    assert max(ends_m) < (0.3 if smoothed else 0.6)
    away = [longest_stretch(each > 1.0) for each in errors_m]
    assert max(away) < 50  # one second


def test_bursts_are_what_makes_it_hard(lab):
    """Plain fixes of the same ranges are far worse: what is tested here is not the noise."""
    squares = []
    for seed in SEEDS[:10]:
        simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, seed, bursts=True)
        anchors = Anchors(np.arange(3), lab.TRIANGLE_M, np.zeros(3))
        tag = locate(simulated.series, anchors, [TagInfo(0, lab.TAG_HEIGHT_M)], LocateSettings(calibrate=False)).tags[0]
        squares.append(lab.rmse(tag.fixes.position_m - simulated.truth_at(tag.fix_t_ns)) ** 2)
    assert np.sqrt(np.mean(squares)) > 0.25


def longest_stretch(away: np.ndarray) -> int:
    """Most instants in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], away, [False]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))
