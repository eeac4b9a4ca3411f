"""Imports and compilation, done before the clock of each stage starts and timed apart from them."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Collection
from functools import partial

import numpy as np

from quadlog.config.controllers import CONTROLLERS
from quadlog.config.schema import Config
from quadlog.lidar.scan_classifier import ScanClassifier
from quadlog.mapping.accumulated_map import AccumulatedMap, GroundHeight
from quadlog.mapping.compact import CompactScan, ScanCompactor
from quadlog.mapping.grid import window_around
from quadlog.mapping.placing import ScanPlacer
from quadlog.messages import PointCloud, RangeSeries
from quadlog.pipelines.executor.compilation import Compilation, python
from quadlog.pipelines.stages.perceive import make_memory
from quadlog.pipelines.stages.positions.tag_errors import has_body_of_tags
from quadlog.pipelines.stages.scans import ScanSettings
from quadlog.positioning.body import locate_body
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate


def compilation(stages: Collection[str], config: Config, say: Callable[[str], None]) -> Compilation:
    """The compiled code of the given stages with this configuration, as one part for each.

    `position` and `control` take about as long as all other parts, and are shared with another process.
    """
    parts: dict[str, Callable[[], object]] = {
        "position": _locate_toy_body if has_body_of_tags(config) else _locate_toy_tag,
        "filter": partial(_classify_toy_scan, config),
        "map": partial(_map_toy_scan, config),
        "plan": partial(_walk_toy_map, config.planner.name),
    }
    if config.simulation.has_body:
        parts["control"] = partial(_walk_toy_robot, config.simulation.controller)
    parts = {name: part for name, part in parts.items() if name in stages}
    elsewhere = python("-m", __name__, config.simulation.controller)
    return Compilation(parts, ("position", "control"), elsewhere, say)


def _locate_toy_body() -> None:
    """Two tags on one body."""
    _locate_toy_tag()
    anchors, ranges = _toy_ranges()
    for smooth in (True, False):
        settings = LocateSettings(smooth=smooth)
        located = locate(ranges, anchors, [TagInfo(0, 1.0)], settings)
        locate_body(located.tags * 2, np.array([[0.1, 0.0], [-0.1, 0.0]]), anchors, settings)


def _locate_toy_tag() -> None:
    """A second of a tag, with every step that a real one takes."""
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


def _classify_toy_scan(config: Config) -> CompactScan:
    """A sweep of 16 beams over flat ground inside a round wall, as the configured method takes it, made compact.

    Its last column comes twice, farther off: returns that share a cell are labelled by a function of their own.
    """
    column, ring = np.append(np.arange(90), 89).repeat(16), np.tile(np.arange(16, dtype=np.uint16), 91)
    azimuth_rad, elevation_rad = column * (2 * np.pi / 90), np.radians(2.0 * ring - 15)
    direction = np.column_stack(
        [
            np.cos(elevation_rad) * np.cos(azimuth_rad),
            np.cos(elevation_rad) * np.sin(azimuth_rad),
            np.sin(elevation_rad),
        ]
    )
    range_m = np.minimum(0.4 / np.maximum(-direction[:, 2], 1e-3), 6.0)
    range_m[-16:] += 1.0
    xyz_m = np.asfortranarray(direction * range_m[:, None], np.float32)
    mount = np.eye(4)
    mount[2, 3] = 0.4
    cloud = PointCloud(0, "lidar", xyz_m, ring, column * 1_000_000)
    settings = ScanSettings.of_config(config, maps=True)
    assert settings.compact is not None
    returns = ScanClassifier(settings.classifier, 0).classify(cloud, np.stack([mount, mount]))
    return CompactScan.from_bytes(ScanCompactor(settings.compact).compact(returns, 0).to_bytes())


def _map_toy_scan(config: Config) -> None:
    """One scan laid on every map there is."""
    scan, window = _classify_toy_scan(config), window_around(np.zeros(2), 0.1, 11)
    poses = np.zeros((len(scan.slot_ns), 3))
    placed = ScanPlacer(1, 0.5).place(scan, poses, np.full(2, np.nan), window)
    make_memory(config).add(0, window, placed)
    AccumulatedMap(0.1).add(window, placed, 500)
    GroundHeight(0.1).add(scan, poses)


def _walk_toy_map(planner: str) -> None:
    """Two replans and a few ticks about an obstacle, from inside its dilation to a goal outside the window."""
    from quadlog.control.following.lookahead import FixedLookahead
    from quadlog.planning.registry import make_planner
    from quadlog.planning.replan import Replanner, ReplanSettings
    from quadlog.simulation.resimulation import MapInstant, PursuitSettings, resimulate
    from quadlog.simulation.robot.unicycle_robot import UnicycleRobot

    window = window_around(np.zeros(2), 0.1, 41)
    occupied = np.zeros(window.shape, dtype=np.bool_)
    occupied[18:23, 22] = True
    instants = [MapInstant(t_ns, window, occupied, occupied) for t_ns in (0, 100_000_000)]
    replanner = Replanner(make_planner(planner), ReplanSettings())
    robot = UnicycleRobot(np.zeros(3), 0.02, np.random.default_rng(0))
    target = np.array([5.0, 0.5])
    resimulate(
        instants,
        lambda t_ns: np.tile(target, (len(t_ns), 1)),
        robot,
        FixedLookahead(2.0),
        replanner,
        PursuitSettings(),
    )


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
