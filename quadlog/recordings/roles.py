"""Which topic plays which role, by type and content, and why; nothing is chosen that could as well be another."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice, permutations

import numpy as np

from quadlog.config.schema import Topics
from quadlog.errors import MAX_LISTED, AmbiguousTopic, UnknownTopic, set_flag, some_of
from quadlog.messages import Imu, Int, JointStates, Message, Odometry, PointCloud, Pose, Transforms, UwbRanges
from quadlog.recordings.clock_offsets import FAR_APART_NS
from quadlog.recordings.decoders.pose import is_static
from quadlog.recordings.decoders.pose_fields import PoseField
from quadlog.recordings.decoding import LINKTRACK, LIVOX, REFUSED, last_part, plugged_decoder
from quadlog.recordings.formatting import several
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import look_at_frames
from quadlog.recordings.tf_tree import TransformTree

# What messages of a type become, which is what decides the roles they can play.
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
DRIVER_PACKAGES = {
    "velodyne_msgs", "nebula_msgs", "robosense_msgs", "rslidar_msg", "rslidar_msgs", "pandar_msgs", "hesai_ros_driver",
    "ouster_msgs", "ouster_ros", "ouster_sensor_msgs", "innovusion_msgs", "seyond_msgs",
}  # fmt: skip

LATE_SCANS = 100
"""A lidar that shows nothing in so many scans, ten seconds of them, is not expected to."""
NO_RETURN_M = 1e4
"""Coordinates beyond are what some drivers write where there was no return."""
SAMPLED_SCANS = 5
SAMPLED_JOINTS = 20
"""Drivers of arms and wheels may share the topic."""
FEW_POINTS = 100  # a spinning lidar gives thousands, a radar tens
FLAT_M = 0.02
_NEAREST_ROLE: dict[type[Message], str] = {
    PointCloud: "lidar",
    UwbRanges: "uwb",
    Odometry: "odometry",
    Imu: "imu",
    Pose: "reference",
    Transforms: "tf",
    JointStates: "joints",
}
# The ranks of what is a cloud, but hardly a lidar's, and of one in a frame that is not the robot's.
_POOR = 1
_WORLD = 2
_TRUTH = 10


@dataclass(frozen=True, slots=True)
class Candidate:
    """Topics that could play a role together. rank: 0 unfit, then the higher the better."""

    topics: tuple[str, ...]
    rank: int
    why: str


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
    kinds = kinds_of(type_name)
    if kinds:
        return _NEAREST_ROLE[kinds[0]]
    if last_part(type_name) in REFUSED:
        return "uwb"
    return "lidar" if type_name.partition("/")[0] in DRIVER_PACKAGES else None


NOT_READ = {
    "camera images": ("Image", "CameraInfo", "CompressedVideo", "Theora"),
    "satellite positions": ("NavSat", "Gps", "GPS"),
    "logs and diagnostics": ("Log", "Diagnostic", "Rosout", "ParameterEvent"),
    "commands": ("Twist", "Cmd", "Command", "Joy"),
    "results of other programs": ("Path", "OccupancyGrid", "GridMap", "Marker", "Map"),
}
"""What quadlog does not read, by words in the type's name."""


def why_not_read(type_name: str) -> str:
    """Why topics of a type that has no decoder play no role."""
    last = last_part(type_name)
    for what, words in NOT_READ.items():
        if any(word in last for word in words):
            return f"not used: quadlog reads no {what}"
    return f"not used: quadlog has no decoder for {last or 'messages without a type'}"


def name_words(name: str) -> set[str]:
    """`gt` and `pose` of `/robot1/gtPose`: the lower-case words of a topic's or a type's name."""
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


def uwb_candidates(recording: Recording, free: Mapping[str, str], unused: dict[str, str]) -> list[Candidate]:
    """One candidate per kind of range message, with all its topics; range topics without ends go to unused."""
    kinds: dict[str, list[str]] = {}
    for topic, name in free.items():
        if name == RANGE_TYPE and recording.ends_of(topic) is None:
            unused[topic] = "is a Range without tag and anchor; if it is UWB, map it in [[uwb.range_topics]]"
        elif UwbRanges in kinds_of(name):
            kinds.setdefault(last_part(name), []).append(topic)
    return [
        Candidate(tuple(topics), 1, f"{len(topics)} topics of {kind}" if len(topics) > 1 else f"the only {kind}")
        for kind, topics in kinds.items()
    ]


def look_at_clouds(
    recording: Recording, topics: Sequence[str], frames: TransformTree, base: str | None, pose_frames: Collection[str]
) -> list[Candidate]:
    """How well each cloud topic serves as the lidar, judged by its first scans and their frame.

    Where these show no lidar, topics that are silent at first get more time:
    nothing else may take the place of one that starts late unasked.
    pose_frames: frames in which odometry gives the robot's place.
    """
    samples = {topic: recording.sample(topic, SAMPLED_SCANS) for topic in topics}
    frame_of = {topic: each.frame_id for topic in topics for each in samples[topic] if isinstance(each, PointCloud)}
    found = {topic: _judge(recording, topic, samples[topic]) for topic in topics}
    for topic, each in found.items():
        if each.rank and frames.is_world(frame_of[topic], base):
            placed = frame_of[topic] in pose_frames or (base and frames.connects(frame_of[topic], base))
            found[topic] = _in_world(each, frame_of[topic], bool(placed))
    best = max((each.rank for each in found.values()), default=0)
    if best > _POOR:
        copies = _copies(recording, {topic: frame_of[topic] for topic, each in found.items() if each.rank == best})
        found |= {topic: Candidate((topic,), 0, f"repeats points of {first}") for topic, first in copies.items()}
        return [*found.values()]
    for topic, each in found.items():
        if each.rank == 0 and not any(map(len, _clouds(samples[topic]))):
            found[topic] = _by_later_scans(recording, each)
    return [*found.values()]


def _by_later_scans(recording: Recording, candidate: Candidate) -> Candidate:
    """A candidate whose first scans show nothing, by more of them."""
    later = [len(points) for points in _clouds(recording.sample(candidate.topics[0], LATE_SCANS))]
    if any(later):
        return Candidate(candidate.topics, _POOR, "starts with empty scans")
    which = "all its" if len(later) < LATE_SCANS else "its first"
    return Candidate(candidate.topics, 0, f"{which} {len(later)} scans are empty") if later else candidate


def _judge(recording: Recording, topic: str, samples: Sequence[object]) -> Candidate:
    """Rank 5 a 3-D scan, 4 a flat cloud, 3 a planar scanner's, 1 a radar or a handful of points, 0 nothing to see."""
    clouds = _clouds(samples)
    if not clouds:
        why = recording.why_unsampled(topic, SAMPLED_SCANS) or "it holds no cloud"
        return Candidate((topic,), 0, f"cannot be decoded: {why}")
    points = max(clouds, key=len)
    described = f"{len(points)} points per scan"
    planar = PLANAR_SCANS.issuperset(recording.types_of(topic))
    if len(points) == 0:
        return Candidate((topic,), 0, "its first scans are empty")
    if "radar" in topic.lower() or (len(points) < FEW_POINTS and not planar):
        return Candidate((topic,), _POOR, f"only {described}: a radar rather than a lidar")
    if np.ptp(points[:, 2]) < FLAT_M:
        # Drivers publish the same scan as a cloud, too.
        return Candidate(
            (topic,), 3 if planar else 4, f"{described}, but flat: a 2-D scan, in which no ground can be found"
        )
    return Candidate((topic,), 5, f"{described} in 3-D")


def _in_world(candidate: Candidate, frame: str, placed: bool) -> Candidate:
    """A cloud whose frame is not the robot's: it serves where nothing else does, if the robot has a place in it."""
    if placed:
        why = f"{candidate.why}, in the frame {frame}, transformed to base"
        return Candidate(candidate.topics, min(candidate.rank, _WORLD), why)
    flag = set_flag("topics.lidar", candidate.topics)
    why = (
        f"is in the frame {frame}, in which neither tf nor odometry places the robot; if it is seen from base:  {flag}"
    )
    return Candidate(candidate.topics, 0, why)


COMPARED_SCANS, COMPARED_POINTS, COMPARED_MESSAGES = 12, 64, 600


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
    x_mm, y_mm, z_mm = np.round(_valid_points(cloud) * 1e3).astype(np.int64).T
    return np.unique(x_mm + (y_mm << 21) + (z_mm << 42))


def _clouds(samples: Sequence[object]) -> list[np.ndarray]:
    """The points of each cloud that can be returns."""
    return [_valid_points(cloud) for cloud in samples if isinstance(cloud, PointCloud)]


def _valid_points(cloud: PointCloud) -> np.ndarray:
    # NaN fails both comparisons.
    farthest_m = np.abs(cloud.xyz_m).max(axis=1, initial=0)
    return cloud.xyz_m[(farthest_m > 0) & (farthest_m < NO_RETURN_M)]


TARGET_WORDS = ("auto", "uwb", "ahead", "fixed")
POSITION_WORDS = ("auto", "uwb", "tf", "odometry", "pose", "legs", "lidar", "fixed")  # auto: the first that is there
NO_REFERENCE = "none"
KINDS: dict[str, tuple[tuple[type[Message], ...], str]] = {
    "position": ((Pose, Odometry), "a pose"),
    "lidar": ((PointCloud,), "a point cloud"),
    "uwb": ((UwbRanges,), "UWB ranges"),
    "odometry": ((Pose, Odometry), "odometry"),
    "imu": ((Imu,), "an IMU"),
    "joints": ((JointStates,), "the joints of a robot"),
    "reference": ((Pose, Odometry), "a pose"),
    "target": ((Pose, Odometry), "a pose"),
    "tf": ((Transforms,), "transforms"),
}


@dataclass(frozen=True, slots=True)
class Role:
    """The topics that play a role, and why they do, in one line."""

    name: str
    topics: tuple[str, ...]
    why: str


@dataclass(frozen=True, slots=True)
class Roles:
    """What `detect_roles` found.

    ambiguous: role -> the choices that could play it equally well, each one topic or several that belong together.
    unused: topic -> why a topic that looks fit plays no role; near: topic -> the role it looks fit for.
    targets: pose topics named as something followed. frames: what a look at the transforms shows; other_tf: topics of
    transforms of each other robot.
    """

    found: Mapping[str, Role]
    ambiguous: Mapping[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)
    unused: Mapping[str, str] = field(default_factory=dict)
    near: Mapping[str, str] = field(default_factory=dict)
    targets: tuple[str, ...] = ()
    frames: TransformTree = field(default_factory=TransformTree, compare=False)
    other_tf: tuple[tuple[str, ...], ...] = ()
    _role_of: dict[str, Role] = field(init=False, repr=False, compare=False, default_factory=dict)
    _choice_of: dict[str, tuple[str, tuple[str, ...]]] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    def __post_init__(self) -> None:
        for role in self.found.values():
            for topic in role.topics:
                self._role_of.setdefault(topic, role)
        for name, choices in self.ambiguous.items():
            for topics in choices:
                for topic in topics:
                    self._choice_of.setdefault(topic, (name, topics))

    def topics(self, role: str) -> tuple[str, ...]:
        """The topics of a role, none where nobody plays it. Raises AmbiguousTopic where a choice is needed."""
        if role in self.ambiguous:
            raise AmbiguousTopic(role, self.ambiguous[role])
        return self.found[role].topics if role in self.found else ()

    def topic(self, role: str) -> str | None:
        """The one topic of a role, or None. Raises AmbiguousTopic where a choice is needed."""
        return next(iter(self.topics(role)), None)

    def of_topic(self, topic: str) -> tuple[str | None, str]:
        """The role a topic plays, and why it does or does not."""
        if topic in self._role_of:
            mine = [role for role in self.found.values() if topic in role.topics]
            return ", ".join(role.name for role in mine), "; ".join(dict.fromkeys(role.why for role in mine))
        if topic in self._choice_of:
            name, topics = self._choice_of[topic]
            count = len(self.ambiguous[name])
            return None, f"one of {count} that could be the {name}: {set_flag(f'topics.{name}', topics)}"
        if topic in self.targets:
            return None, f"could be the target: {set_flag('topics.target', [topic])}"
        return None, self.unused.get(topic, "")

    @property
    def unused_truths(self) -> dict[str, str]:
        """Topic -> why it is not the reference, of those named as ground truth, where nothing else is."""
        return {
            topic: why
            for topic, why in self.unused.items()
            if self.near.get(topic) == "reference" and "reference" not in self.found and names_truth(topic)
        }

    @property
    def played(self) -> list[str]:
        """Topics with a role, without static transforms, whose stamps may be of any time."""
        return [topic for role in self.found.values() for topic in role.topics if not is_static(topic)]

    def base_in_map(self, topics: Topics) -> tuple[str, str] | None:
        """The robot's frame and the frame that is the map, by a look at the transforms; None if it does not move."""
        base = self.frames.base_frame(topics.base_frame)
        frame = None if base is None else self.frames.fixed_frame(base, topics.map_frame)
        return None if base is None or frame is None else (base, frame)

    def choices(self, role: str) -> str:
        """One line with the flags that settle a role several topics could play; empty where nothing is to choose."""
        choices = self.ambiguous.get(role, ())
        if role == "target" and role not in self.found:
            choices = tuple((topic,) for topic in self.targets)
        return str(AmbiguousTopic(role, choices)) if choices else ""

    def why_unfit(self, role: str) -> str:
        """The choice for a role, or why topics that look fit for it are not; empty where there is none."""
        unfit = [f"{topic} {why}" for topic, why in self.unused.items() if self.near.get(topic) == role]
        more = [f"and {len(unfit) - MAX_LISTED} more"] if len(unfit) > MAX_LISTED else []
        return self.choices(role) or "; ".join([*unfit[:MAX_LISTED], *more])

    def why_none(self, role: str) -> str:
        """The message for a role that no topic has."""
        words = "" if role in self.ambiguous else f"no topic is fit to be the {role}"
        return "; ".join(filter(None, [words, self.why_unfit(role)]))


def detect_roles(recording: Recording, topics: Topics) -> Roles:
    """The roles of a recording's topics; what the configuration names is taken, the rest is detected.

    Raises UnknownTopic for a configured topic that is not there or of another
    kind. Ambiguity is data here: it is raised where the role is needed.
    """
    usable, unused = _usable(recording)
    found: dict[str, Role] = {}
    ambiguous: dict[str, tuple[tuple[str, ...], ...]] = {}
    for role, chosen in _configured(recording, topics).items():
        fields = [found_words(recording, name) for topic in chosen for name in recording.types_of(topic)]
        found[role] = Role(role, chosen, "; ".join(["chosen in the configuration", *filter(None, fields)]))
        if role == "joints" and (why := recording.why_unsampled(chosen[0], SAMPLED_JOINTS)) is not None:
            raise UnknownTopic(role, chosen[0], _fitting(recording, role, chosen[0]), f"cannot be used: it {why}")
    taken = {topic for role in found.values() for topic in role.topics}
    # A message that holds several kinds can play several roles.
    free = {topic: name for topic, name in usable.items() if topic not in taken or len(kinds_of(name)) > 1}

    bodies = _frames_of(recording, Odometry, usable, taken)
    seen = bodies | _frames_of(recording, PointCloud, usable, taken)
    if "tf" in found:
        transforms, other_tf = found["tf"].topics, tuple[tuple[str, ...], ...]()
    else:
        transforms, other_tf = _of_one_robot(recording, usable, taken, seen)
    frames = look_at_frames(recording, transforms)
    frames.seen, frames.bodies = seen, bodies
    for robot in other_tf:
        why = f"not used: of another robot than {transforms[0]}: {set_flag('topics.tf', robot)}"
        unused |= {topic: why for topic in robot if topic not in transforms}
    if "lidar" not in found:
        clouds = [topic for topic, name in free.items() if PointCloud in kinds_of(name)]
        odometries = [topic for topic, name in free.items() if Odometry in kinds_of(name)]
        first = [each for topic in odometries for each in recording.sample(topic, 1)]
        pose_frames = {each.frame_id for each in first if isinstance(each, Odometry)}
        seen_by = frames, frames.base_frame(topics.base_frame), pose_frames
        _settle("lidar", look_at_clouds(recording, clouds, *seen_by), found, ambiguous, unused)
    if "uwb" not in found:
        _settle("uwb", uwb_candidates(recording, free, unused), found, ambiguous, unused)
    for role, kind in (("odometry", Odometry), ("imu", Imu)):
        if role not in found:
            _settle(role, _by_kind(recording, role, kind, free), found, ambiguous, unused)
    if "joints" not in found:
        legged = [(topic, name) for topic, name in free.items() if JointStates in kinds_of(name)]
        _settle("joints", [_judge_joints(recording, *each) for each in legged], found, ambiguous, unused)
    if transforms and "tf" not in found:
        found["tf"] = Role("tf", transforms, several(len(transforms), "topic") + " of transforms")
    if topics.reference != NO_REFERENCE and "reference" not in found:
        # What is the robot's position is not its own truth.
        positions = [topic for role in ("position", "odometry") if role in found for topic in found[role].topics]
        sources = {topic: usable[topic] for topic in positions if topic in usable}
        _settle("reference", _by_kind(recording, "reference", Pose, free | sources), found, ambiguous, unused)
        _part_from_sources(sources, found, ambiguous)
        _keep_on_one_clock(recording, found, unused)
    if estimates := _estimates(free):
        found["pose"] = Role("pose", *estimates)
    targets = tuple(topic for topic, name in free.items() if Pose in kinds_of(name) and is_target_name(topic))
    near = {each.topic: fit for each in recording.channels if (fit := nearest_role(each.type_name))}
    near |= {each.topic: "reference" for each in recording.channels if each.type_name in recording.found_poses}
    unused = {topic: why for topic, why in unused.items() if topic in near}
    roles = Roles(found, ambiguous, unused, near, targets, frames, other_tf)
    _compare_clocks(recording, roles, topics)
    return roles


def _compare_clocks(recording: Recording, roles: Roles, topics: Topics) -> None:
    """Compare the clocks of what is used together: of tf the transform that moves base, of poses a lone one."""
    placed, tf = roles.base_in_map(topics), roles.found["tf"].topics if "tf" in roles.found else ()
    moving = [] if placed is None else [edge for edge in roles.frames.moving(*placed) if not edge.is_still]
    lone = topics.position == "pose" or not {"uwb", "tf", "odometry"} & roles.found.keys()
    names = {"reference"} if lone else {"reference", "pose"}
    reported = {topic for name in names & roles.found.keys() for topic in roles.found[name].topics}
    compared = {*roles.played, *(f"{edge.parent} -> {edge.child} of {edge.topic}" for edge in moving[:1])} - reported
    recording.compare_clocks(roles.played, tf, compared, reported)


def _frames_of(
    recording: Recording, kind: type[Odometry | PointCloud], usable: Mapping[str, str], chosen: Collection[str]
) -> set[str]:
    """The frames that messages of a kind are of, by the first of each topic; of chosen topics where there are."""
    topics = [topic for topic, name in usable.items() if kind in kinds_of(name)]
    topics = [topic for topic in topics if topic in chosen] or topics
    samples = [each for topic in topics for each in recording.sample(topic, 1) if isinstance(each, kind)]
    return {each.child_frame_id if isinstance(each, Odometry) else each.frame_id for each in samples}


def _of_one_robot(
    recording: Recording, usable: Mapping[str, str], chosen: set[str], seen: set[str]
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """The topics of transforms of one robot, and those of each other one.

    Those of a namespace belong together, and static ones without a namespace to all. It is the robot in whose namespace
    most topics are, chosen ones first, or that has the frames that are seen; what does not contradict it belongs to it.
    """
    tf = tuple(topic for topic, name in usable.items() if Transforms in kinds_of(name))
    shared = tuple(topic for topic in tf if is_static(topic) and topic.rfind("/") < 1)
    spaces: dict[str, tuple[str, ...]] = {}
    for topic in tf:
        if topic not in shared:
            space = topic.rpartition("/")[0]
            spaces[space] = (*spaces.get(space, shared), topic)
    if len(spaces) < 2:
        return tf, ()
    trees = {space: look_at_frames(recording, own) for space, own in spaces.items()}
    others = {topic for topic, name in usable.items() if kinds_of(name)}.difference(tf)
    home = {t: max((space for space in spaces if t.startswith(f"{space}/")), key=len, default="") for t in others}

    def fit(space: str) -> tuple[int, int, int]:
        inside = {topic for topic in home if home[topic] == space}
        return len(inside & chosen), len(inside), len(seen.intersection(trees[space].frames))

    mine = max(spaces, key=fit)
    robots = tuple(own for space, own in spaces.items() if trees[mine].contradicts(trees[space]))
    left_out = {topic for own in robots for topic in own}.difference(shared)
    return tuple(topic for topic in tf if topic not in left_out), robots


def _estimates(free: Mapping[str, str]) -> tuple[tuple[str, ...], str] | None:
    """The topics of poses that estimators may have made, and what they are for; None without any."""
    topics = [topic for topic, name in free.items() if Pose in kinds_of(name) and is_measured(topic)]
    topics = [topic for topic in topics if not names_truth(topic)]
    if len(topics) == 1:
        return tuple(topics), f"the only {free[topics[0]]} without a name of truth: an estimate"
    why = f"one of {len(topics)} estimates of a pose; topics.position takes one as the robot's position"
    return (tuple(topics), why) if topics else None


def position_topics(recording: Recording) -> list[str]:
    """The topics that topics.position could name, without those that by their names are not the robot's poses."""
    fits = [
        each.topic for each in recording.channels if each.count != 0 and _fits(recording, "position", each.type_name)
    ]
    return sorted({topic for topic in fits if is_measured(topic)})


def _part_from_sources(
    sources: Collection[str], found: dict[str, Role], ambiguous: dict[str, tuple[tuple[str, ...], ...]]
) -> None:
    """No reference where a source would be it. Those as fit as a source may be of another body: a user must choose."""
    if "reference" in found and found["reference"].topics[0] in sources:
        del found["reference"]
    others = tuple(choice for choice in ambiguous.pop("reference", ()) if choice[0] not in sources)
    if others:
        ambiguous["reference"] = others


def _keep_on_one_clock(recording: Recording, found: dict[str, Role], unused: dict[str, str]) -> None:
    """No detected reference whose stamps, or log times without stamps, are of a clock that no other topic has."""
    reference = found["reference"].topics if "reference" in found else ()
    topics = {each for role in found.values() for each in role.topics if not is_static(each)}
    others = topics.difference(reference)
    if not reference or not others:
        return
    (topic,) = reference
    apart_ns = [abs(recording.usual_offset_ns(each) - recording.usual_offset_ns(topic)) for each in others]
    if min(apart_ns) > FAR_APART_NS:
        del found["reference"]
        unused[topic] = f"not used: its times lie {min(apart_ns) * 1e-9:.0f} s from all others"


def _usable(recording: Recording) -> tuple[dict[str, str], dict[str, str]]:
    """Topic -> type of those with messages of one type; topic -> why of the others that look fit."""
    usable: dict[str, str] = {}
    unused: dict[str, str] = {}
    for topic in sorted({channel.topic for channel in recording.channels}):
        types = recording.types_of(topic)
        pose = recording.found_poses.get(types[0])
        why = f"carries several types ({some_of(types)})" if len(types) > 1 else refusal(types[0])
        why = why or (pose if isinstance(pose, str) else None)
        if why is None and all(channel.count == 0 for channel in recording.channels_of(topic)):
            why = "has no messages"
        why = why or recording.why_undecodable(topic)
        if why is None:
            usable[topic] = types[0]
        else:
            unused[topic] = why
    return usable, unused


def found_words(recording: Recording, type_name: str) -> str:
    """The type and the field of a pose that was found by the definition; empty for other types."""
    field = recording.found_poses.get(type_name)
    return f"{type_name}, its pose in {field.name}" if isinstance(field, PoseField) else ""


def _configured(recording: Recording, topics: Topics) -> dict[str, tuple[str, ...]]:
    """Role -> topics, for the roles that the configuration settles."""
    chosen: dict[str, tuple[str, ...]] = {}
    for role in ("lidar", "odometry", "imu", "joints", "reference"):
        topic = getattr(topics, role)
        if topic and (role, topic) != ("reference", NO_REFERENCE):
            chosen[role] = (topic,)
    for role in ("uwb", "tf"):
        if names := getattr(topics, role):
            chosen[role] = tuple(names)
    if topics.target not in TARGET_WORDS:
        chosen["target"] = (topics.target,)
    if topics.position not in POSITION_WORDS and recording.types_of(topics.position):
        chosen["position"] = (topics.position,)
    for role, names in chosen.items():
        for topic in names:
            _check_configured(recording, role, topic)
    for source in ("position", "odometry"):
        if "reference" in chosen and chosen.get(source) == chosen["reference"]:
            why = f"is topics.{source}, which is measured against the reference"
            raise UnknownTopic("reference", topics.reference, _fitting(recording, "reference", topics.reference), why)
    return chosen


def _check_configured(recording: Recording, role: str, topic: str) -> None:
    types = recording.types_of(topic)
    choices = _fitting(recording, role, topic)
    if not types:
        raise UnknownTopic(role, topic, choices or sorted({channel.topic for channel in recording.channels}))
    if len(types) > 1:
        raise UnknownTopic(role, topic, choices, f"carries several types ({some_of(types)})")
    if not _fits(recording, role, types[0]):
        raise UnknownTopic(role, topic, choices, f"is {types[0]}, not {KINDS[role][1]}")


def _fitting(recording: Recording, role: str, topic: str) -> list[str]:
    """The other topics whose type fits a role."""
    topics = (channel.topic for channel in recording.channels if _fits(recording, role, channel.type_name))
    return [each for each in dict.fromkeys(topics) if each != topic]


def _fits(recording: Recording, role: str, type_name: str) -> bool:
    """By its kinds, or by the pose that the recording's own definition shows in a type that nobody else decodes."""
    found = isinstance(recording.found_poses.get(type_name), PoseField)
    return not set(KINDS[role][0]).isdisjoint((Pose,) if found else kinds_of(type_name))


def _by_kind(recording: Recording, role: str, kind: type[Message], free: Mapping[str, str]) -> list[Candidate]:
    """Topics of a kind of message; only a name that speaks of truth makes a reference, of whatever type.

    Such a topic is no odometry, nor is one that by its name is wanted rather than measured. A pose that was found by a
    definition is a reference by such a name of its topic or type, unless others are; without it a user must choose it.
    """
    candidates = []
    for topic, name in free.items():
        truth = names_truth(topic)
        if role == "reference" and (words := found_words(recording, name)):
            if truth or names_truth(name):
                candidates.append(Candidate((topic,), _TRUTH - 1, f"{words}, named as ground truth"))
            else:
                why = f"not used: {words}, could be the reference: {set_flag('topics.reference', [topic])}"
                candidates.append(Candidate((topic,), 0, why))
        elif role == "reference" and truth and _fits(recording, role, name):
            candidates.append(Candidate((topic,), _TRUTH, f"{name}, named as ground truth"))
        elif role == "odometry" and kind in kinds_of(name) and not truth and not is_measured(topic):
            why = f"not used: not measured by its name; if it is, {set_flag('topics.odometry', [topic])}"
            candidates.append(Candidate((topic,), 0, why))
        elif role != "reference" and kind in kinds_of(name) and not (role == "odometry" and truth):
            why = f"in {name}" if name in BODY_KINDS else f"the only {name}"
            candidates.append(Candidate((topic,), 1 + _rank_of(topic, name), why))
    return candidates


def _rank_of(topic: str, type_name: str) -> int:
    """How well a topic of several kinds serves; those for one thing serve best.

    A robot's own /lf/ topics repeat others at a lower rate.
    """
    if type_name not in BODY_KINDS:
        return 6
    by_type = {"LowState": 5, "SportModeState": 3, "HighState": 1}.get(last_part(type_name), 5)
    return by_type - ("lf" in topic.split("/"))


def _judge_joints(recording: Recording, topic: str, type_name: str) -> Candidate:
    """How well a topic with joints serves, by its first messages; one with the feet's forces is best."""
    why = recording.why_unsampled(topic, SAMPLED_JOINTS)
    if why is not None:
        return Candidate((topic,), 0, why)
    if not any(isinstance(each, JointStates) for each in recording.sample(topic, SAMPLED_JOINTS)):
        return Candidate((topic,), 0, "holds no joints")
    used = recording.joints.used.get(topic)
    left_out = () if used is None else used.left_out
    others = f", others are left out: {some_of(left_out)}" if left_out else ""
    # Where both are recorded, a driver makes the JointState of the LowState, without the feet.
    rank = 4 if last_part(type_name) == "JointState" else 1 + _rank_of(topic, type_name)
    return Candidate((topic,), rank, f"12 joints of four legs in {type_name}{others}")


def _settle(
    role: str,
    candidates: list[Candidate],
    found: dict[str, Role],
    ambiguous: dict[str, tuple[tuple[str, ...], ...]],
    unused: dict[str, str],
) -> None:
    """The best candidate plays the role, if there is one best; for the others the reason is noted."""
    best = max((each.rank for each in candidates), default=0)
    top = [each for each in candidates if each.rank == best]
    if best > 0 and len(top) == 1:
        found[role] = Role(role, top[0].topics, top[0].why)
    elif best > 0:
        ambiguous[role] = tuple(each.topics for each in top)
    for each in candidates:
        if each.rank < best or best == 0:
            # What is fit, but for another topic.
            beside = f"; {top[0].topics[0]} is better" if role == "joints" and 0 < each.rank < best else ""
            unused.update(dict.fromkeys(each.topics, each.why + beside))
