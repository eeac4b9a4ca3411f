"""Real recordings of UWB ranges with a truth, read from the folder that QUADLOG_DATASETS names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quadlog.geometry import base_to_tag, yaw_from_quat
from quadlog.messages import Float, Int, RangeSeries
from quadlog.metrics.positioning import Trajectory
from quadlog.positioning.heading.odometry_velocity import BodyMotion
from quadlog.positioning.locate import Anchors, TagInfo
from quadlog.recordings.recording import open_recording
from quadlog.recordings.streams import gather

DATASETS = "QUADLOG_DATASETS"

LIAS_ANCHORS_M = (
    (-3.4203, 3.0053, 1.0442),
    (0.0016, 3.0110, 1.0446),
    (3.6056, 2.9795, 1.0463),
    (3.6011, -0.0008, 1.0422),
    (3.5674, -3.0087, 1.0443),
    (-0.0072, -2.9652, 1.0444),
    (-3.4673, -2.9587, 1.0445),
    (-3.4858, -0.0098, 1.0457),
)
"""As the authors of the recording publish them, ids 0 to 7; the recording does not hold them."""
LIAS_LEVERS_M = ((-0.0689, -0.1423), (-0.0750, 0.1402), (0.2034, 0.1451))
"""Where tags 0 to 2 sit on the trolley, by the same authors."""
LIAS_TAG_HEIGHT_M = 0.97


@dataclass(frozen=True, slots=True)
class RealLog:
    """One tag of one recording: its ranges, the anchors, and where it really was at each pose of the truth."""

    name: str
    ranges: RangeSeries
    anchors: Anchors
    tag: TagInfo
    truth: Trajectory


def folder_of_datasets() -> Path | None:
    """The folder that QUADLOG_DATASETS names, None where it is not set."""
    value = os.environ.get(DATASETS)
    return Path(value) if value else None


def real_logs(folder: Path, longest_s: float | None) -> Iterator[RealLog]:
    """Those of the known recordings that the folder has, cut to their first longest_s. Raises QuadlogError."""
    lias = folder / "uwb_lias" / "lias_fast.mcap"
    if lias.is_file():
        yield from (_first_seconds(log, longest_s) for log in _lias(lias))
    labyrinth = folder / "uwb_labyrinth"
    if (labyrinth / "Indoor_UWB_Input.txt").is_file():
        yield _first_seconds(_labyrinth(labyrinth), longest_s)


def _lias(path: Path) -> Iterator[RealLog]:
    """Three tags on a trolley among eight anchors at 100 Hz, with motion capture."""
    with open_recording(path) as recording:
        streams = gather(recording, uwb=["/nlink_linktrack_tagframe0"], reference="/mocap/trolley/pose")
    assert streams.ranges is not None
    assert streams.reference is not None
    anchors_m = np.array(LIAS_ANCHORS_M)
    anchors = Anchors(np.arange(len(anchors_m)), anchors_m, np.zeros(len(anchors_m)))
    poses = streams.reference
    yaw_rad = yaw_from_quat(poses.quat_xyzw)
    for tag, (x_m, y_m) in enumerate(LIAS_LEVERS_M):
        tag_m = base_to_tag(poses.position_m[:, :2], yaw_rad, x_m, y_m)
        truth = Trajectory(poses.t_ns, np.column_stack([tag_m, np.zeros(len(tag_m))]), poses.quat_xyzw)
        mine = _rows(streams.ranges, streams.ranges.tag == tag)
        yield RealLog(f"trolley, tag {tag}", mine, anchors, TagInfo(tag, LIAS_TAG_HEIGHT_M), truth)


def _labyrinth(folder: Path) -> RealLog:
    """A wheeled robot among four anchors, heard in turn, 8 ranges/s, with wheel odometry; all at one height."""
    heard, driven = (_text_rows(folder / "Indoor_UWB_Input.txt", kind) for kind in ("range2", "odom2diff"))
    true = _text_rows(folder / "Indoor_UWB_GT.txt", "point2")
    anchor = heard[:, 5].astype(np.int64)
    ids, first = np.unique(anchor, return_index=True)
    anchors = Anchors(ids, np.column_stack([heard[first, 3:5], np.zeros(len(ids))]), np.zeros(len(ids)))
    ranges = RangeSeries(_ns(heard[:, 0]), np.zeros(len(heard), np.int64), anchor, heard[:, 1])
    # The file's own words give the sides the other way round, and the whole of what is half the distance between the
    # wheels: only so do the turns follow the truth's course, to 0.17 rad instead of several turns.
    left_mps, right_mps, sideways_mps, half_track_m = driven[:, 1:5].T
    yaw_rate_radps = (right_mps - left_mps) / (2 * half_track_m)
    yaw_rad = np.concatenate([[0.0], np.cumsum(yaw_rate_radps[:-1] * np.diff(driven[:, 0]))])
    velocity_mps = np.column_stack([(right_mps + left_mps) / 2, sideways_mps])
    motion = BodyMotion(_ns(driven[:, 0]), velocity_mps, yaw_rad, yaw_rate_radps)
    position_m = np.column_stack([true[:, 1:3], np.zeros(len(true))])
    truth = Trajectory(_ns(true[:, 0]), position_m, np.tile([0.0, 0, 0, 1], (len(true), 1)))
    return RealLog("labyrinth", ranges, anchors, TagInfo(0, 0.0, motion), truth)


def _text_rows(path: Path, kind: str) -> Float:
    """The numbers behind each line that starts with kind."""
    lines = (line.split() for line in path.read_text(encoding="utf-8").splitlines())
    return np.array([[float(text) for text in line[1:]] for line in lines if line and line[0] == kind])


def _ns(seconds: Float) -> Int:
    t_ns: Int = np.rint(seconds * 1e9).astype(np.int64)
    return t_ns


def _rows(ranges: RangeSeries, rows: np.ndarray) -> RangeSeries:
    return RangeSeries(ranges.t_ns[rows], ranges.tag[rows], ranges.anchor[rows], ranges.range_m[rows])


def _first_seconds(log: RealLog, longest_s: float | None) -> RealLog:
    if longest_s is None:
        return log
    end_ns = log.ranges.t_ns[0] + round(longest_s * 1e9)
    truth = log.truth.rows(np.flatnonzero(log.truth.t_ns < end_ns))
    return replace(log, ranges=_rows(log.ranges, log.ranges.t_ns < end_ns), truth=truth)
