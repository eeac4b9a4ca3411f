"""The state of a replay: what was read, where robot and target were, and what each stage leaves for the next."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import CannotWrite, MissingInput
from quadlog.geometry import interpolate_poses
from quadlog.messages import Float, Int
from quadlog.metrics.walking import Effort
from quadlog.pipelines.executor.progress import Progress, StageClock
from quadlog.pipelines.stages.scans import LidarTracker, Scanner
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.recording import Recording
from quadlog.recordings.roles import Roles
from quadlog.recordings.streams import Streams
from quadlog.results.record import InputRecord
from quadlog.results.run import Run
from quadlog.results.tables import has_table, read_table

if TYPE_CHECKING:
    from quadlog.positioning.leg_odometry import LegTrack

TARGET_GAP_S = 1.0
"""Positions of the target are interpolated over gaps of at most this."""


@dataclass(frozen=True, slots=True)
class RobotTrack:
    """Poses of base in map: t_ns (N,), xy_m (N, 2), yaw_rad (N,); their source, and the name it gives to the frame.

    covariance_m2 (N, 2, 2) of the positions and yaw_std_rad (N,), where they are known. z_m (N,) and tilt_rad (N, 2),
    roll and pitch: NaN where nothing tells them, None where nothing ever does.
    """

    t_ns: Int
    xy_m: Float
    yaw_rad: Float
    source: str
    frame_id: str = ""
    covariance_m2: Float | None = None
    yaw_std_rad: Float | None = None
    z_m: Float | None = None
    tilt_rad: Float | None = None

    @classmethod
    def read(cls, run: Path, frame_id: str = "") -> Self:
        """As `position` has saved it; no table has the frame's name. Raises NotARun."""
        poses = read_table(run, "poses")
        covariance_m2: Float | None = None
        yaw_std_rad: Float | None = None
        if has_table(run, "pose_uncertainty"):
            spread = read_table(run, "pose_uncertainty")
            xx_m2, xy_m2, yy_m2 = (spread[f"cov_{axes}_m2"] for axes in ("xx", "xy", "yy"))
            covariance_m2 = np.stack([np.stack([xx_m2, xy_m2], axis=1), np.stack([xy_m2, yy_m2], axis=1)], axis=1)
            yaw_std_rad = spread["yaw_std_rad"]
        xy_m, source = np.column_stack([poses["x_m"], poses["y_m"]]), _first_of(poses["source"])
        tilt_rad = np.column_stack([poses["roll_rad"], poses["pitch_rad"]])
        spreads = covariance_m2, yaw_std_rad
        return cls(poses["t_ns"], xy_m, poses["yaw_rad"], source, frame_id, *spreads, poses["z_m"], tilt_rad)

    def poses_at(self, t_ns: Int, max_gap_s: float) -> Float:
        """(M, 3) x_m, y_m, yaw_rad at instants (M,), NaN where no pose is near enough."""
        if self.source == "fixed":
            return np.tile([*self.xy_m[0], self.yaw_rad[0]], (len(t_ns), 1))
        xy_m, yaw_rad, _ = interpolate_poses(t_ns, self.t_ns, self.xy_m, self.yaw_rad, max_gap_s)
        return np.column_stack([xy_m, yaw_rad])

    def pose_at(self, t_ns: int, max_gap_s: float) -> Float | None:
        """(3,) at one instant, or None."""
        pose: Float = self.poses_at(np.array([t_ns]), max_gap_s)[0]
        return pose if np.isfinite(pose).all() else None


@dataclass(frozen=True, slots=True)
class TargetTrack:
    """Positions of what is followed in map: t_ns (N,), xy_m (N, 2).

    has_body: whether it returns the lidar's rays; a point ahead of the robot does not.
    """

    t_ns: Int
    xy_m: Float
    source: str

    @classmethod
    def read(cls, run: Path) -> Self:
        """As `position` has saved it. Raises NotARun."""
        target = read_table(run, "target")
        return cls(target["t_ns"], np.column_stack([target["x_m"], target["y_m"]]), _first_of(target["source"]))

    @property
    def has_body(self) -> bool:
        """Whether returns near it are its own, rather than an obstacle's."""
        return self.source not in ("ahead", "fixed")

    def at(self, t_ns: Int) -> Float:
        """(M, 2) at instants (M,), NaN where it was not seen."""
        if self.source == "fixed":
            return np.tile(self.xy_m[0], (len(t_ns), 1))
        still = np.zeros(len(self.t_ns))
        xy_m, _, _ = interpolate_poses(t_ns, self.t_ns, self.xy_m, still, TARGET_GAP_S)
        return xy_m


def _first_of(sources: np.ndarray) -> str:
    """The source, which is the same in every row."""
    return str(sources[0]) if len(sources) else ""


def needed_lidar(roles: Roles) -> str:
    """The topic of the point clouds. Raises AmbiguousTopic, MissingInput."""
    topic = roles.topic("lidar")
    if topic is None:
        raise MissingInput("filter", roles.why_none("lidar"), "stop before it with  --until position")
    return topic


@dataclass(frozen=True, slots=True)
class WalkedBody:
    """Mass and effort of a re-simulated robot's body over a number of ticks of the simulation."""

    mass_kg: float
    ticks: int
    effort: Effort


class WhatWasRead(NamedTuple):
    """Losses and warnings of the recording from the earlier replay that read its clouds."""

    losses: list[Loss]
    warnings: list[str]


@dataclass
class ReplayContext:
    """State shared by the stages of one replay: each reads what earlier ones added, and adds its own results.

    start_ns, end_ns: the requested window on the chosen clock, None where it is open. first_ns, last_ns: first and last
    instant of its messages. lidar_mount_known: whether configuration, tf or odometry gives the lidar's place. scanner:
    compact scans of its clouds, None where clouds are not read. tracker: the robot's track by its clouds, None where it
    is not made. legs: the body's track by its joints. used: role -> topics
    that were used for it. body: of the re-simulated robot, None without one, for metrics that no table gives. reused:
    stages taken from an earlier replay; keep: their files. left: files of all stages so far. read_before: losses and
    warnings of reused clouds. config: with the anchors that the messages contain where none are configured;
    anchors_from_messages says so.
    """

    config: Config
    seed: int
    run: Run
    input: InputRecord
    recording: Recording
    roles: Roles
    streams: Streams
    clock: StageClock
    progress: Progress
    transform_lidar_to_base: Float
    start_ns: int | None
    end_ns: int | None
    first_ns: int
    last_ns: int
    scanner: Scanner | None = None
    tracker: LidarTracker | None = None
    legs: LegTrack | None = None
    robot: RobotTrack | None = None
    target: TargetTrack | None = None
    used: dict[str, tuple[str, ...]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    body: WalkedBody | None = None
    notes: list[str] = field(default_factory=list)
    own_warnings: list[str] = field(default_factory=list)
    own_losses: list[Loss] = field(default_factory=list)
    reused: tuple[str, ...] = ()
    keep: tuple[str, ...] = ()
    left: set[str] = field(default_factory=set)
    read_before: WhatWasRead | None = None
    anchors_from_messages: bool = False
    lidar_mount_known: bool = True
    _folder_begun: bool = False
    _said: set[str] = field(default_factory=set)

    @property
    def read_losses(self) -> list[Loss]:
        """Losses of the recording so far, without repetition."""
        read = self.recording.losses if self.read_before is None else self.read_before.losses
        return list(dict.fromkeys([*read, *self.streams.losses]))

    @property
    def losses(self) -> list[Loss]:
        """All losses so far: those of the recording, and of positions."""
        return [*self.read_losses, *self.own_losses]

    @property
    def read_warnings(self) -> list[str]:
        """Warnings of the recording so far."""
        return list(self.recording.warnings if self.read_before is None else self.read_before.warnings)

    @property
    def warnings(self) -> list[str]:
        """All warnings without repetition, in their order."""
        return list(dict.fromkeys([*self.read_warnings, *self.streams.warnings, *self.own_warnings]))

    @property
    def recorded_s(self) -> float:
        """Length of what was replayed."""
        return (self.last_ns - self.first_ns) * 1e-9

    def begin_folder(self) -> None:
        """Prepare the run folder once: earlier results are removed, except the files to keep.

        Called before the first file is written, so that a replay that fails earlier leaves an earlier run as it was.
        """
        if not self._folder_begun:
            self.run = Run.create(self.run.path, self.run.record, self.keep)
            self._folder_begun = True

    def check_left(self) -> None:
        """Raises CannotWrite when a stage's file is missing, so that an incomplete run is not marked as finished."""
        for name in sorted(self.left):
            if not (self.run.path / name).is_file():
                raise CannotWrite(self.run.path / name, "another process has removed it")

    def warn(self, text: str) -> None:
        """A line for stderr, `run.json` and the report."""
        self.own_warnings.append(text)
        self.say_what_is_new()

    def note(self, text: str) -> None:
        """A choice that decided the result: a line for stderr, `run.json` and the report."""
        self.notes.append(text)
        self.progress.say(text)

    def say_what_is_new(self) -> None:
        """Print each new loss and warning on stderr; readers find some only at the end."""
        lines = [f"warning: {text}" for text in self.warnings]
        lines += [f"lost: {loss.topic + ': ' if loss.topic else ''}{loss.detail}" for loss in self.losses]
        for line in lines:
            if line not in self._said:
                self._said.add(line)
                self.progress.say(line)

    def use(self, role: str, *topics: str) -> None:
        """Record that topics were used in a role; by default those detected for it."""
        self.used[role] = topics or self.roles.topics(role)

    def count(self, name: str, amount: int = 1) -> None:
        """Add to a count of `run.json`."""
        self.counts[name] = self.counts.get(name, 0) + amount

    def lidar_topic(self) -> str:
        """The topic of the point clouds. Raises AmbiguousTopic, MissingInput."""
        return needed_lidar(self.roles)

    def robot_pose_at(self, t_ns: int) -> Float | None:
        """The pose (3,) x_m, y_m, yaw_rad of base in map at an instant, None where no pose is near enough."""
        return None if self.robot is None else self.robot.pose_at(t_ns, self.config.lidar.pose_gap_s)

    def targets_at(self, t_ns: np.ndarray) -> Float:
        """Positions (N, 2) of the target in map at instants (N,), NaN where unknown."""
        if self.target is None:
            return np.full((len(t_ns), 2), np.nan)
        return self.target.at(t_ns)

    def solid_targets_at(self, t_ns: np.ndarray) -> Float:
        """The same of a target with a body, whose returns are kept out of the map; else NaN."""
        solid = self.target is not None and self.target.has_body
        return self.targets_at(t_ns) if solid else np.full((len(t_ns), 2), np.nan)
