"""What [robot] preset stands for: a body on maps, the model that walks, and the forces that its weight takes."""

from __future__ import annotations

from typing import Any

# Sizes from [unitree_ros]: over the thighs, over the knees with thighs at 45 degrees, and up to the trunk's top, of the
# robots in quadlog.control.locomotion.robot. A foot may bear the whole weight of one that is heavy; ours.
ROBOT_PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "paper": {},
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
    robot = data.get("robot", {}) if isinstance(data, dict) else {}
    preset = robot.get("preset") if isinstance(robot, dict) else None
    found = ROBOT_PRESETS.get(preset) if isinstance(preset, str) else None
    if not found:
        return data
    merged = dict(data)
    for section, values in found.items():
        own = data.get(section, {})
        if isinstance(own, dict):
            merged[section] = values | own
    return merged
