"""What is in a recording: the story of `quadlog info`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from quadlog.config import Config
from quadlog.pipelines.opening import open_configured
from quadlog.pipelines.uwb_diagnostics import uwb_diagnostics
from quadlog.recordings.clock import FAR_APART_NS
from quadlog.recordings.recording import Recording
from quadlog.recordings.repeated_stamps import REORDERED_NS
from quadlog.recordings.roles import Roles, detect_roles
from quadlog.recordings.survey import Survey, TopicSurvey, survey
from quadlog.recordings.words import several, stamps_go_back

FAR_APART_S = FAR_APART_NS * 1e-9


def describe_recording(path: Path, config: Config, msg_path: Sequence[Path] = ()) -> dict[str, Any]:
    """Everything `info --json` prints, as one object; reads the whole recording once.

    Raises the errors of open_recording and UnknownTopic.
    """
    with open_configured(path, config, msg_path) as recording:
        roles = detect_roles(recording, config.topics)
        seen = survey(recording)
        uwb, warnings = uwb_diagnostics(recording, roles, config)
        info = _describe(recording, roles, seen)
        jumps = _back_warnings(seen, warnings)
        return info | uwb | {"warnings": [*info["warnings"], *jumps, *warnings]}


def _describe(recording: Recording, roles: Roles, seen: Survey) -> dict[str, Any]:
    return {
        "path": str(recording.path),
        "messages": seen.messages,
        "start_ns": seen.start_ns,
        "end_ns": seen.end_ns,
        "losses": [
            {"cause": loss.cause, "detail": loss.detail, "topic": loss.topic, "count": loss.count}
            for loss in recording.losses
        ],
        "warnings": [*recording.warnings, *_clock_warnings(seen)],
        "topics": [_topic_row(each, roles) for each in seen.topics],
        "roles": {name: {"topics": list(role.topics), "why": role.why} for name, role in roles.found.items()},
        "ambiguous": {role: [list(topics) for topics in choices] for role, choices in roles.ambiguous.items()},
        "target_candidates": list(roles.targets),
        "links": [
            {
                "topic": topic,
                "tag": link.tag,
                "anchor": link.anchor,
                "n": link.messages,
                "range_min_m": link.range_min_m,
                "range_max_m": link.range_max_m,
            }
            for topic, links in seen.links.items()
            for link in links
        ],
    }


def _clock_warnings(seen: Survey) -> list[str]:
    """Header stamps more than an hour from log time, or from one another: what would be mixed, and how to avoid it."""
    jumps = [
        f"{each.name}: its header stamps jump by {each.clock_jump_s:.0f} s against log time; "
        "take log times with  --stamp log"
        for each in seen.topics
        if each.clock_jump_s is not None and each.clock_jump_s > FAR_APART_S
    ]
    far = [each for each in seen.topics if each.clock_offset_s is not None and abs(each.clock_offset_s) > FAR_APART_S]
    if not far:
        return jumps
    unstamped = [each.name for each in seen.topics if each.messages and each.clock_offset_s is None]
    line = f"header stamps of {several(len(far), 'topic')} lie {far[0].clock_offset_s:.0f} s from log time"
    if unstamped:
        line += f", which {several(len(unstamped), 'topic')} without stamps must use; take log times with  --stamp log"
    return [*jumps, line]


def _back_warnings(seen: Survey, said: Sequence[str]) -> list[str]:
    """Ranges whose stamps go back, unless what is said of their use tells so already."""
    words = [
        stamps_go_back(each.name, each.clock_back_ns, each.clock_back_to_ns)
        for each in seen.topics
        if each.clock_back_ns > REORDERED_NS
    ]
    # How far they go back differs where ranges are missing, so only the words before the amount are compared.
    new = [text for text in words if not any(each.startswith(text.rpartition(" by ")[0]) for each in said)]
    return [f"{text}; take log times with  --stamp log" for text in new]


def _topic_row(topic: TopicSurvey, roles: Roles) -> dict[str, Any]:
    role, why = roles.of_topic(topic.name)
    return {
        "name": topic.name,
        "type": topic.type,
        "messages": topic.messages,
        "hz_min": topic.hz_min,
        "hz_max": topic.hz_max,
        "gaps": topic.gaps,
        "longest_gap_s": topic.longest_gap_s,
        "role": role,
        "why": why,
        "clock_offset_s": topic.clock_offset_s,
    }
