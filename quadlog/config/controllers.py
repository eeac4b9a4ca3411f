"""What drives a simulated robot, a line for each controller; nothing is imported for their names."""

from __future__ import annotations

from typing import NamedTuple


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
OF_PLUGIN = ControllerParts(fuzzy=True, body=True, whole_body=False)
"""Of every other name: a plug-in turns the commands of fpmw's pursuit into torques."""
NO_CONTROLLER = "none"
"""Leaves the control stage out."""
