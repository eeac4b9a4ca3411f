"""How well topics serve for each role, by type, content and name."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from quadlog.errors import set_flag, some_of
from quadlog.messages import Imu, JointStates, Message, Odometry, PointCloud, Pose, Transforms, Twist, UwbRanges
from quadlog.recordings.clocks.clock_offsets import FAR_APART_NS
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoding import kinds_of
from quadlog.recordings.formatting import several
from quadlog.recordings.recording import Recording
from quadlog.recordings.tf_tree import is_static
from quadlog.recordings.topics.lidar_topics import judge_clouds
from quadlog.recordings.topics.look import Candidate, Roles
from quadlog.recordings.topics.topic_names import is_measured, name_words, names_truth
from quadlog.recordings.types import last_part

RANGE_TYPE, FIX_TYPE = "sensor_msgs/msg/Range", "sensor_msgs/msg/NavSatFix"
PLACES = {"geometry_msgs/msg/PointStamped", "geometry_msgs/msg/Pose2D"}
"""Types of poses that are often not the robot's: clicks on a map, found things."""
SAMPLED_JOINTS = 20
"""Drivers of arms and wheels may share the topic."""
VELOCITY_TYPES = {"geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped"}
COMMANDER_WORDS = {"teleop", "joy", "joystick", "key", "keyboard", "nav", "mux", "smoothed", "smoother", "planner"}
"""In names of topics whose velocities are wanted, beside those of `is_measured`."""
_TRUTH, _SINGLE = 10, 6
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
    "command": ((Twist, Odometry, Pose), "commands"),
}
"""Role -> what the configuration can name for it, in words."""


def fits(recording: Recording, role: str, channel: Channel) -> bool:
    """Whether the configuration may give a role to the topic of a channel, by what its messages become."""
    return not set(KINDS[role][0]).isdisjoint(kinds_of(channel, recording.mapped))


def judge_ranges(look: Roles) -> list[Candidate]:
    """One candidate for each type of ranges, with all its topics; none for a range whose ends nobody knows."""
    types: dict[str, list[str]] = {}
    nameless, why = [], "is a Range without tag and anchor; if it is UWB, map it in [[uwb.range_topics]]"
    for topic, name in look.of_kind(UwbRanges).items():
        if name == RANGE_TYPE and topic not in look.recording.mapped and look.recording.ends_of(topic) is None:
            nameless.append(Candidate((topic,), 0, why))
        else:
            types.setdefault(last_part(name), []).append(topic)
    return nameless + [
        Candidate(tuple(topics), 1, f"{len(topics)} topics of {kind}" if len(topics) > 1 else f"the only {kind}")
        for kind, topics in types.items()
    ]


def judge_odometry(look: Roles) -> list[Candidate]:
    """A topic named as truth is no odometry, nor is one that by its name is wanted rather than measured."""
    own = {t: name for t, name in look.of_kind(Odometry).items() if name not in VELOCITY_TYPES and not names_truth(t)}
    why = "not used: not measured by its name; if it is, "
    unfit = {t: Candidate((t,), 0, why + set_flag("topics.odometry", [t])) for t in own if not is_measured(t)}
    return [unfit.get(topic) or _by_type(look, topic, name) for topic, name in own.items()]


def judge_imus(look: Roles) -> list[Candidate]:
    """Every topic with an IMU."""
    return [_by_type(look, topic, name) for topic, name in look.of_kind(Imu).items()]


def _by_type(look: Roles, topic: str, type_name: str) -> Candidate:
    rank = _rank_of(look, topic, type_name)
    return Candidate((topic,), 1 + rank, f"the only {type_name}" if rank == _SINGLE else f"in {type_name}")


def _rank_of(look: Roles, topic: str, type_name: str) -> int:
    """How well a topic of several kinds serves; those for one thing serve best.

    A robot's own /lf/ topics repeat others at a lower rate.
    """
    kinds = look.kinds(topic)
    if len(kinds) == 1 and JointStates not in kinds:
        return _SINGLE
    by_type = {"LowState": 5, "SportModeState": 3, "HighState": 1}.get(last_part(type_name), 5)
    return by_type - ("lf" in topic.split("/"))


def judge_joints(look: Roles) -> list[Candidate]:
    """Every topic with joints, by its first messages; one with the feet's forces is best."""
    return [_of_legs(look, topic, name) for topic, name in look.of_kind(JointStates).items()]


def why_no_joints(recording: Recording, topic: str) -> str | None:
    """Why a topic's first messages show no joints of four legs, None where they do."""
    if recording.sample(topic, SAMPLED_JOINTS, JointStates):
        return None
    refused = recording.peek(topic, SAMPLED_JOINTS)[1] or recording.joints.refused.get(topic)
    return refused or "holds no joints"


def _of_legs(look: Roles, topic: str, type_name: str) -> Candidate:
    why = why_no_joints(look.recording, topic)
    if why is not None:
        return Candidate((topic,), 0, why)
    used = look.recording.joints.used.get(topic)
    left_out = () if used is None else used.left_out
    others = f", others are left out: {some_of(left_out)}" if left_out else ""
    # Where both are recorded, a driver makes the JointState of the LowState, without the feet.
    rank = 4 if last_part(type_name) == "JointState" else 1 + _rank_of(look, topic, type_name)
    return Candidate((topic,), rank, f"12 joints of four legs in {type_name}{others}")


def judge_transforms(look: Roles) -> list[Candidate]:
    """All topics of the robot's transforms together; those of other robots have a flag."""
    mine, *others = look.transforms
    candidates = [Candidate(mine, 1, several(len(mine), "topic") + " of transforms")] if mine else []
    for robot in others:
        why = f"not used: of another robot than {mine[0]}: {set_flag('topics.tf', robot)}"
        candidates.append(Candidate(tuple(topic for topic in robot if topic not in mine), 0, why))
    return candidates


def judge_references(look: Roles) -> list[Candidate]:
    """A topic of any type is a reference only by a name of truth.

    A pose that was found by a definition is one by such a name of its topic or type, unless others are; without it a
    user must choose it. What is the robot's position is not its own truth, nor is a topic on a clock of its own.
    """
    own = [topic for role in ("position", "odometry") if role in look.found for topic in look.found[role].topics]
    names = look.free | {topic: look.usable[topic] for topic in own if topic in look.usable}
    candidates = []
    for topic, name in names.items():
        words = look.found_words(name)
        if name in VELOCITY_TYPES or not {Pose, Odometry}.intersection(look.kinds(topic)):
            continue
        if names_truth(topic) or (words and names_truth(name)):
            rank, why = _TRUTH - bool(words), f"{words or name}, named as ground truth"
            if topic not in own and (apart_s := _apart_s(look, topic)):
                rank, why = 0, f"not used: its times lie {apart_s:.0f} s from all others"
            candidates.append(Candidate((topic,), rank, why, is_source=topic in own))
        elif words:
            why = f"not used: {words}, could be the reference: {set_flag('topics.reference', [topic])}"
            candidates.append(Candidate((topic,), 0, why))
    return candidates


def _apart_s(look: Roles, topic: str) -> float:
    """How far a topic's stamps, or log times without stamps, lie from those of all others in use; 0 for any delay."""
    others = {each for role in look.found.values() for each in role.topics if not is_static(each)}
    offset_ns = look.recording.usual_offset_ns(topic)
    apart_ns = [abs(look.recording.usual_offset_ns(each) - offset_ns) for each in sorted(others)]
    return nearest_ns * 1e-9 if (nearest_ns := min(apart_ns, default=0)) > FAR_APART_NS else 0.0


def judge_estimates(look: Roles) -> list[Candidate]:
    """All topics of poses that estimators may have made, together."""
    poses = {t: name for t, name in _measured(look).items() if name != FIX_TYPE}
    places = [t for t, name in poses.items() if name in PLACES and t not in look.recording.mapped]
    topics = [topic for topic in poses if topic not in places]
    alone = f"the only {poses[topics[0]]} without a name of truth: an estimate" if topics else ""
    return _together(topics, alone, "estimates of a pose", places, "not used: if it is the robot's position, ")


def judge_fixes(look: Roles) -> list[Candidate]:
    """All topics of satellite fixes, together."""
    topics = [topic for topic, name in _measured(look).items() if name == FIX_TYPE]
    alone = "satellite fixes as local metres, the robot's position where nothing else gives one"
    return _together(topics, alone, "topics of satellite fixes")


def judge_velocities(look: Roles) -> list[Candidate]:
    """All topics of velocities, together, without those that by their names are wanted rather than measured."""
    topics = [topic for topic, name in look.of_kind(Odometry).items() if name in VELOCITY_TYPES]
    wanted = [t for t in topics if not is_measured(t) or name_words(t) & COMMANDER_WORDS]
    alone = "velocities, integrated the robot's position where nothing else gives one"
    why = "a command by its name, not used; if it is the robot's measured velocity, "
    return _together([t for t in topics if t not in wanted], alone, "topics of velocities", wanted, why)


def judge_commands(look: Roles) -> list[Candidate]:
    """Every topic of velocities that are wanted, where commands are read."""
    stamped = [t for t, n in look.of_kind(Odometry).items() if n in VELOCITY_TYPES and not is_measured(t)]
    topics = [*look.of_kind(Twist), *stamped]
    if not look.wanted.command:
        unread = "a command; a simulated robot walks by it with  --controller command"
        return [Candidate((topic,), 0, unread) for topic in topics if topic not in look.unused]
    return [Candidate((topic,), 1, f"the only {look.free[topic]} of commands") for topic in topics]


def _together(
    topics: Sequence[str], alone: str, several: str, unfit: Sequence[str] = (), why_unfit: str = ""
) -> list[Candidate]:
    """All topics as one candidate, and why: of one alone, or of several. unfit: each as one that has to be chosen."""
    why = f"one of {len(topics)} {several}; topics.position takes one as the robot's position"
    together = [Candidate(tuple(topics), 1, alone if len(topics) == 1 else why)] if topics else []
    return [Candidate((t,), 0, why_unfit + set_flag("topics.position", [t])) for t in unfit] + together


def _measured(look: Roles) -> dict[str, str]:
    """Topic -> type, of poses that are not found by definition, nor named as truth or as wanted."""
    poses = look.of_kind(Pose).items()
    return {t: n for t, n in poses if is_measured(t) and not names_truth(t) and not look.found_words(n)}


JUDGES: dict[str, Callable[[Roles], Sequence[Candidate]]] = {
    "lidar": judge_clouds,
    "uwb": judge_ranges,
    "odometry": judge_odometry,
    "imu": judge_imus,
    "joints": judge_joints,
    "tf": judge_transforms,
    "reference": judge_references,
    "pose": judge_estimates,
    "gnss": judge_fixes,
    "twist": judge_velocities,
    "command": judge_commands,
}
"""Role -> its candidates, in the order in which roles are settled."""
