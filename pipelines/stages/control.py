"""Stage `control`: the walk again, closed loop, on the recorded maps and towards the recorded target."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from quadlog.mapping.accumulated_map import OCCUPIED
from quadlog.mapping.grid import crop, window_at
from quadlog.messages import NS_PER_S, Float
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.simulation.courses import walkable_ground
from quadlog.pipelines.simulation.walk import (
    check_rate,
    disturbance_settings,
    lookahead_control,
    robot_model,
    solver_counts,
    walker_settings,
)
from quadlog.pipelines.stages.context import ReplayContext, WalkedBody
from quadlog.pipelines.stages.plan import PlanTables, configured_planner, recorded_maps, replan_settings
from quadlog.planning.replan import Replanner
from quadlog.results.arrays import load_maps
from quadlog.results.tables import TABLES, write_table
from quadlog.simulation.contacts import Contact
from quadlog.simulation.course_walk import SPEED_MPS
from quadlog.simulation.resimulation import MapInstant, PursuitSettings, resimulate
from quadlog.simulation.robot.height_field import HeightField
from quadlog.simulation.robot.unicycle_robot import UnicycleRobot
from quadlog.simulation.robot.walking_robot import WalkingRobot
from quadlog.storage.formats.ros_map import read_rosmap


def resimulate_walk(walk: ReplayContext) -> None:
    """control, clearances, contacts, resim_plans and resim_paths; nothing without a target or a controller."""
    config = walk.config
    maps = load_maps(walk.run.path)
    if walk.target is None or config.simulation.parts is None or len(maps) == 0:
        return
    walk.progress.begin("control", len(maps))
    with walk.clock.stage("control"):
        start = walk.robot_pose_at(int(maps.t_ns.min()))
        assert start is not None, "a map is only made where there is a pose"
        replanner = Replanner(configured_planner(config), replan_settings(walk))
        instants = _counted(_with_what_stands(walk.run.path), walk.progress)
        robot = _robot(walk, start)
        resim = resimulate(instants, walk.targets_at, robot, lookahead_control(config), replanner, _settings(walk))
        write_table(walk.run.path / "control.parquet", TABLES["control"], resim.control)
        beside = {"clearance_m": resim.clearance_m, "target_distance_m": resim.target_distance_m}
        clearances = {"t_ns": resim.control["t_ns"], **beside}
        write_table(walk.run.path / "clearances.parquet", TABLES["clearances"], clearances)
        write_contacts(walk.run.path, resim.contacts)
        with PlanTables(walk.run.path, "resim_plans", "resim_paths") as tables:
            paths = {path.t_ns: path for path in resim.paths}
            for record in resim.plans:
                tables.add(record, paths.get(record.t_ns))
    if isinstance(robot, WalkingRobot):
        walk.body = WalkedBody(robot.mass_kg, robot.ticks, robot.effort)
        walk.counts |= solver_counts(robot)
    if robot.fallen:
        walk.warn("the re-simulated robot fell, and lay from there on")
    walk.counts["ticks"] = len(np.atleast_1d(resim.control["t_ns"]))
    if resim.outside_replans:
        walk.counts["replans_outside_window"] = resim.outside_replans
    if resim.outside_ticks:
        walk.counts["ticks_outside_window"] = resim.outside_ticks
        walk.warn(f"{resim.outside_ticks} ticks of the re-simulated walk lie outside the recorded maps")


def write_contacts(run: Path, contacts: Sequence[Contact]) -> None:
    """contacts.parquet, also where there was none."""
    columns = zip(*contacts, strict=True) if contacts else [()] * len(Contact._fields)
    write_table(run / "contacts.parquet", TABLES["contacts"], dict(zip(Contact._fields, columns, strict=True)))


def _with_what_stands(run: Path) -> Iterator[MapInstant]:
    """The recorded maps, each with what the map of the whole run has in its window.

    A scan sees half the surroundings, and may lose a wall; a walk through it
    must not pass for one without a collision.
    """
    whole = read_rosmap(run / "map.yaml")
    everywhere = window_at(whole.origin_m, whole.cell_m, whole.cells.shape)
    for instant in recorded_maps(run):
        yield replace(instant, standing=crop(whole.cells == OCCUPIED, everywhere, instant.window))


def _counted(instants: Iterator[MapInstant], progress: Progress) -> Iterator[MapInstant]:
    """The instants; what was walked before the next one is taken is a step of the progress."""
    first_ns = None
    for instant in instants:
        first_ns = instant.t_ns if first_ns is None else first_ns
        yield instant
        progress.advance((instant.t_ns - first_ns) / NS_PER_S)


def _robot(walk: ReplayContext, start_pose: Float) -> WalkingRobot | UnicycleRobot:
    """A robot with a body on the ground that the run saw, or one without."""
    config = walk.config
    rng = np.random.default_rng([walk.seed, *b"resimulation"])
    disturbances = disturbance_settings(config.simulation.disturbances)
    if not config.simulation.has_body:
        return UnicycleRobot(start_pose, 1 / config.pursuit.rate_hz, rng, disturbances)
    check_rate(config.pursuit.rate_hz)
    model = robot_model(config, _ground(walk))
    return WalkingRobot(model, walker_settings(config, model.robot), start_pose, rng, disturbances)


def _ground(walk: ReplayContext) -> HeightField:
    """The run's own height map where it has one that feet can stand on, else a plane, which is said."""
    ground, why_plane = walkable_ground(walk.run.path, walk.config.simulation.friction)
    if why_plane:
        walk.warn(why_plane)
    return ground


def _settings(walk: ReplayContext) -> PursuitSettings:
    pursuit, robot = walk.config.pursuit, walk.config.robot
    return PursuitSettings(
        speed_mps=SPEED_MPS if pursuit.speed_mps is None else pursuit.speed_mps,
        max_yaw_rate_radps=pursuit.max_yaw_rate_radps,
        rate_hz=pursuit.rate_hz,
        body_length_m=robot.length_m,
        body_width_m=robot.width_m,
        clear_chord=pursuit.clear_chord,
    )
