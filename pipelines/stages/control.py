"""Stage `control`: the walk again, closed loop, on the recorded maps and towards the recorded target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.config.controllers import CONTROLLERS, parts_of
from quadlog.config.schema import Config
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.errors import TooLarge
from quadlog.mapping.grid import crop, window_at
from quadlog.mapping.memory import OCCUPIED
from quadlog.messages import NS_PER_S, Float, Int
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.simulation import walk as walks
from quadlog.pipelines.simulation.courses import walkable_ground
from quadlog.pipelines.stages import plan as planning
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.log import LogData
from quadlog.pipelines.stages.tracks import RobotTrack, Tracks
from quadlog.positioning.unlocated import segment_of
from quadlog.results.arrays import load_maps
from quadlog.results.tables import TABLES, write_table
from quadlog.simulation.commanded import held, walk_commanded
from quadlog.simulation.contacts import Contact, Footprint
from quadlog.simulation.course_walk import SPEED_MPS, Driver
from quadlog.simulation.resimulation import MAX_TICKS, MapInstant, Resimulation
from quadlog.simulation.resimulation import resimulate as walk
from quadlog.simulation.robot.height_field import HeightField, flat
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.unicycle_robot import UnicycleRobot
from quadlog.simulation.robot.walking_robot import WalkingRobot
from quadlog.simulation.settings import RATE_HZ
from quadlog.storage.formats.ros_map import read_rosmap


def resimulate(
    folder: Path, journal: Journal, config: Config, maps: Path, tracks: Tracks, seed: int
) -> dict[str, Any] | None:
    """control, clearances, contacts, resim_plans and resim_paths; nothing without a controller. Returns the body."""
    maps_ns, target = load_maps(maps).t_ns, tracks.target
    if target is None or config.simulation.parts is None or len(maps_ns) == 0:
        return None
    journal.progress.begin("control", len(maps_ns))
    if config.simulation.has_body:
        warm_up(config.simulation.controller)  # else the first tick's time would be that of loading
    with journal.clock.stage("control"):
        starts = _starts(np.sort(maps_ns), tracks.robot, config.lidar.pose_gap_s)
        replanner = planning.replanner_of(config, target)
        instants = _counted(_with_what_stands(maps, starts), journal.progress)
        ground, why_plane = walkable_ground(maps, config.simulation.friction)
        if why_plane and config.simulation.has_body:
            journal.warn(why_plane)
        robot = _robot(config, ground, starts.pop(int(maps_ns.min())), seed)
        body, driver = Footprint(*config.robot.body_m[:2]), _driver(config, robot)
        resim = walk(instants, target.at, driver, replanner, body, config.pursuit.clear_chord)
        _write_walk(folder, resim)
    if resim.outside_replans:
        journal.count("replans_outside_window", resim.outside_replans)
    if resim.outside_ticks:
        journal.count("ticks_outside_window", resim.outside_ticks)
        journal.warn(f"{resim.outside_ticks} ticks of the re-simulated walk lie outside the recorded maps")
    return _body_of(robot, journal, config, resim.control)


def walk_by_commands(
    folder: Path, journal: Journal, config: Config, data: LogData, tracks: Tracks, seed: int
) -> dict[str, Any] | None:
    """control, of a robot driven open loop by the log's commands, on a plane from its first pose on. Returns the body.

    Raises TooLarge.
    """
    commands, track, hold_s = data.streams.commands, tracks.robot, config.simulation.command_hold_s
    if commands is None:
        journal.warn("no re-simulation: the log holds no command in this time")
        return None
    journal.use("command")
    journal.progress.begin("control", None)
    warm_up(config.simulation.controller)
    with journal.clock.stage("control"):
        tick_ns, (first_ns, last_ns) = NS_PER_S / RATE_HZ, track.t_ns[[0, -1]].tolist()
        ticks = int((last_ns - first_ns) / tick_ns) + 1
        if ticks > MAX_TICKS:
            raise TooLarge("ticks of the re-simulated walk", ticks, MAX_TICKS)
        t_ns = first_ns + np.rint(np.arange(ticks) * tick_ns).astype(np.int64)
        logged = track.poses_at(t_ns, config.lidar.pose_gap_s)
        robot = _robot(config, flat(), logged[0].copy(), seed)
        assert isinstance(robot, WalkingRobot), "commands drive a body"
        if track.source == "fixed":
            logged[:] = np.nan
        twist, stale = held(t_ns, commands.t_ns, commands.twist, hold_s)
        control = walk_commanded(robot, _driver(config, robot), t_ns, twist, logged)
        write_table(folder / "control.parquet", TABLES["control"], control)
    journal.warn("the re-simulated robot walks on a plane, open loop: metrics of its way are differences from the log")
    if stale.any():
        journal.warn(
            f"in {stale.mean():.0%} of the walk the last command is older than {hold_s:g} s and counts as 0; let them "
            f"hold longer with  --set simulation.command_hold_s={2 * hold_s:g}"
        )
    return _body_of(robot, journal, config, control)


def _body_of(
    robot: WalkingRobot | UnicycleRobot, journal: Journal, config: Config, control: Mapping[str, Any]
) -> dict[str, Any] | None:
    """What a walk leaves of its robot's body, None without one; says how the walk went."""
    if np.any(control["fallen"]):
        journal.warn("the re-simulated robot fell, and lay from there on")
    journal.count("ticks", len(np.atleast_1d(control["t_ns"])))
    if not isinstance(robot, WalkingRobot):
        return None
    journal.counts |= robot.counts
    journal.warn(*walks.walk_warnings(robot.counts, robot.mass_kg, config.mpc.f_max_n))
    effort = {name: float(value) for name, value in asdict(robot.effort).items()}
    return {"mass_kg": float(robot.mass_kg), "ticks": int(robot.ticks), "effort": effort}


def warm_up(controller: str) -> None:
    """Load what a robot with a body needs, and compile it at the first start, by a tenth of a second of one."""
    settings = WalkerSettings(whole_body=(parts_of(controller) or CONTROLLERS["fpmw"]).whole_body)
    model = quadruped_model(ROBOTS["tracking"], flat())
    WalkingRobot(model, settings, np.zeros(3), np.random.default_rng(0)).walk(50, 0.3, 0.1)


def _write_walk(folder: Path, resim: Resimulation) -> None:
    """The tables of a re-simulated walk."""
    write_table(folder / "control.parquet", TABLES["control"], resim.control)
    beside = {"clearance_m": resim.clearance_m, "target_distance_m": resim.target_distance_m}
    write_table(folder / "clearances.parquet", TABLES["clearances"], {"t_ns": resim.control["t_ns"], **beside})
    contacts = zip(*resim.contacts, strict=True) if resim.contacts else [()] * len(Contact._fields)
    write_table(folder / "contacts.parquet", TABLES["contacts"], dict(zip(Contact._fields, contacts, strict=True)))
    with planning.plan_tables(folder, "resim_plans", "resim_paths") as add:
        paths = {path.t_ns: path for path in resim.paths}
        for row in resim.plans:
            add(row, paths.get(row["t_ns"]))


def _starts(maps_ns: Int, robot: RobotTrack, gap_s: float) -> dict[int, Float]:
    """Instants of maps (N,) at which a walk begins, after gaps too, and the poses (3,) there."""
    parts = segment_of(maps_ns, robot.t_ns, gap_s) * (robot.source != "fixed")
    first_ns = maps_ns[np.unique(parts, return_index=True)[1]]
    poses = robot.poses_at(first_ns, gap_s)
    assert np.isfinite(poses).all(), "a map is only made where there is a pose"
    return dict(zip(first_ns.tolist(), poses, strict=True))


def _with_what_stands(run: Path, starts: dict[int, Float]) -> Iterator[MapInstant]:
    """The recorded maps, each with what the map of the whole run has in its window; starts: where a walk begins.

    A scan sees half the surroundings, and may lose a wall; a walk through it
    must not pass for one without a collision.
    """
    whole = read_rosmap(run / "map.yaml")
    everywhere = window_at(whole.origin_m, whole.cell_m, whole.cells.shape)
    for instant in planning.recorded_maps(run):
        standing = crop(whole.cells == OCCUPIED, everywhere, instant.window)
        yield replace(instant, standing=standing, start_pose=starts.pop(instant.t_ns, None))


def _counted(instants: Iterator[MapInstant], progress: Progress) -> Iterator[MapInstant]:
    """The instants; what was walked before the next one is taken is a step of the progress."""
    first_ns = None
    for instant in instants:
        first_ns = instant.t_ns if first_ns is None else first_ns
        yield instant
        progress.advance((instant.t_ns - first_ns) / NS_PER_S)


def _robot(config: Config, ground: HeightField, start_pose: Float, seed: int) -> WalkingRobot | UnicycleRobot:
    """A robot with a body on a ground, or one without."""
    rng = np.random.default_rng([seed, *b"resimulation"])
    disturbances = config.simulation.disturbances
    if not config.simulation.has_body:
        return UnicycleRobot(start_pose, 1 / RATE_HZ, rng, disturbances)
    model = walks.robot_model(config, ground)
    return WalkingRobot(model, walks.walker_settings(config), start_pose, rng, disturbances)


def _driver(config: Config, robot: WalkingRobot | UnicycleRobot) -> Driver:
    """What drives the robot along its plans."""
    speed_mps = config.pursuit.speed_mps or SPEED_MPS
    return Driver(robot, walks.lookahead_control(config), speed_mps, config.pursuit.max_yaw_rate_radps)
