"""A recording as it is looked at to give roles to its topics, and the candidates for a role among them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from quadlog.config.schema import Topics
from quadlog.errors import AmbiguousTopic, set_flag, some_of
from quadlog.messages import Message, Odometry, PointCloud, Pose, Transforms
from quadlog.recordings.decoders.pose_fields import FoundPose
from quadlog.recordings.decoding import kinds_of
from quadlog.recordings.recording import Kind, Recording
from quadlog.recordings.streams import look_at_frames
from quadlog.recordings.tf_tree import TransformTree, is_static
from quadlog.recordings.topics.topic_names import is_target_name, names_truth
from quadlog.recordings.topics.unread import nearest_role, unread


@dataclass(frozen=True, slots=True)
class Candidate:
    """Topics that could play a role together, and why, in one line. rank: 0 unfit, then the higher the better.

    is_source: the robot's position is made of them, so that neither they nor what is as fit is taken unasked.
    """

    topics: tuple[str, ...]
    rank: int
    why: str
    is_source: bool = False


@dataclass(eq=False)
class Roles:
    """Which topic plays which role, and why; so far, for judges of topics, which may look at the recording.

    wanted: by the configuration. found: role -> its topics. ambiguous: role -> the choices that could play it equally
    well, each one topic or several that belong together. reasons: topic -> why it plays no role.
    """

    recording: Recording
    wanted: Topics
    found: dict[str, Candidate] = field(default_factory=dict)
    ambiguous: dict[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)

    @cached_property
    def usable(self) -> dict[str, str]:
        """Topic -> type, of topics whose messages are of one type and can be decoded; see `reasons` of others."""
        usable: dict[str, str] = {}
        for topic in sorted({channel.topic for channel in self.recording.channels}):
            types = self.recording.types_of(topic)
            if (why := self._why_unusable(topic, types)) is None:
                usable[topic] = types[0]
            else:
                self.reasons[topic] = why
        return usable

    def _why_unusable(self, topic: str, types: list[str]) -> str | None:
        if len(types) > 1:
            return f"carries several types ({some_of(types)})"
        row = unread(self.recording.channels_of(topic)[0], self.recording.mapped)
        if row is not None and row.role:
            return row.words
        if isinstance(pose := self.recording.found_poses.get(types[0]), str):
            return pose
        if all(channel.count == 0 for channel in self.recording.channels_of(topic)):
            return "has no messages"
        return self.recording.why_undecodable(topic)

    @cached_property
    def chosen(self) -> frozenset[str]:
        """Topics to which the configuration gives a role."""
        return frozenset(topic for role in self.found.values() for topic in role.topics)

    @cached_property
    def free(self) -> dict[str, str]:
        """Topic -> type, of usable topics that may play a role; one whose messages hold several kinds can have more."""
        return {t: name for t, name in self.usable.items() if t not in self.chosen or len(self.kinds(t)) > 1}

    def kinds(self, topic: str) -> tuple[type[Message], ...]:
        """What the messages of a topic become, the main kind first."""
        channels, name = self.recording.channels_of(topic), self.recording.types_of(topic)[0]
        return next(kinds_of(each, self.recording.mapped) for each in channels if each.type_name == name)

    def of_kind(self, kind: type[Message], *, taken: bool = False) -> dict[str, str]:
        """Topic -> type, of free topics whose messages hold a kind; taken: of all usable ones."""
        return {t: name for t, name in (self.usable if taken else self.free).items() if kind in self.kinds(t)}

    def first(self, kind: type[Kind], topics: Iterable[str], count: int = 1) -> dict[str, list[Kind]]:
        """What the first few messages of topics hold of a kind."""
        return {topic: self.recording.sample(topic, count, kind) for topic in topics}

    def found_words(self, type_name: str) -> str:
        """The type and the field of a pose that was found by the definition; empty for other types."""
        field = self.recording.found_poses.get(type_name)
        return f"{type_name}, its pose in {field.name}" if isinstance(field, FoundPose) else ""

    def frames_of(self, kind: type[Odometry | PointCloud]) -> set[str]:
        """The frames that messages of a kind are of, by the first of each topic; of chosen topics where there are."""
        topics = [*self.of_kind(kind, taken=True)]
        first = self.first(kind, [topic for topic in topics if topic in self.chosen] or topics).values()
        return {each.child_frame_id if isinstance(each, Odometry) else each.frame_id for some in first for each in some}

    @cached_property
    def frames(self) -> TransformTree:
        """What a look at the robot's transforms shows."""
        frames = look_at_frames(self.recording, self.transforms[0])
        frames.configured = self.wanted.base_frame
        frames.bodies = self.frames_of(Odometry)
        frames.seen = frames.bodies | self.frames_of(PointCloud)
        return frames

    @cached_property
    def transforms(self) -> tuple[tuple[str, ...], ...]:
        """The topics of the robot's transforms, first, and those of each other robot.

        Those of a namespace belong together, and static ones without a namespace to all. It is the robot in whose
        namespace most topics are, chosen ones first, or that has the frames that clouds and odometry are of; what does
        not contradict it belongs to it.
        """
        if "tf" in self.found:
            return (self.found["tf"].topics,)
        tf = tuple(self.of_kind(Transforms, taken=True))
        shared = tuple(topic for topic in tf if is_static(topic) and topic.rfind("/") < 1)
        spaces: dict[str, tuple[str, ...]] = {}
        for topic in tf:
            if topic not in shared:
                space = topic.rpartition("/")[0]
                spaces[space] = (*spaces.get(space, shared), topic)
        if len(spaces) < 2:
            return (tf,)
        trees = {space: look_at_frames(self.recording, own) for space, own in spaces.items()}
        seen = self.frames_of(Odometry) | self.frames_of(PointCloud)
        others = self.usable.keys() - tf
        home = {t: max((space for space in spaces if t.startswith(f"{space}/")), key=len, default="") for t in others}

        def fit(space: str) -> tuple[int, int, int]:
            inside = {topic for topic in home if home[topic] == space}
            return len(inside & self.chosen), len(inside), len(seen.intersection(trees[space].frames))

        mine = max(spaces, key=fit)
        robots = tuple(own for space, own in spaces.items() if trees[mine].contradicts(trees[space]))
        left_out = {topic for own in robots for topic in own}.difference(shared)
        return (tuple(topic for topic in tf if topic not in left_out), *robots)

    def settle(self, role: str, candidates: Sequence[Candidate]) -> None:
        """The best candidate plays the role, if there is one best; several are a choice. Others get their reason."""
        best = max((each.rank for each in candidates), default=0)
        top = [each for each in candidates if each.rank == best > 0]
        free = [each for each in top if not each.is_source]
        if len(free) == len(top) == 1:
            self.found[role] = free[0]
        elif free:
            self.ambiguous[role] = tuple(each.topics for each in free)
        for each in candidates:
            if each not in top:
                # What is fit, but for another topic.
                beside = f"; {top[0].topics[0]} is better" if role == "joints" and each.rank else ""
                self.reasons.update(dict.fromkeys(each.topics, each.why + beside))

    @cached_property
    def near(self) -> dict[str, str]:
        """Topic -> the role that it looks fit for."""
        channels, mapped = self.recording.channels, self.recording.mapped
        near = {each.topic: fit for each in channels if (fit := nearest_role(each, mapped))}
        return near | {each.topic: "reference" for each in channels if each.type_name in self.recording.found_poses}

    @property
    def unused(self) -> dict[str, str]:
        """Topic -> why a topic that looks fit plays no role."""
        return {topic: why for topic, why in self.reasons.items() if topic in self.near}

    @cached_property
    def targets(self) -> tuple[str, ...]:
        """Pose topics named as something followed."""
        return tuple(t for t, name in self.of_kind(Pose).items() if is_target_name(t) and not self.found_words(name))

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

    @property
    def base_in_map(self) -> tuple[str, str] | None:
        """The robot's frame and the frame that is the map, by a look at the transforms; None if it does not move."""
        base = self.frames.base
        frame = None if base is None else self.frames.fixed_frame(base, self.wanted.map_frame)
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
