"""What [robot] preset stands for: a body on maps, the model that walks, and the forces that its weight takes."""

from __future__ import annotations

from typing import Any

# Sizes from [unitree_ros]: over the thighs, over the knees with thighs at 45 degrees, and up to the trunk's top, of the
# robots in quadlog.control.locomotion.robot. A foot may bear the whole weight of one that is heavy; ours.
ROBOT_PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "paper": {
        "robot": {"model": "tracking", "length_m": 0.62, "width_m": 0.26, "height_m": 0.37},
        "mpc": {"f_max_n": 150.0},
        "wbc": {"f_max_n": 150.0},
    },
    "go1": {"robot": {"model": "go1", "length_m": 0.68, "width_m": 0.28, "height_m": 0.35}},
    "go2": {"robot": {"model": "go2", "length_m": 0.69, "width_m": 0.31, "height_m": 0.35}},
    "a1": {"robot": {"model": "a1", "length_m": 0.64, "width_m": 0.29, "height_m": 0.33}},
    "b1": {
        "robot": {"model": "b1", "length_m": 1.19, "width_m": 0.45, "height_m": 0.56},
        "mpc": {"f_max_n": 450.0},
        "wbc": {"f_max_n": 450.0},
    },
}


def with_robot_preset(data: Any) -> Any:
    """The tables of a configuration, with the values of its robot's preset where they have none of their own."""
    return data | _added(_preset(data), data, {}) if isinstance(data, dict) else data


def robot_of_later(earlier: dict[str, Any], later: dict[str, Any]) -> dict[str, Any]:
    """The tables of the preset that later ones name, without what earlier ones give other values than their preset's.

    So a preset over the effective configuration of a run, which has every key, replaces the robot as a whole.
    """
    return _added(_preset(later), earlier, _preset(earlier) or _preset({"robot": {"preset": "paper"}}))


def _preset(data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What robot.preset stands for, or without one a robot.model that has a preset; nothing for other models."""
    robot = data.get("robot")
    name = robot.get("preset", robot.get("model")) if isinstance(robot, dict) else None
    found = ROBOT_PRESETS.get(name, {}) if isinstance(name, str) else {}
    # Forces that a preset leaves out are the default ones, also after those of a heavier robot.
    return ROBOT_PRESETS["paper"] | found | {"robot": {"preset": name, **found["robot"]}} if found else {}


def _added(preset: dict[str, Any], own: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """The sections of a preset, where `own` has no value, or the one that the preset before had, else own's."""
    added = {}
    for section, values in preset.items():
        given, old = own.get(section, {}), before.get(section, {})
        if isinstance(given, dict):
            kept = {key: value for key, value in given.items() if key not in old or value != old[key]}
            added[section] = values | kept
    return added
