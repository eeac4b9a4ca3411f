"""The table of message types: what each becomes, the fields that are wanted of it, and how. A sensor is a row here."""

from __future__ import annotations

from functools import partial

from quadlog.config.schema import Config
from quadlog.messages import Imu, JointStates, Odometry, PointCloud, Pose, Transforms, Twist
from quadlog.recordings.decoders import body, foxglove, poses, ranges
from quadlog.recordings.decoders.laser_scan import LASER_SCAN, MULTI_ECHO, scan_decoder
from quadlog.recordings.decoders.point_cloud import PointCloud2Decoder, decode_livox
from quadlog.recordings.decoders.rows import HEADER, Clouds, Type
from quadlog.recordings.plugged import MessageDecoder

LIVOX, LIVOX_PACKAGES = "CustomMsg", "livox_"
TYPES: dict[str, Type | Clouds | MessageDecoder] = {
    "geometry_msgs/msg/PointStamped": Type((Pose,), HEADER | {"position": "point:xyz"}, poses.pose),
    "geometry_msgs/msg/Pose2D": Type((Pose,), {"x": "x", "y": "y", "theta": "theta"}, poses.flat_pose),
    "geometry_msgs/msg/PoseStamped": Type((Pose,), poses.pose_at("pose"), poses.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": Type((Pose,), poses.pose_at("pose.pose"), poses.pose),
    "geometry_msgs/msg/TransformStamped": Type((Pose,), poses.TRANSFORM, poses.pose),
    "geometry_msgs/msg/Twist": Type((Twist,), poses.COMMAND, poses.command),
    "geometry_msgs/msg/TwistStamped": Type((Odometry,), HEADER | poses.VELOCITY, poses.velocity),
    "geometry_msgs/msg/TwistWithCovarianceStamped": Type((Odometry,), HEADER | poses.VELOCITY, poses.velocity),
    "gtec_msgs/msg/Ranging": ranges.type_of_ranges(
        ranges.no_error, unit="mm", tag="tagId", anchor="anchorId", range="range", error="errorEstimation ?"
    ),
    "nav_msgs/msg/Odometry": Type((Odometry,), poses.pose_at("pose.pose") | poses.TWIST, poses.pose),
    "sensor_msgs/msg/Imu": Type((Imu,), HEADER | poses.IMU_FIELDS, poses.imu),
    "sensor_msgs/msg/JointState": Type((JointStates,), HEADER | body.JOINT_STATE, body.joint_state),
    "sensor_msgs/msg/NavSatFix": Type((Pose,), HEADER | poses.FIX, poses.fix),
    "sensor_msgs/msg/Range": ranges.type_of_ranges(
        ranges.outside_limits, range="range", low="min_range", high="max_range"
    ),
    "tf2_msgs/msg/TFMessage": Type(
        (Transforms,), {column: f"transforms[].{path}" for column, path in poses.TRANSFORM.items()}, poses.transforms
    ),
    "unitree_go/msg/LowState": body.LOW_STATE,
    "unitree_go/msg/SportModeState": Type((Odometry, Imu), body.SPORT_MODE, body.unitree),
    "unitree_legged_msgs/msg/HighState": body.HIGH_STATE,
    "unitree_legged_msgs/msg/LowState": body.LOW_STATE,
    "ros2_unitree_legged_msgs/msg/HighState": body.HIGH_STATE,
    "ros2_unitree_legged_msgs/msg/LowState": body.LOW_STATE,
    "uwb_driver/msg/UwbRange": ranges.type_of_ranges(ranges.failed, **ranges.UWB_DRIVER),
    # LinkTrack packages have many names: matched by the last part of the type.
    "LinktrackAnchorframe0": ranges.type_of_ranges(zero_is_none=True, tag="nodes[].id", range="nodes[].dis_arr[]"),
    "LinktrackNodeframe2": ranges.NODES,
    "LinktrackNodeframe3": ranges.NODES,
    "LinktrackNodeframe4": ranges.type_of_ranges(
        zero_is_none=True, tag="tags[].id", anchor="tags[].anchors[].id", range="tags[].anchors[].dis"
    ),
    "LinktrackNodeframe5": ranges.NODES,
    "LinktrackTagframe0": ranges.type_of_ranges(zero_is_none=True, tag="id", range="dis_arr[]"),
    "sensor_msgs/msg/PointCloud2": Clouds(lambda channel, _, warn: PointCloud2Decoder(channel, warn)),
    "sensor_msgs/msg/LaserScan": Clouds(partial(scan_decoder, LASER_SCAN)),
    "sensor_msgs/msg/MultiEchoLaserScan": Clouds(partial(scan_decoder, MULTI_ECHO)),
    # Each Livox driver has its package, and others copy its message: matched by the last part of the type, outside of
    # Livox's packages by the definition, too.
    LIVOX: Clouds(lambda channel, *_: partial(decode_livox, channel)),
    "foxglove.PointCloud": MessageDecoder(PointCloud, foxglove.cloud),
    "foxglove.PoseInFrame": MessageDecoder(Pose, foxglove.pose),
}
PLANAR_SCANS = {"sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan"}
# Types that look as if they held what quadlog wants, and why they do not.
REFUSED = {
    "LinktrackNodeframe0": "carries raw bytes of other nodes, no ranges",
    "LinktrackNodeframe1": "carries solved positions, no ranges",
    "LinktrackNodeframe6": "carries raw bytes of other nodes, no ranges",
}


def last_part(type_name: str) -> str:
    """`LinktrackTagframe0` of `any_package/msg/LinktrackTagframe0`."""
    return type_name.rpartition("/")[2]


def own_types(config: Config) -> dict[str, Type]:
    """Topic -> what its messages become as the configuration says, whatever their type is."""
    rows = [row for row in config.uwb.range_topics if row.field or row.times]
    types = {row.topic: ranges.own_ranges(**row.model_dump(exclude={"topic"})) for row in rows}
    return types | {row.topic: poses.own_pose(row.fields, row.unit) for row in config.topics.poses}
