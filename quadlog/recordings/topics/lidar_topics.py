"""How well topics of clouds serve as the lidar, by their first scans, their frames and whose points they repeat."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import islice, permutations

import numpy as np

from quadlog.errors import set_flag
from quadlog.messages import Int, Odometry, PointCloud
from quadlog.recordings.recording import Recording
from quadlog.recordings.topics.look import Candidate, Roles
from quadlog.recordings.types import PLANAR_SCANS

SAMPLED_SCANS = 5
LATE_SCANS = 100
"""A lidar that shows nothing in so many scans, ten seconds of them, is not expected to."""
NO_RETURN_M = 1e4
"""Coordinates beyond are what some drivers write where there was no return."""
SIDE = re.compile("front|rear|back|left|right")
FEW_POINTS = 100  # a spinning lidar gives thousands, a radar tens
FLAT_M = 0.02
COMPARED_SCANS, COMPARED_POINTS, COMPARED_MESSAGES = 12, 64, 600
# The ranks of what is a cloud, but hardly a lidar's, and of one in a frame that is not the robot's.
_POOR, _WORLD = 1, 2


def judge_clouds(look: Roles) -> list[Candidate]:
    """Every topic of clouds, by its first scans and their frame.

    Where these show no lidar, topics that are silent at first get more time:
    nothing else may take the place of one that starts late unasked.
    """
    samples = look.first(PointCloud, look.of_kind(PointCloud), SAMPLED_SCANS)
    frame_of = {topic: scans[-1].frame_id for topic, scans in samples.items() if scans}
    found = {topic: _placed(look, _judged(look, topic, scans), scans) for topic, scans in samples.items()}
    best = max((each.rank for each in found.values()), default=0)
    if best > _POOR:
        equal = {topic: frame_of[topic] for topic, each in found.items() if each.rank == best}
        copies = _copies(look.recording, equal).items()
        found |= {topic: Candidate((topic,), 0, f"repeats points of {first}") for topic, first in copies}
    else:
        silent = [
            topic for topic, scans in samples.items() if not found[topic].rank and not any(map(len, _points(scans)))
        ]
        found |= {topic: _by_later_scans(look, found[topic]) for topic in silent}
    sides = {topic: SIDE.search(topic) for topic, each in found.items() if each.rank == best > _WORLD}
    several = tuple(topic for topic, side in sides.items() if side)
    if len({side[0] for side in sides.values() if side}) < 2:
        return [*found.values()]
    return [*found.values(), Candidate(several, best, f"{len(several)} scanners that look to different sides")]


def _judged(look: Roles, topic: str, scans: Sequence[PointCloud]) -> Candidate:
    """Rank 5 a 3-D scan, 4 a flat cloud, 3 a planar scanner's, 1 a radar or a handful of points, 0 nothing to see."""
    if not scans:
        why = look.recording.peek(topic, SAMPLED_SCANS)[1] or "it holds no cloud"
        return Candidate((topic,), 0, f"cannot be decoded: {why}")
    points, planar = max(_points(scans), key=len), look.usable[topic] in PLANAR_SCANS
    described = f"{len(points)} points per scan"
    if len(points) == 0:
        return Candidate((topic,), 0, "its first scans are empty")
    if "radar" in topic.lower() or (len(points) < FEW_POINTS and not planar):
        return Candidate((topic,), _POOR, f"only {described}: a radar rather than a lidar")
    if np.ptp(points[:, 2]) < FLAT_M:
        # Drivers publish the same scan as a cloud, too.
        why = f"{described}, but flat: a 2-D scan, in which no ground can be found"
        return Candidate((topic,), 3 if planar else 4, why)
    return Candidate((topic,), 5, f"{described} in 3-D")


def _placed(look: Roles, candidate: Candidate, scans: Sequence[PointCloud]) -> Candidate:
    """A cloud whose frame is not the robot's serves where nothing else does, if the robot has a place in it."""
    base = look.frames.base
    if not candidate.rank or not look.frames.is_world(frame := scans[-1].frame_id, base):
        return candidate
    odometry = look.first(Odometry, look.of_kind(Odometry)).values()
    placing = {each.frame_id for some in odometry for each in some}
    if frame in placing or (base and look.frames.connects(frame, base)):
        why = f"{candidate.why}, in the frame {frame}, transformed to base"
        return replace(candidate, rank=min(candidate.rank, _WORLD), why=why)
    flag = set_flag("topics.lidar", candidate.topics)
    why = f"is in the frame {frame}, in which neither tf nor odometry places the robot"
    return replace(candidate, rank=0, why=f"{why}; if it is seen from base:  {flag}")


def _by_later_scans(look: Roles, candidate: Candidate) -> Candidate:
    """A candidate whose first scans show nothing, by more of them."""
    (scans,) = look.first(PointCloud, candidate.topics, LATE_SCANS).values()
    later = [len(points) for points in _points(scans)]
    if any(later):
        return replace(candidate, rank=_POOR, why="starts with empty scans")
    which = "all its" if len(later) < LATE_SCANS else "its first"
    return replace(candidate, why=f"{which} {len(later)} scans are empty") if later else candidate


def _copies(recording: Recording, frame_of: Mapping[str, str]) -> dict[str, str]:
    """Topic -> the original, of clouds that repeat points of another one in the same frame, at once or later."""
    copies: dict[str, str] = {}
    for frame in set(frame_of.values()):
        topics = [topic for topic in frame_of if frame_of[topic] == frame]
        recent: dict[str, deque[tuple[int, Int]]] = {topic: deque(maxlen=COMPARED_SCANS) for topic in topics}
        for timed in islice(recording.glimpse().messages(topics), COMPARED_MESSAGES) if len(topics) > 1 else ():
            if isinstance(timed.message, PointCloud):
                recent[timed.topic].append((timed.t_ns, _millimetres(timed.message)))
            if all(len(scans) == COMPARED_SCANS for scans in recent.values()):
                break
        # An original comes before its copies, has more points, or at least the shorter name.
        for first, second in permutations(sorted(topics, key=lambda topic: (len(topic), topic)), 2):
            late_ns = _lateness_ns(recent[second], recent[first])
            if late_ns is None or second in copies:
                continue
            back_ns = _lateness_ns(recent[first], recent[second])
            if back_ns is None or late_ns > 0 or (late_ns == 0 and first not in copies):
                copies[second] = first
    return copies


def _lateness_ns(copies: Collection[tuple[int, Int]], originals: Collection[tuple[int, Int]]) -> int | None:
    """How much later scans (time, points) are than those that hold their points; None where most are of their own."""
    late_ns = []
    for t_ns, points in copies:
        some = points[:: max(len(points) // COMPARED_POINTS, 1)]
        held = [t_ns - from_ns for from_ns, others in originals if len(some) and np.isin(some, others).mean() > 0.9]
        late_ns += sorted(held, key=abs)[:1]
    return sorted(late_ns)[len(late_ns) // 2] if 2 * len(late_ns) > len(copies) else None


def _millimetres(cloud: PointCloud) -> Int:
    """(N,) the points that can be returns, rounded to millimetres, a number for each."""
    x_mm, y_mm, z_mm = np.round(_points([cloud])[0] * 1e3).astype(np.int64).T
    return np.unique(x_mm + (y_mm << 21) + (z_mm << 42))


def _points(scans: Sequence[PointCloud]) -> list[np.ndarray]:
    """The points of each scan that can be returns."""
    farthest_m = [np.abs(scan.xyz_m).max(axis=1, initial=0) for scan in scans]
    # NaN fails both comparisons.
    rows = [(far_m > 0) & (far_m < NO_RETURN_M) for far_m in farthest_m]
    return [scan.xyz_m[kept] for scan, kept in zip(scans, rows, strict=True)]
