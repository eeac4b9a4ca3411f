"""What a second process compiles at the first start: positions and the walking robot, half of all there is."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager

import numpy as np

from quadlog.config.controllers import CONTROLLERS
from quadlog.config.schema import Config
from quadlog.messages import RangeSeries
from quadlog.pipelines.executor.compilation import compile_with_help, python
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate


def compilation(
    stages: Collection[str], config: Config, say: Callable[[str], None]
) -> AbstractContextManager[Callable[[str], None]]:
    """Around the given stages with this configuration; see compile_with_help for what is yielded."""
    shared = [name for name in ("position", "control") if name in stages]
    if "control" in shared and not config.simulation.has_body:
        shared.remove("control")
    return compile_with_help(python("-m", __name__, config.simulation.controller), shared, say)


def _locate_toy_tag() -> None:
    """A second of a tag that walks between three anchors, with every step that a real one takes."""
    anchors, ranges = _toy_ranges()
    for smooth in (True, False):
        locate(ranges, anchors, [TagInfo(0, 1.0)], LocateSettings(smooth=smooth))


def _toy_ranges() -> tuple[Anchors, RangeSeries]:
    """A second of a tag that walks between three anchors."""
    anchor_m = np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [0.0, 8.0, 1.0]])
    t_ns = np.arange(50, dtype=np.int64) * 20_000_000
    walk_m = np.column_stack([2 + t_ns * 1e-9, np.full(50, 3.0), np.ones(50)])
    range_m = np.linalg.norm(walk_m[:, None] - anchor_m, axis=2)
    ids = np.arange(3, dtype=np.int64)
    ranges = RangeSeries(np.repeat(t_ns, 3), np.zeros(150, dtype=np.int64), np.tile(ids, 50), range_m.ravel())
    return Anchors(ids, anchor_m, np.zeros(3)), ranges


def _walk_toy_robot(controller: str) -> None:
    """A tenth of a second of a robot with a body."""
    from quadlog.control.locomotion.robot import ROBOTS
    from quadlog.control.locomotion.walker import WalkerSettings
    from quadlog.simulation.robot.height_field import flat
    from quadlog.simulation.robot.model import quadruped_model
    from quadlog.simulation.robot.walking_robot import WalkingRobot

    model, settings = (
        quadruped_model(ROBOTS["tracking"], flat()),
        WalkerSettings(whole_body=CONTROLLERS[controller].whole_body),
    )
    WalkingRobot(model, settings, np.zeros(3), np.random.default_rng(0)).walk(50, 0.3, 0.1)


def main(controller: str, *names: str) -> None:
    """Compile parts in this process, and print the name of each when it is done."""
    # Collecting garbage is not worth the time in a process that ends soon.
    gc.disable()
    for name in names:
        if name == "position":
            _locate_toy_tag()
        elif name == "control":
            _walk_toy_robot(controller)
        sys.stdout.write(f"{name}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
