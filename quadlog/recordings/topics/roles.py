"""Which topic plays which role, by type and content, and why; nothing is chosen that could as well be another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from quadlog.config.schema import Topics
from quadlog.errors import AmbiguousTopic, UnknownTopic, set_flag, some_of
from quadlog.messages import Pose
from quadlog.recordings.clocks.clock_offsets import stream_name
from quadlog.recordings.recording import Recording
from quadlog.recordings.tf_tree import TransformTree, is_static
from quadlog.recordings.topics.judges import JUDGES, KINDS, fits, why_no_joints
from quadlog.recordings.topics.look import Candidate, Look
from quadlog.recordings.topics.topic_names import is_measured, is_target_name, names_truth
from quadlog.recordings.topics.unread import nearest_role

TARGET_WORDS = ("auto", "uwb", "ahead", "fixed")
POSITION_WORDS = ("auto", "uwb", "tf", "odometry", "pose", "legs", "lidar", "gnss", "twist", "fixed")
"""Sources of the robot's position; auto: the first that is there."""
LONE_SOURCES = ("pose", "gnss", "twist")
"""Those that need to be the only topic of their kind."""
NO_REFERENCE = "none"


@dataclass(frozen=True)
class Roles:
    """What `detect_roles` found.

    ambiguous: role -> the choices that could play it equally well, each one topic or several that belong together.
    unused: topic -> why a topic that looks fit plays no role; near: topic -> the role it looks fit for.
    targets: pose topics named as something followed. frames: what a look at the transforms shows; other_tf: topics of
    transforms of each other robot.
    """

    found: Mapping[str, Candidate]
    ambiguous: Mapping[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)
    unused: Mapping[str, str] = field(default_factory=dict)
    near: Mapping[str, str] = field(default_factory=dict)
    targets: tuple[str, ...] = ()
    frames: TransformTree = field(default_factory=TransformTree, compare=False)
    other_tf: tuple[tuple[str, ...], ...] = ()

    def topics(self, role: str) -> tuple[str, ...]:
        """The topics of a role, none where nobody plays it. Raises AmbiguousTopic where a choice is needed."""
        if role in self.ambiguous:
            raise AmbiguousTopic(role, self.ambiguous[role])
        return self.found[role].topics if role in self.found else ()

    def topic(self, role: str) -> str | None:
        """The one topic of a role, or None. Raises AmbiguousTopic where a choice is needed."""
        return next(iter(self.topics(role)), None)

    @cached_property
    def _said(self) -> dict[str, tuple[str | None, str]]:
        """What there is to say of each topic, the most important last."""
        said: dict[str, tuple[str | None, str]] = {topic: (None, why) for topic, why in self.unused.items()}
        said |= {t: (None, f"could be the target: {set_flag('topics.target', [t])}") for t in self.targets}
        for name, choices in reversed([*self.ambiguous.items()]):
            words = f"one of {len(choices)} that could be the {name}"
            flags = [(topics, set_flag(f"topics.{name}", topics)) for topics in reversed(choices)]
            said |= {topic: (None, f"{words}: {flag}") for topics, flag in flags for topic in topics}
        for topic in {topic for role in self.found.values() for topic in role.topics}:
            mine = {name: role.why for name, role in self.found.items() if topic in role.topics}
            said[topic] = ", ".join(mine), "; ".join(dict.fromkeys(mine.values()))
        return said

    def of_topic(self, topic: str) -> tuple[str | None, str]:
        """The role a topic plays, and why it does or does not."""
        return self._said.get(topic, (None, ""))

    @property
    def unused_truths(self) -> dict[str, str]:
        """Topic -> why it is not the reference, of those named as ground truth, where nothing else is."""
        if "reference" in self.found:
            return {}
        return {t: why for t, why in self.unused.items() if self.near.get(t) == "reference" and names_truth(t)}

    @property
    def played(self) -> list[str]:
        """Topics with a role, without static transforms, whose stamps may be of any time."""
        return [topic for role in self.found.values() for topic in role.topics if not is_static(topic)]

    def base_in_map(self, topics: Topics) -> tuple[str, str] | None:
        """The robot's frame and the frame that is the map, by a look at the transforms; None if it does not move."""
        base = self.frames.base
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
        return self.choices(role) or some_of(unfit, between="; ")

    def why_none(self, role: str) -> str:
        """The message for a role that no topic has; empty for one that some topic has."""
        if role in self.found:
            return ""
        words = "" if role in self.ambiguous else f"no topic is fit to be the {role}"
        return "; ".join(filter(None, [words, self.why_unfit(role)]))


def detect_roles(recording: Recording, topics: Topics) -> Roles:
    """The roles of a recording's topics; what the configuration names is taken, the rest is detected.

    Raises UnknownTopic for a configured topic that is not there or of another
    kind. Ambiguity is data here: it is raised where the role is needed.
    """
    look = Look(recording, topics)
    for role, names in configured_topics(recording, topics).items():
        fields = [look.found_words(name) for topic in names for name in recording.types_of(topic)]
        look.found[role] = Candidate(names, 1, "; ".join(["chosen in the configuration", *filter(None, fields)]))
        if role == "joints" and (why := why_no_joints(recording, names[0])) is not None:
            raise UnknownTopic(role, names[0], _fitting(recording, role, names[0]), f"cannot be used: it {why}")
    for role, judge in JUDGES.items():
        if role not in look.found and (role, topics.reference) != ("reference", NO_REFERENCE):
            look.settle(role, judge(look))
    near = {each.topic: fit for each in recording.channels if (fit := nearest_role(each, recording.mapped))}
    near |= {each.topic: "reference" for each in recording.channels if each.type_name in recording.found_poses}
    unused = {topic: why for topic, why in look.unused.items() if topic in near}
    targets = tuple(t for t, n in look.of_kind(Pose).items() if is_target_name(t) and not look.found_words(n))
    roles = Roles(look.found, look.ambiguous, unused, near, targets, look.frames, look.transforms[1:])
    _compare_clocks(recording, roles, topics)
    return roles


def _compare_clocks(recording: Recording, roles: Roles, topics: Topics) -> None:
    """Compare the clocks of what is used together: of tf the transform that moves base, of poses a lone one."""
    placed, tf = roles.base_in_map(topics), roles.found["tf"].topics if "tf" in roles.found else ()
    moving = [] if placed is None else [edge for edge in roles.frames.moving(*placed) if not edge.is_still]
    lone = topics.position in LONE_SOURCES or not {"uwb", "tf", "odometry"} & roles.found.keys()
    names = {"reference"} if lone else {"reference", *LONE_SOURCES}
    reported = {topic for name in names & roles.found.keys() for topic in roles.found[name].topics}
    compared = {*roles.played, *(stream_name(edge.topic, edge.parent, edge.child) for edge in moving[:1])} - reported
    recording.compare_clocks(roles.played, tf, compared, reported)


def position_topics(recording: Recording) -> list[str]:
    """The topics that topics.position could name, without those that by their names are not the robot's poses."""
    sent = [each for each in recording.channels if each.count != 0 and is_measured(each.topic)]
    return sorted({each.topic for each in sent if fits(recording, "position", each)})


def configured_topics(recording: Recording, topics: Topics) -> dict[str, tuple[str, ...]]:
    """Role -> topics, for the roles that the configuration settles. Raises UnknownTopic."""
    named: dict[str, list[str]] = {role: [getattr(topics, role)] for role in ("odometry", "imu", "joints")}
    named["reference"] = [] if topics.reference == NO_REFERENCE else [topics.reference]
    named |= {"lidar": topics.lidar, "uwb": topics.uwb, "tf": topics.tf}
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
