"""Which topics could play a role, and how well: by type first, then by a look at the first messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Imu, Message, Odometry, PointCloud, Pose, Transforms, UwbRanges
from quadlog.recordings.decoding import LINKTRACK, REFUSED, last_part, plugged_decoder
from quadlog.recordings.recording import Recording

# What messages of a type become, which is what decides the roles they can play.
OWN_KINDS: dict[str, type[Message]] = {
    "sensor_msgs/msg/PointCloud2": PointCloud,
    "livox_ros_driver/msg/CustomMsg": PointCloud,
    "livox_ros_driver2/msg/CustomMsg": PointCloud,
    "foxglove.PointCloud": PointCloud,
    "nav_msgs/msg/Odometry": Odometry,
    "sensor_msgs/msg/Imu": Imu,
    "geometry_msgs/msg/PoseStamped": Pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": Pose,
    "geometry_msgs/msg/TransformStamped": Pose,
    "foxglove.PoseInFrame": Pose,
    "tf2_msgs/msg/TFMessage": Transforms,
    "gtec_msgs/msg/Ranging": UwbRanges,
    "uwb_driver/msg/UwbRange": UwbRanges,
    "sensor_msgs/msg/Range": UwbRanges,
}
RANGE_TYPE = "sensor_msgs/msg/Range"

TRUTH_WORDS = ("mocap", "vicon", "optitrack", "vrpn", "qualisys", "ground_truth", "groundtruth", "truth")
TARGET_NAMES = ("goal", "target", "person", "leader", "initialpose")
DRIVER_PACKAGES = (
    "velodyne_msgs",
    "nebula_msgs",
    "robosense_msgs",
    "rslidar_msg",
    "rslidar_msgs",
    "pandar_msgs",
    "hesai_ros_driver",
    "ouster_msgs",
    "ouster_ros",
    "ouster_sensor_msgs",
    "innovusion_msgs",
    "seyond_msgs",
)

LATE_SCANS = 100
"""A lidar that shows nothing in so many scans, ten seconds of them, is not expected to."""
NO_RETURN_M = 1e4
"""Coordinates beyond are what some drivers write where there was no return."""
SAMPLED_SCANS = 5
FEW_POINTS = 100  # a spinning lidar gives thousands, a radar tens
FLAT_M = 0.02
_NEAREST_ROLE: dict[type[Message], str] = {
    PointCloud: "lidar",
    UwbRanges: "uwb",
    Odometry: "odometry",
    Imu: "imu",
    Pose: "reference",
    Transforms: "tf",
}
# The rank of what is a cloud, but hardly a lidar's.
_POOR = 1


@dataclass(frozen=True, slots=True)
class Candidate:
    """Topics that could play a role together. rank: 0 unfit, then the higher the better."""

    topics: tuple[str, ...]
    rank: int
    why: str


def kind_of(type_name: str) -> type[Message] | None:
    """What messages of a type become, None for types that nobody decodes."""
    plugged = plugged_decoder(type_name)
    if plugged is not None:
        return plugged.gives
    return UwbRanges if last_part(type_name) in LINKTRACK else OWN_KINDS.get(type_name)


def refusal(type_name: str) -> str | None:
    """Why a type that looks like a sensor's cannot be used, or None."""
    if plugged_decoder(type_name) is not None:
        return None
    if last_part(type_name) in REFUSED:
        return REFUSED[last_part(type_name)]
    package, last = type_name.partition("/")[0], last_part(type_name)
    if package in DRIVER_PACKAGES and ("Packet" in last or "Scan" in last):
        return (
            f"holds driver packets ({type_name}), which are not point clouds; "
            "let the lidar's driver turn them into PointCloud2 and record that"
        )
    return None


def nearest_role(type_name: str) -> str | None:
    """The role that topics of a type look fit for, usable or not."""
    kind = kind_of(type_name)
    if kind is not None:
        return _NEAREST_ROLE[kind]
    if last_part(type_name) in REFUSED:
        return "uwb"
    return "lidar" if type_name.partition("/")[0] in DRIVER_PACKAGES else None


def is_target_name(topic: str) -> bool:
    """Whether a pose topic's name speaks of something to go to rather than of the robot."""
    return any(word in topic.lower() for word in TARGET_NAMES)


def uwb_candidates(recording: Recording, free: Mapping[str, str], unused: dict[str, str]) -> list[Candidate]:
    """One candidate per kind of range message, with all its topics; range topics without ends go to unused."""
    kinds: dict[str, list[str]] = {}
    for topic, name in free.items():
        if name == RANGE_TYPE and recording.ends_of(topic) is None:
            unused[topic] = "is a Range whose ends nothing tells; map them in [[uwb.range_topics]] if it is UWB"
        elif kind_of(name) is UwbRanges:
            kinds.setdefault(last_part(name), []).append(topic)
    return [
        Candidate(tuple(topics), 1, f"{len(topics)} topics of {kind}" if len(topics) > 1 else f"the only {kind}")
        for kind, topics in kinds.items()
    ]


def look_at_clouds(recording: Recording, topics: Sequence[str]) -> list[Candidate]:
    """How well each cloud topic serves as the lidar, judged by its first scans.

    Where these show no lidar, topics that are silent at first get more time:
    nothing else may take the place of one that starts late unasked.
    """
    candidates = [_judge(topic, recording.sample(topic, SAMPLED_SCANS)) for topic in topics]
    if max((each.rank for each in candidates), default=0) > _POOR:
        return candidates
    return [
        Candidate(each.topics, _POOR, "starts with empty scans")
        if each.rank == 0 and any(len(points) for points in _clouds(recording.sample(each.topics[0], LATE_SCANS)))
        else each
        for each in candidates
    ]


def _judge(topic: str, samples: Sequence[object]) -> Candidate:
    """Rank 3 a 3-D scan, 2 a flat one, 1 a radar or a handful of points, 0 nothing to see."""
    clouds = _clouds(samples)
    if not clouds:
        return Candidate((topic,), 0, "its first messages cannot be decoded")
    points = max(clouds, key=len)
    described = f"{len(points)} points per scan"
    if len(points) == 0:
        return Candidate((topic,), 0, "its first scans are empty")
    if "radar" in topic.lower() or len(points) < FEW_POINTS:
        return Candidate((topic,), _POOR, f"only {described}: a radar rather than a lidar")
    if np.ptp(points[:, 2]) < FLAT_M:
        return Candidate((topic,), 2, f"{described}, but flat: a 2-D scan, in which no ground can be found")
    return Candidate((topic,), 3, f"{described} in 3-D")


def _clouds(samples: Sequence[object]) -> list[np.ndarray]:
    """The points of each cloud that can be returns."""
    return [_valid_points(cloud) for cloud in samples if isinstance(cloud, PointCloud)]


def _valid_points(cloud: PointCloud) -> np.ndarray:
    # NaN fails both comparisons.
    farthest_m = np.abs(cloud.xyz_m).max(axis=1, initial=0)
    return cloud.xyz_m[(farthest_m > 0) & (farthest_m < NO_RETURN_M)]
