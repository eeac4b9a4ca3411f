"""What messages of a type become, which decides the roles that their topics can play."""

from __future__ import annotations

from quadlog.messages import Imu, JointStates, Message, Odometry, PointCloud, Pose, Transforms, UwbRanges
from quadlog.recordings.decoding import LINKTRACK, LIVOX, last_part, plugged_decoder

OWN_KINDS: dict[str, type[Message]] = {
    "sensor_msgs/msg/PointCloud2": PointCloud,
    "sensor_msgs/msg/LaserScan": PointCloud,
    "sensor_msgs/msg/MultiEchoLaserScan": PointCloud,
    LIVOX: PointCloud,
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
# Of a type that holds several: the kind that it is for, and what else there is.
BODY_KINDS: dict[str, tuple[type[Message], ...]] = {
    "sensor_msgs/msg/JointState": (JointStates,),
    "unitree_go/msg/LowState": (JointStates, Imu),
    "unitree_go/msg/SportModeState": (Odometry, Imu),
    "unitree_legged_msgs/msg/LowState": (JointStates, Imu),
    "unitree_legged_msgs/msg/HighState": (Odometry, JointStates, Imu),
    "ros2_unitree_legged_msgs/msg/LowState": (JointStates, Imu),
    "ros2_unitree_legged_msgs/msg/HighState": (Odometry, JointStates, Imu),
}
RANGE_TYPE = "sensor_msgs/msg/Range"
PLANAR_SCANS = {"sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan"}


def kinds_of(type_name: str) -> tuple[type[Message], ...]:
    """What messages of a type become, the most important kind first; none for types that nobody decodes."""
    plugged = plugged_decoder(type_name)
    if plugged is not None:
        return (plugged.gives,)
    if type_name in BODY_KINDS:
        return BODY_KINDS[type_name]
    last = last_part(type_name)
    own = UwbRanges if last in LINKTRACK else OWN_KINDS.get(last if last == LIVOX else type_name)
    return () if own is None else (own,)
