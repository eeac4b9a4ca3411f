"""From a cloud as it came to the class of every point: undo the robot's motion and tilt, then classify."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from quadlog.config import Config
from quadlog.lidar.deskew import Skewed, slot_poses, sweep_span
from quadlog.lidar.levelling import NotLevelled, UpSeries, level_rotations, up_in_base
from quadlog.lidar.paper import PaperSettings
from quadlog.lidar.range_image import RangeImageSettings
from quadlog.lidar.returns import ClassifiedReturns
from quadlog.lidar.scan_classifier import ScanClassifier
from quadlog.messages import Float, ImuSeries, Int, PointCloud, PoseSeries
from quadlog.pipelines.stages.heading import frozen
from quadlog.pipelines.stages.tracks import RobotTrack
from quadlog.pipelines.stages.walk import Walk

ROUTE_WORDS = {
    "rings": "by the beams their points name",
    "elevations": "by the beams their elevations show",
    "height_map": "as clouds without beams, on a map of the lowest points",
    "paper": "as in [Following]",
}


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What must be known beside a cloud to classify it.

    transform_lidar_to_base: (4, 4). up: how the body was tilted, None where nothing tells or it is not to count.
    """

    config: Config
    seed: int
    transform_lidar_to_base: Float
    robot: RobotTrack | None
    up: UpSeries | None

    @classmethod
    def of_walk(cls, walk: Walk) -> Self:
        """Those of a walk whose positions are known as far as they will be."""
        up = _up_series(walk) if walk.config.lidar.level else None
        return cls(walk.config, walk.seed, walk.transform_lidar_to_base, walk.robot, up)


@dataclass(frozen=True, slots=True)
class ScanTally:
    """How scans were looked at, and how many were taken as they came although they should not have been."""

    routes: Counter[str] = field(default_factory=Counter)
    skewed: Counter[Skewed] = field(default_factory=Counter)
    tilted: Counter[NotLevelled] = field(default_factory=Counter)

    def tell(self, walk: Walk) -> None:
        """A line for each."""
        n = self.routes.total()
        for route, count in self.routes.most_common():
            walk.note(f"{count} of {n} scans classified {ROUTE_WORDS[route]}")
        for skewed, count in self.skewed.items():
            walk.counts["scans_not_deskewed"] = walk.counts.get("scans_not_deskewed", 0) + count
            if skewed is not Skewed.NO_TIMES and walk.config.lidar.deskew:
                walk.warn(f"{count} of {n} scans keep the robot's motion: {skewed.value}")
        for tilted, count in self.tilted.items():
            walk.counts["scans_not_levelled"] = walk.counts.get("scans_not_levelled", 0) + count
            walk.warn(f"{count} of {n} scans keep the robot's tilt: {tilted.value}")


@dataclass(frozen=True, slots=True)
class Scan:
    """A classified scan at its instant, with the robot's pose (3,) x, y, yaw in map, or None where none is near.

    slot_poses: (K, 3) of its time slots. ms: what classifying it took.
    """

    t_ns: int
    returns: ClassifiedReturns
    pose_base_in_map: Float | None
    slot_poses: Float
    ms: float


class Scanner:
    """Classifies clouds one by one; `tally` counts what could not be done to them."""

    def __init__(self, around: Surroundings) -> None:
        self.tally = ScanTally()
        self._around = around
        self._classifier = classifier(around.config, around.seed)

    def classify(self, t_ns: int, cloud: PointCloud) -> tuple[ClassifiedReturns, Float | None, Float]:
        """A cloud's returns in base made upright; base's pose (3,) in map, if known, and those of its time slots."""
        first_ns, last_ns = t_ns, t_ns
        span_ns = sweep_span(cloud.offset_ns, len(cloud.xyz_m))
        if not isinstance(span_ns, Skewed) and self._around.config.lidar.deskew:
            first_ns, last_ns = t_ns + span_ns[0], t_ns + span_ns[1]
        transforms = np.tile(self._around.transform_lidar_to_base, (2, 1, 1))
        transforms[:, :3] = self._rotations(np.array([first_ns, last_ns])) @ transforms[:, :3]
        returns = self._classifier.classify(cloud, transforms)
        poses = self._poses(np.concatenate([np.array([t_ns]), t_ns + returns.slots.middle_ns]))
        at_slots, skewed = slot_poses(t_ns, t_ns + returns.slots.middle_ns, poses)
        skewed = (returns.slots.skewed or skewed) if self._moves else Skewed.NO_TIMES
        if not returns.shows_nothing:
            self.tally.routes[returns.route] += 1
            if skewed is not None:
                self.tally.skewed[skewed] += 1
        return returns, poses[0] if np.isfinite(poses[0]).all() else None, at_slots

    @property
    def _moves(self) -> bool:
        return self._around.robot is not None and self._around.robot.source != "fixed"

    def _rotations(self, instants_ns: Int) -> Float:
        if self._around.up is None:
            return np.tile(np.eye(3), (len(instants_ns), 1, 1))
        rotations, why_not = level_rotations(instants_ns, self._around.up)
        if why_not is not None:
            self.tally.tilted[why_not] += 1
        return rotations

    def _poses(self, instants_ns: Int) -> Float:
        """(M, 3) of base in map at instants (M,), NaN where there is none near."""
        if self._around.robot is None:
            return np.full((len(instants_ns), 3), np.nan)
        return self._around.robot.poses_at(instants_ns, self._around.config.lidar.pose_gap_s)


def classifier(config: Config, seed: int) -> ScanClassifier:
    """The configured method."""
    lidar, ground = config.lidar, config.ground
    if lidar.method == "paper":
        paper = PaperSettings(
            min_range_m=lidar.min_range_m,
            max_range_m=lidar.max_range_m,
            field_of_view_deg=lidar.field_of_view_deg or 180.0,
            outlier_neighbours=lidar.outlier_neighbours,
            outlier_std_ratio=lidar.outlier_std_ratio,
            ground_distance_m=ground.distance_m,
            ground_confidence=ground.confidence,
            ground_inlier_share=ground.inlier_share,
            ground_min_points=ground.min_points,
        )
        return ScanClassifier(paper, seed, uses_times=lidar.deskew)
    settings = RangeImageSettings(
        min_range_m=lidar.min_range_m,
        max_range_m=lidar.max_range_m,
        field_of_view_deg=lidar.field_of_view_deg or 360.0,
        ground_min_points=ground.min_points,
    )
    return ScanClassifier(settings, seed, uses_times=lidar.deskew)


def _up_series(walk: Walk) -> UpSeries | None:
    """What says how the body is tilted: the IMU, else the odometry, else moving tf; None where none of them knows."""
    poses: ImuSeries | PoseSeries | None = walk.streams.odometry
    imu = walk.streams.imu
    if imu is not None and imu.quat_xyzw is not None and not frozen(imu):
        poses = imu
    elif poses is None:
        topics, tree = walk.config.topics, walk.streams.tf
        base = tree.base_frame(topics.base_frame)
        poses = None if base is None else tree.pose_series(base, topics.map_frame)
    if poses is None or poses.quat_xyzw is None:
        return None
    series = up_in_base(poses.t_ns, poses.quat_xyzw)
    return series if len(series) else None
