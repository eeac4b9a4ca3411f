"""`quadlog info` and `quadlog init`: what a recording holds, and a first configuration for it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.config.file import SCHEMA, commented_toml
from quadlog.config.schema import Config, UwbConfig
from quadlog.errors import NothingReadable, printable
from quadlog.messages import Float
from quadlog.pipelines.executor.progress import Progress, Silent
from quadlog.pipelines.stages.mount import find_mount
from quadlog.pipelines.stages.outlook import Outlook, locates_by_uwb, unless_ambiguous
from quadlog.recordings.clocks.clock_offsets import FAR_APART_NS, LATE_NS
from quadlog.recordings.containers.container import EXCERPT, UWB_EXCERPT, Budget, Damaged, Loss, RawMessage
from quadlog.recordings.decoders.anchor_places import FEWEST_ANCHORS, AnchorPlace, place_warnings
from quadlog.recordings.formatting import several, stamps_go_back
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.survey import Survey, TopicSurvey, indexed_times, survey
from quadlog.recordings.topics.look import Roles
from quadlog.recordings.topics.roles import configured_topics, detect_roles
from quadlog.recordings.topics.unread import hint, unread
from quadlog.storage.atomic_write import write_whole

FAR_APART_S = FAR_APART_NS * 1e-9
NOT_NEEDED = "not used: no role is left for it"
STEPS = 100
OpenProgress = Callable[[], AbstractContextManager[Progress]]


def describe_recording(
    path: Path,
    config: Config,
    msg_path: Sequence[Path] = (),
    *,
    full: bool = False,
    open_progress: OpenProgress = lambda: nullcontext(Silent()),
) -> dict[str, Any]:
    """Everything `info --json` prints, as one object.

    Counts and times come from the recording's index, the rest from an excerpt of a large recording (sampled). With
    full, or without an index, all of it is read, with progress. Raises the errors of open_recording and UnknownTopic.
    """
    with open_recording(path, config, msg_path=msg_path) as recording:
        configured_topics(recording, config.topics)  # refuses what is not there before all is read
        budget = None if full else UWB_EXCERPT if config.uwb.anchors else EXCERPT
        part, seen, unindexed = _look(recording, budget, open_progress)
        recording.glimpsed = seen.stamps
        roles = detect_roles(recording, config.topics)
        uwb, warnings = _uwb(part, roles, config, seen.anchor_places, whole=part is recording)
        info = _describe(recording, roles, seen, config)
        jumps = _back_warnings(seen, roles.topics("uwb") if uwb else ())
        sampled = {"sampled": part is not recording}
        uwb = {"uwb": [], "uwb_tags": [], "uwb_body": []} | uwb
        return info | sampled | uwb | {"warnings": [*unindexed, *info["warnings"], *jumps, *warnings]}


def _look(
    recording: Recording, budget: Budget | None, open_progress: OpenProgress
) -> tuple[Recording, Survey, list[str]]:
    """The part that was read, its survey, and a warning if all was read because there is no index.

    budget: for large recordings, None to read all.
    """
    part = None if budget is None else recording.excerpt(budget)
    keep = budget is EXCERPT  # what a glimpse shows, too
    if part is None and budget is not None:
        return recording, survey(recording, keep_stamps=keep), []
    unindexed = []
    if part is not None:
        try:
            return part, survey(part, indexed_times(recording.container), keep_stamps=keep), []
        except NothingReadable:
            unindexed = ["no message of the sample can be read; all of the recording was read"]
        except Damaged as damage:
            unindexed = [f"no complete index of messages ({damage.reason}); all of the recording was read"]
    with open_progress() as progress:
        return recording, survey(recording, watch=partial(_advance, recording, progress)), unindexed


def _advance(recording: Recording, progress: Progress, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
    """The messages, with a step of progress for each hundredth of the recorded time."""
    start_ns, end_ns = recording.span_ns or (0, 0)
    step_ns = max((end_ns - start_ns) // STEPS, 1)
    progress.begin("read", STEPS if end_ns > start_ns else None)
    steps = 0
    for each in messages:
        yield each
        while steps < min((each.log_time_ns - start_ns) // step_ns, STEPS):
            steps += 1
            progress.advance(steps * step_ns * 1e-9)


def _uwb(
    part: Recording, roles: Roles, config: Config, places: Mapping[int, AnchorPlace], whole: bool
) -> tuple[dict[str, Any], list[str]]:
    """The health of the ranges where anchors are configured, or placed by enough messages."""
    if not config.uwb.anchors and len(places) < FEWEST_ANCHORS:
        return {}, place_warnings(places, {})
    # What locates takes half a second to load.
    from quadlog.pipelines.evaluation.uwb_diagnostics import uwb_diagnostics
    from quadlog.pipelines.stages.positions.uwb import configured_places, with_carried_anchors

    warnings = place_warnings(places, configured_places(config))
    effective = with_carried_anchors(config, places)
    if not effective.uwb.anchors:
        return {}, warnings
    found, more = uwb_diagnostics(part, roles, effective, whole)
    return found, [*warnings, *more]


def _describe(recording: Recording, roles: Roles, seen: Survey, config: Config) -> dict[str, Any]:
    look = Outlook(recording, roles, config, locates_by_uwb(recording, roles, config))
    return {
        "path": str(recording.path),
        "messages": seen.messages,
        "messages_read": seen.messages_read,
        "start_ns": seen.start_ns,
        "end_ns": seen.end_ns,
        "losses": [asdict(loss) for loss in recording.losses],
        "warnings": [*recording.warnings, *_clock_warnings(seen, roles.played)],
        "topics": [_topic_row(each, recording, roles) for each in seen.topics],
        "roles": {name: {"topics": list(role.topics), "why": role.why} for name, role in roles.found.items()},
        "ambiguous": {role: [list(topics) for topics in choices] for role, choices in roles.ambiguous.items()},
        "target_candidates": list(roles.targets),
        "tf": _tf_rows(roles, seen, roles.frames.base),
        "replay": look.outlook({link.tag for links in seen.links.values() for link in links}),
        "anchors": [
            dict(zip(("id", "x_m", "y_m", "z_m"), (anchor, *place.position_m), strict=True))
            | {"messages": place.n, "moved_m": place.moved_m}
            for anchor, place in seen.anchor_places.items()
        ],
        "links": [
            {"topic": topic, "tag": link.tag, "anchor": link.anchor, "n": link.messages}
            | {"range_min_m": link.range_min_m, "range_max_m": link.range_max_m}
            for topic, links in seen.links.items()
            for link in links
        ],
    }


def _tf_rows(roles: Roles, seen: Survey, base: str | None) -> list[dict[str, Any]]:
    """Chains of frames from a root down: that of base first, then others that move; not those of base's own joints."""
    chains = [
        chain
        for chain in roles.frames.chains(base)
        if chain[-1].child == base or not (chain[-1].is_still or base in [edge.parent for edge in chain])
    ]
    return [
        {
            "frames": [chain[0].parent, *(edge.child for edge in chain)],
            "transforms": [
                sum(seen.transforms[topic, edge.parent, edge.child] for topic in roles.topics("tf")) for edge in chain
            ],
            "static": [edge.static for edge in chain],
        }
        for chain in chains
    ]


def _clock_warnings(seen: Survey, used: Collection[str]) -> list[str]:
    """Warnings of header stamps more than an hour from log time, or that jump by more, with a way out of those used."""
    jumps = [
        f"{each.name}: its header stamps jump by {each.clock_jump_s:.0f} s against log time"
        + ("; take log times with  --stamp log" if each.name in used else "")
        for each in seen.topics
        if each.clock_jump_s is not None and each.clock_jump_s > FAR_APART_S
    ]
    far = [each for each in seen.topics if each.clock_offset_s is not None and abs(each.clock_offset_s) > FAR_APART_S]
    if not far:
        return jumps
    unstamped = [each for each in seen.topics if each.name in used and each.messages and each.clock_offset_s is None]
    line = f"header stamps of {several(len(far), 'topic')} lie {far[0].clock_offset_s:.0f} s from log time"
    if unstamped and any(each.name in used for each in far):
        line += f", which {several(len(unstamped), 'topic')} without stamps must use; take log times with  --stamp log"
    return [*jumps, line]


def _back_warnings(seen: Survey, read: Collection[str]) -> list[str]:
    """Warnings of topics whose stamps go back, but for those that were read, whose losses have it."""
    return [
        f"{each.name}: {stamps_go_back(each.clock_back_ns, each.clock_back_to_ns)}; take log times with  --stamp log"
        for each in seen.topics
        if each.clock_back_ns > LATE_NS and each.name not in read
    ]


def _topic_row(topic: TopicSurvey, recording: Recording, roles: Roles) -> dict[str, Any]:
    role, why = roles.of_topic(topic.name)
    channel = next(each for each in recording.channels_of(topic.name) if each.type_name == topic.type)
    do = hint(channel, recording.mapped) if role is None and topic.messages else ""
    if role is None and not why:
        reason = unread(channel, recording.mapped)
        why = NOT_NEEDED if reason is None or reason.role else reason.words
    names = ("name", "type", "messages", "hz_min", "hz_max", "gaps", "longest_gap_s")
    row = {name: getattr(topic, name) for name in names}
    return row | {"role": role, "why": why, "hint": do or None, "clock_offset_s": topic.clock_offset_s}


ALWAYS = ("topics", "results")
NEEDS_RANGES = ("uwb",)
NEEDS_CLOUDS = tuple(name for name in Config.model_fields if name not in (*ALWAYS, *NEEDS_RANGES))
"""Sections of the configuration by what a log must have for them."""
TAG_HEIGHT_M, PERSON_HEIGHT_M = UwbConfig().tag_height_m, UwbConfig().person_height_m
SINGLE_TOPICS = ("lidar", "odometry", "imu", "joints", "reference")


@dataclass(frozen=True, slots=True)
class Proposal:
    """The text of a quadlog.toml, and losses and warnings of the recording."""

    text: str
    losses: tuple[Loss, ...]
    warnings: tuple[str, ...]


def propose_config(path: Path, msg_path: Sequence[Path] = (), *, everything: bool = False) -> Proposal:
    """A quadlog.toml: detected topics and lidar mount filled in, anchors and tags left to be placed.

    everything: sections that the log cannot use, too.
    Raises the errors of open_recording.
    """
    # Only static transforms are used, which hold on any clock.
    with open_recording(path, Config(), msg_path=msg_path, stamp="log") as recording:
        roles = detect_roles(recording, Config().topics)
        seen = survey(recording)
        found = find_mount(recording, roles, Config(), unless_ambiguous(roles, "lidar"), None)
        mount = None if found.from_tf is None else mount_of(found.transform_lidar_to_base)
        losses, warnings = tuple(recording.losses), (*recording.warnings, *place_warnings(seen.anchor_places, {}))
    topics: dict[str, Any] = {name: roles.found[name].topics[0] for name in SINGLE_TOPICS if name in roles.found}
    if "uwb" in roles.found:
        topics["uwb"] = list(roles.found["uwb"].topics)
    filled = {"topics": topics} if mount is None else {"topics": topics, "lidar": {"mount": mount}}
    config = Config.model_validate(filled)
    there = {*roles.found, *roles.ambiguous}
    ranges, clouds = NEEDS_RANGES if "uwb" in there else (), NEEDS_CLOUDS if "lidar" in there else ()
    legs = ("robot",) if "joints" in there and not clouds else ()
    sections = tuple(Config.model_fields) if everything else (*ALWAYS, *ranges, *clouds, *legs)
    text = f"#:schema {SCHEMA.as_uri()}\n{commented_toml(config, _notes(roles, mount), sections)}"
    missing = [f"[{name}]" for name in Config.model_fields if name not in sections]
    left_out = f"\n# This log cannot use {' '.join(missing)}: quadlog init --all writes them.\n" if missing else ""
    return Proposal(text + _radio_skeleton(seen) + left_out, losses, warnings)


def write_new(path: Path, text: str, *, force: bool) -> None:
    """Write a file whole. Raises AlreadyExists unless forced, CannotWrite."""
    from quadlog.results.find_runs import refuse_existing  # has tables, which take a tenth of a second to load

    refuse_existing(path, force)
    write_whole(path, text.encode())


def _notes(roles: Roles, mount: dict[str, float] | None) -> dict[str, list[str]]:
    """Comment lines beside the keys: why this topic, or which ones to choose from."""
    notes: dict[str, list[str]] = {}
    for name in (*SINGLE_TOPICS, "uwb"):
        if name in roles.found:
            notes[f"topics.{name}"] = [f"here: {printable(roles.found[name].why)}"]
        elif name in roles.ambiguous:
            choices = "  or  ".join(", ".join(topics) for topics in roles.ambiguous[name])
            notes[f"topics.{name}"] = [f"several could be it: {printable(choices)}"]
    if roles.targets:
        notes["topics.target"] = [f"in this log: {printable(', '.join(roles.targets))}"]
    notes["lidar.mount"] = [
        "not in the log's tf: to be measured" if mount is None else "from the transforms of the log"
    ]
    return notes


def mount_of(transform_lidar_to_base: Float) -> dict[str, float]:
    """The keys of [lidar.mount] for a (4, 4) transform, rounded to 0.1 mm and 0.001 degree."""
    from scipy.spatial.transform import Rotation  # slow to import

    x_m, y_m, z_m = (round(float(value), 4) for value in transform_lidar_to_base[:3, 3])
    angles = Rotation.from_matrix(transform_lidar_to_base[:3, :3]).as_euler("ZYX", degrees=True)
    yaw, pitch, roll = (round(float(value), 3) + 0.0 for value in np.asarray(angles))
    return {"x_m": x_m, "y_m": y_m, "z_m": z_m, "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}


def _radio_skeleton(seen: Survey) -> str:
    """Tables for the anchors that the log's messages place; commented ones for every other radio, to be filled in."""
    links = [link for topic in seen.links.values() for link in topic if link.anchor >= 0]
    if not links:
        return ""
    lines = ["", "# The radios that ranged in this log. Give the anchors their places in map and uncomment them."]
    if seen.anchor_places:
        lines = ["", "# The radios that ranged in this log. Its messages hold the places of the anchors given here."]
    for anchor in sorted({link.anchor for link in links}):
        reach = [link for link in links if link.anchor == anchor]
        count = sum(link.messages for link in reach)
        far_m = max((link.range_max_m for link in reach if link.range_max_m is not None), default=None)
        length = "" if far_m is None else f" of up to {far_m:.1f} m"
        lines += ["#", f"# {count} ranges{length}"]
        place = seen.anchor_places.get(anchor)
        if place is None:
            lines += ["# [[uwb.anchors]]", f"# id = {anchor}", "# x_m = ", "# y_m = ", "# z_m = "]
        else:
            x_m, y_m, z_m = (round(each, 4) + 0.0 for each in place.position_m)  # zero without a sign
            lines += ["[[uwb.anchors]]", f"id = {anchor}", f"x_m = {x_m}", f"y_m = {y_m}", f"z_m = {z_m}"]
    lines += [
        "#",
        "# A tag is the robot, a person or none. Without this table the lowest id is the robot, the next the person.",
    ]
    for index, tag in enumerate(sorted({link.tag for link in links})):
        count = sum(link.messages for link in links if link.tag == tag)
        role = ("robot", "person", "none")[min(index, 2)]
        lines += ["#", f"# {count} ranges", "# [[uwb.tags]]", f"# id = {tag}", f'# role = "{role}"']
        height_m = PERSON_HEIGHT_M if role == "person" else TAG_HEIGHT_M
        lines += [
            f"# height_m = {height_m}   # above map's floor",
            "# x_m = 0.0   # where it sits in base",
            "# y_m = 0.0",
        ]
    return "\n".join(lines) + "\n"
