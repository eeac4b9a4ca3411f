"""Which topic plays which role, by type and content, and why; nothing is chosen that could as well be another."""

from __future__ import annotations

from quadlog.config.schema import Topics
from quadlog.errors import UnknownTopic, some_of
from quadlog.recordings.clocks.clock_offsets import stream_name
from quadlog.recordings.recording import Recording
from quadlog.recordings.topics.judges import JUDGES, KINDS, fits, why_no_joints
from quadlog.recordings.topics.look import Candidate, Roles
from quadlog.recordings.topics.topic_names import is_measured

TARGET_WORDS = ("auto", "uwb", "ahead", "fixed")
POSITION_WORDS = ("auto", "uwb", "tf", "odometry", "pose", "legs", "lidar", "gnss", "twist", "fixed")
"""Sources of the robot's position; auto: the first that is there."""
LONE_SOURCES = ("pose", "gnss", "twist")
"""Those that need to be the only topic of their kind."""
NO_REFERENCE = "none"


def detect_roles(recording: Recording, topics: Topics) -> Roles:
    """The roles of a recording's topics; what the configuration names is taken, the rest is detected.

    Raises UnknownTopic for a configured topic that is not there or of another
    kind. Ambiguity is data here: it is raised where the role is needed.
    """
    look = Roles(recording, topics)
    for role, names in configured_topics(recording, topics).items():
        fields = [look.found_words(name) for topic in names for name in recording.types_of(topic)]
        look.found[role] = Candidate(names, 1, "; ".join(["chosen in the configuration", *filter(None, fields)]))
        if role == "joints" and (why := why_no_joints(recording, names[0])) is not None:
            raise UnknownTopic(role, names[0], _fitting(recording, role, names[0]), f"cannot be used: it {why}")
    for role, judge in JUDGES.items():
        if role not in look.found and (role, topics.reference) != ("reference", NO_REFERENCE):
            look.settle(role, judge(look))
    _compare_clocks(look)
    return look


def _compare_clocks(roles: Roles) -> None:
    """Compare the clocks of what is used together: of tf the transform that moves base, of poses a lone one."""
    placed = roles.base_in_map
    moving = [] if placed is None else [edge for edge in roles.frames.moving(*placed) if not edge.is_still]
    lone = roles.wanted.position in LONE_SOURCES or not {"uwb", "tf", "odometry"} & roles.found.keys()
    names = {"reference"} if lone else {"reference", *LONE_SOURCES}
    reported = {topic for name in names & roles.found.keys() for topic in roles.found[name].topics}
    compared = {*roles.played, *(stream_name(edge.topic, edge.parent, edge.child) for edge in moving[:1])} - reported
    roles.recording.compare_clocks(roles.played, roles.topics("tf"), compared, reported)


def position_topics(recording: Recording) -> list[str]:
    """The topics that topics.position could name, without those that by their names are not the robot's poses."""
    sent = [each for each in recording.channels if each.count != 0 and is_measured(each.topic)]
    return sorted({each.topic for each in sent if fits(recording, "position", each)})


def configured_topics(recording: Recording, topics: Topics) -> dict[str, tuple[str, ...]]:
    """Role -> topics, for the roles that the configuration settles. Raises UnknownTopic."""
    named: dict[str, list[str]] = {role: [getattr(topics, role)] for role in ("odometry", "imu", "joints")}
    named["reference"] = [] if topics.reference == NO_REFERENCE else [topics.reference]
    named |= {"lidar": topics.lidar, "uwb": topics.uwb, "tf": topics.tf}
    named["command"] = [] if topics.command == "auto" else [topics.command]
    named["target"] = [] if topics.target in TARGET_WORDS else [topics.target]
    by_topic = topics.position not in POSITION_WORDS and recording.types_of(topics.position)
    named["position"] = [topics.position] if by_topic else []
    chosen = {role: tuple(names) for role, names in named.items() if any(names)}
    for role, names in chosen.items():
        for topic in names:
            _check_configured(recording, role, topic)
    for source in ("position", "odometry"):
        if "reference" in chosen and chosen.get(source) == chosen["reference"]:
            why = f"is topics.{source}, which is measured against the reference"
            raise UnknownTopic("reference", topics.reference, _fitting(recording, "reference", topics.reference), why)
    return chosen


def _check_configured(recording: Recording, role: str, topic: str) -> None:
    types, choices = recording.types_of(topic), _fitting(recording, role, topic)
    if not types:
        raise UnknownTopic(role, topic, choices or sorted({channel.topic for channel in recording.channels}))
    if len(types) > 1:
        raise UnknownTopic(role, topic, choices, f"carries several types ({some_of(types)})")
    if not any(fits(recording, role, channel) for channel in recording.channels_of(topic)):
        raise UnknownTopic(role, topic, choices, f"is {types[0]}, not {KINDS[role][1]}")


def _fitting(recording: Recording, role: str, topic: str) -> list[str]:
    """The other topics whose type fits a role."""
    topics = (channel.topic for channel in recording.channels if fits(recording, role, channel))
    return [each for each in dict.fromkeys(topics) if each != topic]
