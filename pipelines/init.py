"""`quadlog init`: a first configuration for a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from quadlog.config.file import commented_toml
from quadlog.config.schema import Config, UwbConfig
from quadlog.errors import printable
from quadlog.messages import Float
from quadlog.pipelines.stages.mount import lidar_in_base
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.decoders.anchor_places import place_warnings
from quadlog.recordings.recording import Recording, open_configured
from quadlog.recordings.roles import Roles, detect_roles
from quadlog.recordings.survey import Survey, survey
from quadlog.results.find_runs import refuse_existing
from quadlog.storage.atomic_write import write_whole

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
    with open_configured(path, Config(), msg_path, "log") as recording:
        roles = detect_roles(recording, Config().topics)
        seen = survey(recording)
        mount = _lidar_mount(recording, roles)
        losses, warnings = tuple(recording.losses), (*recording.warnings, *place_warnings(seen.anchor_places, {}))
    topics: dict[str, Any] = {name: roles.found[name].topics[0] for name in SINGLE_TOPICS if name in roles.found}
    if "uwb" in roles.found:
        topics["uwb"] = list(roles.found["uwb"].topics)
    filled = {"topics": topics} if mount is None else {"topics": topics, "lidar": {"mount": mount}}
    config = Config.model_validate(filled)
    sections = tuple(Config.model_fields) if everything else _usable_sections(roles)
    text = commented_toml(config, _notes(roles, mount), sections)
    return Proposal(text + _radio_skeleton(seen) + _left_out(sections), losses, warnings)


def _usable_sections(roles: Roles) -> tuple[str, ...]:
    """The sections that the log can use."""
    there = {*roles.found, *roles.ambiguous}
    ranges, clouds = NEEDS_RANGES if "uwb" in there else (), NEEDS_CLOUDS if "lidar" in there else ()
    legs = ("robot",) if "joints" in there and not clouds else ()
    return (*ALWAYS, *ranges, *clouds, *legs)


def _left_out(sections: Sequence[str]) -> str:
    """A comment that names the sections that are not there."""
    missing = [f"[{name}]" for name in Config.model_fields if name not in sections]
    return f"\n# This log cannot use {' '.join(missing)}: quadlog init --all writes them.\n" if missing else ""


def write_new(path: Path, text: str, *, force: bool) -> None:
    """Write a file whole. Raises AlreadyExists unless forced, CannotWrite."""
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


def _lidar_mount(recording: Recording, roles: Roles) -> dict[str, float] | None:
    """[lidar.mount] from the transforms that never change, None where they do not lead from the lidar to the base."""
    if "lidar" not in roles.found or "tf" not in roles.found:
        return None
    transform = lidar_in_base(recording, roles.found["lidar"].topics[0], roles.frames)
    return None if transform is None else mount_of(transform)


def mount_of(transform_lidar_to_base: Float) -> dict[str, float]:
    """The keys of [lidar.mount] for a (4, 4) transform, rounded to 0.1 mm and 0.001 degree."""
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
