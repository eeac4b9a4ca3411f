"""A recording as it is looked at to give roles to its topics, and the candidates for a role among them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from quadlog.config.schema import Topics
from quadlog.errors import some_of
from quadlog.messages import Message, Odometry, PointCloud, Transforms
from quadlog.recordings.decoders.pose_fields import FoundPose
from quadlog.recordings.decoding import kinds_of
from quadlog.recordings.recording import Kind, Recording
from quadlog.recordings.streams import look_at_frames
from quadlog.recordings.tf_tree import TransformTree, is_static
from quadlog.recordings.topics.unread import unread


@dataclass(frozen=True, slots=True)
class Candidate:
    """Topics that could play a role together, and why, in one line. rank: 0 unfit, then the higher the better.

    is_source: the robot's position is made of them, so that neither they nor what is as fit is taken unasked.
    """

    topics: tuple[str, ...]
    rank: int
    why: str
    is_source: bool = False


@dataclass
class Look:
    """What judges of topics may look at, and what was settled so far.

    found, ambiguous, unused: as in Roles, with topics of all kinds in unused.
    """

    recording: Recording
    topics: Topics
    found: dict[str, Candidate] = field(default_factory=dict)
    ambiguous: dict[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)
    unused: dict[str, str] = field(default_factory=dict)

    @cached_property
    def usable(self) -> dict[str, str]:
        """Topic -> type, of topics whose messages are of one type and can be decoded; reasons of others in unused."""
        usable: dict[str, str] = {}
        for topic in sorted({channel.topic for channel in self.recording.channels}):
            types = self.recording.types_of(topic)
            if (why := self._why_unusable(topic, types)) is None:
                usable[topic] = types[0]
            else:
                self.unused[topic] = why
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
        frames.configured = self.topics.base_frame
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
                self.unused.update(dict.fromkeys(each.topics, each.why + beside))
