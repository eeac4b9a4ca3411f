"""A wheeled robot in a labyrinth of 2.4 m (uwb_labyrinth): four anchors heard in turn, 8 ranges/s, with a truth.

Slow rounds are what this is for: a round of four takes 0.51 s, in which the
robot drives up to 0.25 m. Only calibration and the track see through that.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from quadlog.messages import Float, Int, RangeSeries
from quadlog.pipelines.survey import PRIORS
from quadlog.positioning.anchors.survey import AnchorSurvey, survey_anchors
from quadlog.positioning.anchors.walk import make_walk
from quadlog.positioning.batch.factors import TagRanges, Way
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, TagResult, locate


@dataclass(frozen=True)
class Labyrinth:
    ranges: RangeSeries
    anchors: Anchors
    truth: Float

    def truth_at(self, t_ns: Int) -> Float:
        return np.stack([np.interp(t_ns * 1e-9, self.truth[:, 0], each) for each in self.truth[:, 1:3].T], axis=1)

    def locate(self, **settings: bool) -> TagResult:
        return locate(self.ranges, self.anchors, [TagInfo(0, 0.0)], LocateSettings(**settings)).tags[0]


FOLDER = Path(os.environ.get("QUADLOG_DATASETS", "/")) / "uwb_labyrinth"
pytestmark = pytest.mark.skipif(not FOLDER.exists(), reason=f"{FOLDER} is not there")


@pytest.fixture(scope="module")
def labyrinth() -> Labyrinth:
    """The text files: `range2 t range variance x y id snr` and `point2 t x y covariance`, anchors and tag level."""
    rows = read_rows("Indoor_UWB_Input.txt", "range2")
    t_ns, anchor = np.rint(rows[:, 0] * 1e9).astype(np.int64), rows[:, 5].astype(np.int64)
    ids, first = np.unique(anchor, return_index=True)
    anchors = Anchors(ids, np.column_stack([rows[first, 3:5], np.zeros(len(ids))]), np.zeros(len(ids)))
    ranges = RangeSeries(t_ns, np.zeros(len(t_ns), np.int64), anchor, rows[:, 1])
    return Labyrinth(ranges, anchors, read_rows("Indoor_UWB_GT.txt", "point2"))


def read_rows(name: str, kind: str) -> Float:
    """The numbers behind each line that starts with kind."""
    lines = (line.split() for line in (FOLDER / name).read_text().splitlines())
    return np.array([[float(text) for text in line[1:]] for line in lines if line and line[0] == kind])


@pytest.mark.parametrize(
    ("calibrate", "smooth", "fixes_m", "limit_m"),
    [(False, True, 0.21, 0.078), (True, True, 0.15, 0.07), (True, False, 0.165, 0.13)],
)
def test_fixes_from_rounds_and_tracks(lab, labyrinth, calibrate, smooth, fixes_m, limit_m):
    """The robot moves within a round, which a fix cannot know. Tracks measured 0.075, 0.066 and 0.126 m."""
    tag = labyrinth.locate(calibrate=calibrate, smooth=smooth)
    fixed, track = tag.fixes.solved, tag.track
    assert fixed.sum() >= 58
    assert lab.rmse((tag.fixes.position_m - labyrinth.truth_at(tag.epochs.t_ns))[fixed]) <= fixes_m
    assert len(track) >= 229
    error_m = track.position_m - labyrinth.truth_at(track.t_ns)
    assert lab.rmse(error_m) <= limit_m
    assert np.hypot(*error_m.T).max() < 0.45


def test_biases_without_the_truth_are_those_that_the_truth_shows(labyrinth):
    """Late ranges of 0.4 m and more among them: what the shortest half of the excess lies about, 0.02 to 0.13 m."""
    bias = labyrinth.locate().bias
    assert bias is not None
    assert (bias.n > 0).all()
    place = np.searchsorted(labyrinth.anchors.ids, labyrinth.ranges.anchor)
    offset_m = labyrinth.truth_at(labyrinth.ranges.t_ns) - labyrinth.anchors.position_m[place, :2]
    excess_m = labyrinth.ranges.range_m - np.linalg.norm(offset_m, axis=1)
    parts_m = [np.sort(excess_m[place == k]) for k in range(4)]
    halves_m = [np.lib.stride_tricks.sliding_window_view(part_m, len(part_m) // 2) for part_m in parts_m]
    true_m = [half_m[np.argmin(np.ptp(half_m, axis=1))].mean() for half_m in halves_m]
    np.testing.assert_allclose(bias.bias_m, true_m, atol=0.05)


def surveyed(labyrinth: Labyrinth, turns: float) -> AnchorSurvey:
    """The anchors by 9 m of wheel odometry, whose turns are multiplied.

    The file names the wheels' sides the other way round, and gives half their distance.
    """
    rows = read_rows("Indoor_UWB_Input.txt", "odom2diff")
    t_s, left_mps, right_mps, half_m = rows[:, 0], rows[1:, 1], rows[1:, 2], rows[0, 4]
    step_s = np.diff(t_s)
    yaw = turns * np.concatenate([[0.0], np.cumsum((right_mps - left_mps) / (2 * half_m) * step_s)])
    place = np.concatenate([[0], np.cumsum((left_mps + right_mps) / 2 * step_s * np.exp(0.5j * (yaw[1:] + yaw[:-1])))])
    way = Way(t_s - t_s[0], np.column_stack([place.real, place.imag]), yaw)
    ranges, anchors = labyrinth.ranges, labyrinth.anchors
    anchor = np.searchsorted(anchors.ids, ranges.anchor)
    seen = ranges.t_ns * 1e-9 - t_s[0], ranges.tag, anchor, ranges.range_m
    heights = np.array([np.zeros(4), np.full(4, 0.05)])
    walk, _ = make_walk(way, TagRanges(*seen, np.zeros((1, 2)), np.zeros(1), 4), heights, PRIORS["odometry"])
    return survey_anchors(walk, anchors.position_m[:, :2])


def test_the_anchors_are_surveyed_by_the_wheels(labyrinth):
    """Measured 0.10 to 0.19 m off, most of it alike; the wheels turn too far or too little by up to a fifth, too."""
    for turns in (0.8, 1.0, 1.2):
        result = surveyed(labyrinth, turns)
        off_m = np.array([each.position_m for each in result.anchors])[:, :2] - labyrinth.anchors.position_m[:, :2]
        assert np.hypot(*off_m.T).max() <= 0.25
        assert np.mean(np.abs(off_m) <= [each.bound_m[:2] for each in result.anchors]) >= 0.75
        assert result.misplaced_m == {}
