"""Which UWB tag is whose, and where it sits on the robot."""

from __future__ import annotations

from quadlog.config import Config


def roles_of(config: Config, tags: list[int]) -> dict[str, int]:
    """Role -> tag id: as the table says; without one the lowest id is the robot, the next one the person."""
    if config.uwb.tags:
        return {tag.role: tag.id for tag in reversed(config.uwb.tags) if tag.role != "none" and tag.id in tags}
    return dict(zip(("robot", "person"), sorted(tags), strict=False))


def lever_of(config: Config, tag: int) -> tuple[float, float]:
    """Where a tag sits in base, x_m and y_m; at its origin unless the table says otherwise."""
    row = next((each for each in config.uwb.tags if each.id == tag), None)
    return (row.x_m, row.y_m) if row is not None else (0.0, 0.0)
