"""What a replay of an open log will do, by a look at it: `info` foretells it in the words that a replay then uses."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import MAX_LISTED, MissingInput, QuadlogError, set_flag
from quadlog.messages import Batch, UwbRanges
from quadlog.pipelines.stages.mount import find_mount
from quadlog.recordings.clocks.clock import Clock
from quadlog.recordings.decoders.anchor_places import places_of
from quadlog.recordings.recording import Recording
from quadlog.recordings.tf_tree import TransformTree
from quadlog.recordings.topics.look import Roles
from quadlog.recordings.topics.roles import LONE_SOURCES, POSITION_WORDS, position_topics

SEE_INFO = "see  quadlog info"
AUTO_ORDER = POSITION_WORDS[1:]
LOOKED_AT = 20
"""Messages of a topic, the first ones, of which one can be decoded, or the topic is not waited for."""


@dataclass(frozen=True)
class Outlook:
    """An open recording, which topic plays which role, and whether there are ranges and anchors to locate by.

    config: without what reading does not depend on.
    """

    recording: Recording
    roles: Roles
    config: Config
    by_uwb: bool

    @property
    def lidars(self) -> tuple[str, ...]:
        """The topics of the clouds; none without any, or where there is a choice."""
        return self.roles.found["lidar"].topics if "lidar" in self.roles.found else ()

    def outlook(self, tags: Collection[int]) -> dict[str, Any]:
        """How far a replay will go, or that it will refuse, with what, and what is missing; tags: those that ranged."""
        topics, roles = self.config.topics, self.roles
        nowhere: dict[str, Any] = {"until": "nothing", "position": "none", "target": "none"}
        try:
            self._check_clocks()
            source = self.position()
        except QuadlogError as error:
            return nowhere | {"missing": [str(error)]}
        if not self._hears(*roles.played):
            return nowhere | {"missing": [self.why_nothing()]}
        lidars, odometry = self.lidars, unless_ambiguous(roles, "odometry")
        target, where, missing = topics.target, roles.base_in_map, [*self._unplaced(), *self._unheard()]
        if target == "auto":
            target = "uwb" if source == "uwb" and len(tags) > 1 else "none" if source == "fixed" else "ahead"
        if source == "fixed":
            ways = self.ways_out(roles.frames, failed={"lidar": ""})
            missing = ["; ".join(filter(None, ["a position; the robot is taken to stand still", ways]))]
        if not lidars:
            missing.append(roles.why_none("lidar"))
        elif not all(find_mount(self.recording, roles, self.config, each, odometry).known for each in lidars):
            missing.append("lidar.mount")
        until = "position" if not lidars else "map" if target == "none" else "control"
        by = {name: " ".join([name, *roles.topics(name)]) for name in LONE_SOURCES}
        by["tf"] = f"tf {where[1]} → {where[0]}" if where else "tf"
        return {"until": until, "position": by.get(source, source), "target": target, "missing": missing}

    def position(self) -> str:
        """What gives the robot's position: what is chosen, or the first of AUTO_ORDER that is there.

        Raises AmbiguousTopic, and MissingInput where what is chosen is not there.
        """
        roles, topics = self.roles, self.config.topics
        there: dict[str, Callable[[], bool]] = {
            "uwb": lambda: self.by_uwb and self._hears(*roles.topics("uwb")),
            "tf": lambda: roles.base_in_map is not None,
            "odometry": lambda: self._hears(*roles.topics("odometry")),
            "pose": lambda: self._has_one("pose"),
            "legs": lambda: "joints" in roles.found and self._hears(*roles.topics("joints")),
            "lidar": lambda: "lidar" in roles.found,
            "gnss": lambda: self._has_one("gnss"),
            "twist": lambda: self._has_one("twist"),
            "fixed": lambda: True,
        }
        if topics.position == "auto":
            return next(name for name in AUTO_ORDER if there[name]())
        if topics.position in there and not there[topics.position]():
            raise self.without(topics.position, roles.frames)
        return topics.position

    def without(self, source: str, tree: TransformTree, failed: Mapping[str, str] = {}) -> MissingInput:
        """The error where a source that was chosen gives no position; failed: as of ways_out."""
        why, ways = self.why_not(source, failed), self.ways_out(tree, failed={**failed, source: ""}) or SEE_INFO
        return MissingInput("position", f"topics.position = {source!r}, but {why}", ways)

    def why_not(self, source: str, failed: Mapping[str, str] = {}) -> str:
        """Why a source gives no position; failed: as of ways_out."""
        topics, roles = self.config.topics, self.roles
        base = repr(topics.base_frame) if topics.base_frame else "the robot's frame"
        anchors, ranges = self.config.uwb.anchors, failed.get("uwb", "there are no UWB ranges to use")
        reasons: dict[str, Callable[[], str]] = {
            "uwb": lambda: ranges if anchors else "no [[uwb.anchors]] are configured",
            "tf": lambda: f"no moving transforms lead from {topics.map_frame!r} to {base}",
            "pose": lambda: f"{len(roles.topics('pose')) or 'no'} topics could be the pose",
            "gnss": lambda: f"{len(roles.topics('gnss')) or 'no'} topics have satellite fixes",
            "twist": lambda: f"{len(roles.topics('twist')) or 'no'} topics have measured velocities",
            "legs": lambda: failed.get(source, "no angles of twelve leg joints are known"),
            "lidar": lambda: failed.get(source, roles.why_none(source)),
            "odometry": lambda: roles.why_none(source),
        }
        return reasons.get(source, str)() or "it holds no poses"

    def ways_out(self, tree: TransformTree, used: Collection[str] = (), failed: Mapping[str, str] = {}) -> str:
        """The chains of tf and the topics that could give a position, and why nothing else does, in one line.

        used: topics that gave none. failed: why, of sources that were tried.
        """
        chains = [(chain[0].parent, chain[-1].child) for chain in tree.chains(None)]
        flags = [
            f"{set_flag('topics.map_frame', [root])} {set_flag('topics.base_frame', [end])}" for root, end in chains
        ]
        taken = {self.config.topics.position, *used, *self.unheard}
        flags += [set_flag("topics.position", [each]) for each in position_topics(self.recording) if each not in taken]
        flags += [set_flag("topics.position", ["lidar"])] if self.lidars and "lidar" not in failed else []
        words = {
            "what could give it:  ": "  or  ".join(flags[:MAX_LISTED]),
            "legs: ": failed.get("legs", self.roles.why_unfit("joints")),
            "": "; ".join([*self._unplaced(), *self._unheard()]),
            "UWB: ": self.roles.why_unfit("uwb"),
            "lidar: ": failed.get("lidar", self.roles.why_none("lidar")),
        }
        return "; ".join(name + text for name, text in words.items() if text)

    @cached_property
    def unheard(self) -> dict[str, str]:
        """Topics with a role whose first messages cannot be decoded -> the decoder's reason."""
        found = {topic: self.recording.peek(topic, LOOKED_AT)[1] for topic in self.roles.played}
        return {topic: why for topic, why in found.items() if why is not None}

    def why_nothing(self) -> str:
        """What has to be chosen, or why no topic can be used, where there is nothing to replay."""
        unfit = [f"{topic} {why}" for topic, why in self.roles.unused.items()]
        reasons = [*map(self.roles.choices, self.roles.ambiguous), *self._unheard(), *unfit]
        return "; ".join(reasons[:MAX_LISTED]) or "no message of a type that quadlog uses"

    def topics_to_read(self) -> dict[str, Any]:
        """The topics by role, as `gather` takes them. Raises AmbiguousTopic for a role that is needed."""
        roles, config, position = self.roles, self.config, self.config.topics.position
        chosen = position if self.recording.channels_of(position) else None
        # Odometry may be the position (auto) or the heading (UWB); tf goes before it, and needs no choice of one.
        needs_odometry = position in ("auto", "uwb", "odometry")
        by_tf = position == "tf" or (position == "auto" and not self.by_uwb and "tf" in roles.found)
        odometry = unless_ambiguous(roles, "odometry") if by_tf else roles.topic("odometry") if needs_odometry else None
        # Otherwise the IMU is only used to level scans and to turn the body of legs.
        upright = unless_ambiguous(roles, "imu") if config.lidar.level or "joints" in roles.found else None
        return {
            "uwb": roles.topics("uwb") if self.by_uwb else (),
            "odometry": chosen or odometry,
            "imu": roles.topic("imu") if self.by_uwb and position in ("auto", "uwb") else upright,
            "joints": unless_ambiguous(roles, "joints"),
            "command": roles.topic("command"),
            "reference": unless_ambiguous(roles, "reference"),
            "target": roles.topic("target"),
            "tf": roles.topics("tf"),
            "estimates": [topic for source in LONE_SOURCES for topic in roles.topics(source)],
            "lidar": self.lidars,
        }

    def _has_one(self, role: str) -> bool:
        return len(self.roles.topics(role)) == 1 and self._hears(*self.roles.topics(role))

    def _hears(self, *topics: str) -> bool:
        return not self.unheard.keys() >= {*topics}

    def _unheard(self) -> list[str]:
        return [f"{topic} cannot be decoded: {why}" for topic, why in self.unheard.items()]

    def _unplaced(self) -> list[str]:
        """What UWB ranges lack that nobody gives the anchors' places."""
        lacks = "uwb" in self.roles.found and not self.by_uwb and not self.config.uwb.anchors
        return ["UWB ranges need [[uwb.anchors]], see  quadlog survey"] if lacks else []

    def _check_clocks(self) -> None:
        """Raises ClocksDiffer where the usual stamps of topics that are read together lie too far apart."""
        read = {each for of in self.topics_to_read().values() for each in ([of] if isinstance(of, str) else of or ())}
        clock, log_ns = Clock(self.recording.path, self.recording.stamp), np.array([1 << 62])
        for topic in sorted(read.intersection(self.roles.played).difference(self.unheard)):
            stamp_ns = log_ns + self.recording.usual_offset_ns(topic)
            clock.times_ns(topic, stamp_ns if topic in self.recording.clock.usual_ns else None, log_ns)


SAMPLED_RANGES = 50


def locates_by_uwb(recording: Recording, roles: Roles, config: Config) -> bool:
    """Whether there are ranges, and anchors of the configuration or of the first messages, to locate anything by."""
    if config.uwb.anchors or "uwb" not in roles.found or not may_use_uwb(config):
        return ("uwb" in roles.found or "uwb" in roles.ambiguous) and wants_uwb(config)
    first = [each for topic in roles.topics("uwb") for each in recording.peek(topic, SAMPLED_RANGES)[0]]
    return bool(places_of(each.rows for each in first if isinstance(each, Batch) and each.kind is UwbRanges))


def wants_uwb(config: Config) -> bool:
    """Whether the robot or the target may be located by UWB, and the anchors for it are known."""
    return bool(config.uwb.anchors) and may_use_uwb(config)


def may_use_uwb(config: Config) -> bool:
    """Whether the robot or the target may be located by UWB."""
    return not {"auto", "uwb"}.isdisjoint({config.topics.position, config.topics.target})


def unless_ambiguous(roles: Roles, role: str) -> str | None:
    """The topic of an optional role; None if there is a choice."""
    return roles.found[role].topics[0] if role in roles.found else None


def wants_lidar_track(log: Outlook, config: Config) -> bool:
    """Whether the robot is tracked by the lidar: as configured, or under auto where nothing else gives its position."""
    position = config.topics.position
    if "lidar" not in log.roles.found:
        return False
    by_both = log.by_uwb and config.lidar.odometry
    return position == "lidar" or by_both or (position == "auto" and log.position() == "lidar")
