"""Imports and compilation, done before the clock of the stages starts and timed apart from them."""

from __future__ import annotations

import time
from collections.abc import Collection

import numpy as np

from quadlog.lidar.paper import PaperSettings, classify_scan_paper
from quadlog.mapping.accumulated import AccumulatedMap
from quadlog.mapping.ground_height import GroundHeight
from quadlog.mapping.occupancy import occupancy
from quadlog.mapping.window import window_around
from quadlog.messages import RangeSeries
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Replanner, ReplanSettings
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate
from quadlog.simulation.resimulation import MapInstant, PursuitSettings, resimulate


def warm_up(stages: Collection[str]) -> float:
    """Load and compile what the given stages need by running them on toys; returns the seconds it took."""
    started = time.perf_counter()
    if "position" in stages:
        _locate_toy_tag()
    if "filter" in stages:
        cloud = np.random.default_rng(0).uniform(-3, 3, (200, 3)).astype(np.float32)
        classify_scan_paper(cloud, np.eye(4), PaperSettings(), seed=0)
    if "map" in stages:
        window = window_around(np.zeros(2), 0.1, 11)
        occupied = occupancy(np.array([[0.2, 0.2]]), window, 1)
        AccumulatedMap(0.1).add(window, occupied, np.zeros(2))
        GroundHeight(0.1).add(np.zeros((1, 2)), np.zeros(1))
    if "plan" in stages:
        _walk_toy_map()
    return time.perf_counter() - started


def _locate_toy_tag() -> None:
    """A second of a tag that walks between three anchors, with every step that a real one takes."""
    anchor_m = np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [0.0, 8.0, 1.0]])
    t_ns = np.arange(50, dtype=np.int64) * 20_000_000
    walk_m = np.column_stack([2 + t_ns * 1e-9, np.full(50, 3.0), np.ones(50)])
    range_m = np.linalg.norm(walk_m[:, None] - anchor_m, axis=2)
    ids = np.arange(3, dtype=np.int64)
    ranges = RangeSeries(np.repeat(t_ns, 3), np.zeros(150, dtype=np.int64), np.tile(ids, 50), range_m.ravel())
    locate(ranges, Anchors(ids, anchor_m, np.zeros(3)), [TagInfo(0, 1.0)], LocateSettings())
    locate(ranges, Anchors(ids, anchor_m, np.zeros(3)), [TagInfo(0, 1.0)], LocateSettings(smooth=False))


def _walk_toy_map() -> None:
    """Two replans and a few ticks about an obstacle, from inside its dilation to a goal outside the window."""
    window = window_around(np.zeros(2), 0.1, 41)
    occupied = np.zeros(window.shape, dtype=np.bool_)
    occupied[18:23, 22] = True
    instants = [MapInstant(t_ns, window, occupied, occupied) for t_ns in (0, 100_000_000)]
    replanner = Replanner(make_planner("ia_star"), ReplanSettings())
    resimulate(instants, lambda t_ns: np.tile([5.0, 0.5], (len(t_ns), 1)), np.zeros(3), replanner, PursuitSettings())
