"""What a user can do where no position was found: every source that the recording may have, as flags to paste."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quadlog.errors import MAX_LISTED, set_flag
from quadlog.pipelines.journal import Journal
from quadlog.recordings.roles import position_topics

if TYPE_CHECKING:
    from quadlog.pipelines.log import LogData


def ways_out(data: LogData, journal: Journal) -> str:
    """The chains of tf and the topics that could give a position, and why lidar and ranges do not, in one line."""
    chains = [(chain[0].parent, chain[-1].child) for chain in data.streams.tf.chains(None)]
    flags = [f"{set_flag('topics.map_frame', [root])} {set_flag('topics.base_frame', [end])}" for root, end in chains]
    taken = (data.config.topics.position, *journal.topics.get("position", ()))
    flags += [set_flag("topics.position", [each]) for each in position_topics(data.log.recording) if each not in taken]
    more = [f"one of {len(flags) - MAX_LISTED} more"] if len(flags) > MAX_LISTED else []
    words = [f"what could give it:  {'  or  '.join(flags[:MAX_LISTED] + more)}"] if flags else []
    if why := why_failed(data, "legs"):
        words.append(f"legs: {why}")
    if "uwb" in data.log.roles.found and not data.config.uwb.anchors:
        words.append("UWB ranges need [[uwb.anchors]], see  quadlog survey")
    if data.config.topics.position != "lidar":
        words.append(f"lidar: {_why_no_lidar(data)}")
    return "; ".join(words) or "see  quadlog info"


def why_none(data: LogData, source: str) -> str:
    """Why a source that was chosen gives no position."""
    topics = data.config.topics
    if source == "uwb" and not data.config.uwb.anchors:
        return "no [[uwb.anchors]] are configured"
    if source == "uwb":
        return "no position could be solved from the ranges" if data.streams.ranges else "there are no UWB ranges"
    if source == "tf":
        base = repr(topics.base_frame) if topics.base_frame else "the robot's frame"
        return f"no moving transforms lead from {topics.map_frame!r} to {base}"
    if source == "pose":
        return f"{len(data.log.roles.topics('pose')) or 'no'} topics could be the pose"
    if source == "legs":
        return why_failed(data, source) or "no angles of twelve leg joints are known"
    if source == "lidar":
        return _why_no_lidar(data)
    return data.log.roles.why_none(source) if source == "odometry" else "it holds no poses"


def why_failed(data: LogData, source: str) -> str:
    """Why a source that was tried gives no position, or not all of the time; empty where it was not tried."""
    if source == "legs" and data.legs is not None:
        return "no foot stands"
    return data.tracker.why_lost() if source == "lidar" and data.tracker is not None else ""


def _why_no_lidar(data: LogData) -> str:
    if data.tracker is not None:
        return why_failed(data, "lidar") or "it took no scan"
    if "lidar" in data.log.roles.found:
        return f"its scans were not matched; they are with  {set_flag('topics.position', ['lidar'])}"
    return data.log.roles.choices("lidar") or data.log.roles.why_none("lidar")
