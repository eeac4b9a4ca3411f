"""What [robot] preset stands for: a body on maps, and the model that walks."""

from __future__ import annotations

from typing import Any

# Sizes from [unitree_ros]: over the thighs, over the knees with thighs at 45 degrees, and up to the trunk's top, of the
# robots in quadlog.control.locomotion.robot.
ROBOT_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {"model": "tracking", "length_m": 0.62, "width_m": 0.26, "height_m": 0.37},
    "go1": {"model": "go1", "length_m": 0.68, "width_m": 0.28, "height_m": 0.35},
    "go2": {"model": "go2", "length_m": 0.69, "width_m": 0.31, "height_m": 0.35},
    "a1": {"model": "a1", "length_m": 0.64, "width_m": 0.29, "height_m": 0.33},
    "b1": {"model": "b1", "length_m": 1.19, "width_m": 0.45, "height_m": 0.56},
}


def with_robot_preset(data: Any) -> Any:
    """The tables of a configuration, with the values of its robot's preset where they have none of their own."""
    return data | _added(_preset(data), data, {}) if isinstance(data, dict) else data


def robot_of_later(earlier: dict[str, Any], later: dict[str, Any]) -> dict[str, Any]:
    """The tables of the preset that later ones name, without what earlier ones give other values than their preset's.

    So a preset over the effective configuration of a run, which has every key, replaces the robot as a whole.
    """
    return _added(_preset(later), earlier, _preset(earlier) or _preset({"robot": {"preset": "paper"}}))


def _preset(data: dict[str, Any]) -> dict[str, Any]:
    """The keys that robot.preset stands for, or without one a robot.model that has a preset; none for other models."""
    robot = data.get("robot")
    name = robot.get("preset", robot.get("model")) if isinstance(robot, dict) else None
    found = ROBOT_PRESETS.get(name, {}) if isinstance(name, str) else {}
    return {"preset": name, **found} if found else {}


def _added(preset: dict[str, Any], own: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """The section of a preset, where `own` has no value, or the one that the preset before had, else own's."""
    given = own.get("robot", {})
    if not preset or not isinstance(given, dict):
        return {}
    kept = {key: value for key, value in given.items() if key not in before or value != before[key]}
    return {"robot": preset | kept}
