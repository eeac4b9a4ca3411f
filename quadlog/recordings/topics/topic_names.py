"""What the name of a topic says about its poses: true, estimated, wanted, or of something that the robot sees."""

from __future__ import annotations

import re

TRUTH_PARTS = ("truth", "mocap", "motion_capture", "vicon", "vrpn", "optitrack", "natnet", "qualisys", "phasespace")
TRUTH_WORDS = {"gt", "true", "leica", "motive"}
"""What the name of a true pose contains, and its words as a whole: /gtsam/pose is no truth."""
ESTIMATOR_WORDS = {
    "amcl", "slam", "cartographer", "karto", "gmapping", "hector", "rtabmap", "orb", "lio", "liosam", "loam", "ndt",
    "icp", "vio", "vins", "rovio", "okvis", "svo", "msckf", "ekf", "ukf", "localization", "localizer", "localisation",
}  # fmt: skip
ERROR_WORDS = {"error", "errors", "err"}
NOT_MEASURED_WORDS = {
    *ERROR_WORDS,
    *("reference", "references", "ref", "desired", "setpoint", "setpoints", "cmd", "command", "commanded"),
    *("aruco", "apriltag", "apriltags", "marker", "markers"),
}
"""Words of topics that hold wanted poses, differences, or poses of things that the robot sees."""
TARGET_NAMES = ("goal", "target", "person", "leader", "initialpose")


def name_words(name: str) -> set[str]:
    """The lower-case words of a topic's, a type's or a field's name: `gt` and `pose` of `/robot1/gtPose`."""
    return set(re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()))


def names_truth(name: str) -> bool:
    """Whether the name of a topic or a type says that it is a true pose, as of motion capture."""
    words = name_words(name)
    return not words & ERROR_WORDS and (bool(words & TRUTH_WORDS) or any(each in name.lower() for each in TRUTH_PARTS))


def names_estimator(topic: str) -> bool:
    """Whether a topic's name is that of a localization, SLAM or visual-inertial odometry."""
    return bool(name_words(topic) & ESTIMATOR_WORDS)


def is_measured(topic: str) -> bool:
    """Whether a topic's name allows that it is the robot's own measured pose."""
    return not name_words(topic) & NOT_MEASURED_WORDS and not is_target_name(topic)


def is_target_name(topic: str) -> bool:
    """Whether a pose topic's name means something to go to rather than of the robot."""
    return any(word in topic.lower() for word in TARGET_NAMES)
