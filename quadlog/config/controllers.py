"""What drives a simulated robot, a line for each controller; nothing is imported for their names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from quadlog.plugins import Plugin


class ControllerParts(NamedTuple):
    """Whether the look-ahead is fuzzy, a body walks by MPC, and whole-body control takes part."""

    fuzzy: bool
    body: bool
    whole_body: bool


CONTROLLERS = {
    "fpmw": ControllerParts(fuzzy=True, body=True, whole_body=True),
    "fpm": ControllerParts(fuzzy=True, body=True, whole_body=False),
    "pmw": ControllerParts(fuzzy=False, body=True, whole_body=True),
    "kinematic": ControllerParts(fuzzy=False, body=False, whole_body=False),
}
COMMAND = "command"
"""The body and controller of pmw, driven open loop by the commands of the log."""
NO_CONTROLLER = "none"
"""Leaves the control stage out."""
CONTROLLER_NAMES = (*CONTROLLERS, COMMAND, NO_CONTROLLER)


def parts_of(name: str) -> ControllerParts | None:
    """Those of a controller; None for NO_CONTROLLER. A plug-in turns the commands of fpmw's pursuit into torques."""
    if name == NO_CONTROLLER:
        return None
    of_plugin = ControllerParts(fuzzy=True, body=True, whole_body=False)
    return CONTROLLERS.get("pmw" if name == COMMAND else name, of_plugin)


def controller_plugin(name: str) -> Plugin | None:
    """The plug-in that controls under a name, None for quadlog's own and none. Raises QuadlogError."""
    from quadlog import plugins

    return plugins.find_plugin(plugins.CONTROLLERS, name, taken=name in CONTROLLER_NAMES)


def with_commands(data: Any) -> Any:
    """The tables of a configuration; commands are read where they drive the robot, without a topic any that is one."""
    tables = data if isinstance(data, dict) else {}
    simulation, topics = tables.get("simulation", {}), tables.get("topics", {})
    if not (isinstance(simulation, dict) and isinstance(topics, dict)) or simulation.get("controller") != COMMAND:
        return data
    return data | {"topics": topics | {"command": topics.get("command") or "auto"}}
