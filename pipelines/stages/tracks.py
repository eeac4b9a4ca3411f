"""Where the robot and the target were: what stage `position` gives the later ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from quadlog.geometry import interpolate_poses
from quadlog.messages import Float, Int
from quadlog.metrics.walking import Effort
from quadlog.results.tables import TABLES, has_table, read_table, write_table
from quadlog.storage.formats.tum import write_tum

TARGET_GAP_S = 1.0
"""Positions of the target are interpolated over gaps of at most this."""


@dataclass(frozen=True, slots=True)
class RobotTrack:
    """Poses of base in map: t_ns (N,), xy_m (N, 2), yaw_rad (N,); their source, and the name it gives to the frame.

    covariance_m2 (N, 2, 2) of the positions and yaw_std_rad (N,), where they are known. z_m (N,) and tilt_rad (N, 2),
    roll and pitch: NaN at instants without a value, None without a source.
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
        xy_m, source = np.column_stack([poses["x_m"], poses["y_m"]]), "".join(poses["source"][:1])
        tilt_rad = np.column_stack([poses["roll_rad"], poses["pitch_rad"]])
        spreads = covariance_m2, yaw_std_rad
        return cls(poses["t_ns"], xy_m, poses["yaw_rad"], source, frame_id, *spreads, poses["z_m"], tilt_rad)

    def columns(self) -> dict[str, Any]:
        """Those of poses.parquet."""
        x_m, y_m = self.xy_m.T
        roll_rad, pitch_rad = (np.nan, np.nan) if self.tilt_rad is None else self.tilt_rad.T
        places = {"t_ns": self.t_ns, "x_m": x_m, "y_m": y_m, "yaw_rad": self.yaw_rad, "source": self.source}
        z_m = np.nan if self.z_m is None else self.z_m
        return places | {"z_m": z_m, "roll_rad": roll_rad, "pitch_rad": pitch_rad}

    def write(self, folder: Path) -> None:
        """poses.parquet and trajectory.tum, with the stds that there are. Raises CannotWrite."""
        write_table(folder / "poses.parquet", TABLES["poses"], self.columns())
        if self.covariance_m2 is not None and self.yaw_std_rad is not None:
            axes = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1)}
            spread = {f"cov_{name}_m2": self.covariance_m2[:, *at] for name, at in axes.items()}
            instants = {"t_ns": self.t_ns, "yaw_std_rad": self.yaw_std_rad}
            write_table(folder / "pose_uncertainty.parquet", TABLES["pose_uncertainty"], instants | spread)
        x_m, y_m = self.xy_m.T
        write_tum(folder / "trajectory.tum", self.t_ns, x_m, y_m, self.yaw_rad, self.z_m, self.tilt_rad)

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
        return cls(target["t_ns"], np.column_stack([target["x_m"], target["y_m"]]), "".join(target["source"][:1]))

    def write(self, folder: Path) -> None:
        """target.parquet. Raises CannotWrite."""
        columns = {"t_ns": self.t_ns, "x_m": self.xy_m[:, 0], "y_m": self.xy_m[:, 1], "source": self.source}
        write_table(folder / "target.parquet", TABLES["target"], columns)

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


@dataclass(frozen=True, slots=True)
class Tracks:
    """Of the robot, and of what it follows, None without; reference_frame: the frame that a reference names."""

    robot: RobotTrack
    target: TargetTrack | None
    reference_frame: str

    @classmethod
    def load(cls, folder: Path, state: Any) -> Self:
        """As stage `position` has left them. Raises NotARun."""
        target = TargetTrack.read(folder) if has_table(folder, "target") else None
        return cls(RobotTrack.read(folder, state["frame"]), target, state["reference_frame"])


@dataclass(frozen=True, slots=True)
class WalkedBody:
    """Mass and effort of a re-simulated robot's body over a number of ticks of the simulation."""

    mass_kg: float
    ticks: int
    effort: Effort

    @classmethod
    def load(cls, _: Path, state: Any) -> Self | None:
        """As stage `control` has left it; None where no body walked."""
        return None if state is None else cls(state["mass_kg"], state["ticks"], Effort(**state["effort"]))
