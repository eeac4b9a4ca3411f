"""A run against a reference trajectory, its own or one from elsewhere, paired in time as evo does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from quadlog.config.file import load_config
from quadlog.config.schema import Config, UwbConfig
from quadlog.errors import NoCommonTime, NotARun, UnreadableFile, UsageError
from quadlog.geometry import poses_in_space
from quadlog.messages import NS_PER_S, Int, PoseSeries
from quadlog.metrics.positioning import fix_error_samples
from quadlog.metrics.reference_offset import TRAJECTORY_METRICS, compare_trajectories, estimate_time_offset
from quadlog.metrics.summary import Samples
from quadlog.pipelines.stages.positions.uwb_tags import lever_of, roles_of, tag_truth
from quadlog.results.record import read_record
from quadlog.results.tables import has_table, read_table
from quadlog.storage.formats.tum import read_tum


@dataclass(frozen=True, slots=True)
class RobotTag:
    """The tag that the robot carried, None when there is none, and where it sits in base, x_m and y_m."""

    id: int | None
    lever_m: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def among(cls, tags: Iterable[int], config: Config) -> Self:
        """The robot's of the tags that ranged."""
        tag = roles_of(config, sorted(tags)).get("robot")
        return cls(None) if tag is None else cls(tag, lever_of(config, tag))


def robot_tag_of(run: Path) -> RobotTag:
    """The robot's tag in a saved run. Raises NotARun."""
    name = "ranges" if has_table(run, "ranges") else "fixes"
    tags = np.unique(read_table(run, name, ["tag"])["tag"])
    return RobotTag.among(tags.tolist(), read_record(run).config)


REFERENCE_METRICS = ("uwb_rmse_m", "uwb_bias_m", *TRAJECTORY_METRICS)
_SEEN_M = 1e-3
_LONGEST_S = 9_000_000_000  # what int64 nanoseconds hold


@dataclass(frozen=True, slots=True)
class OnTime:
    """How poses are paired and compared, each as evo's option: --t_max_diff, --t_offset, --align, --project_to_plane.

    offset_s is added to the run's times; planar: both in the plane z = 0, None for where either is known in it alone.

    Raises UsageError for what is no time.
    """

    max_difference_s: float = 0.01
    offset_s: float = 0.0
    align: bool = False
    planar: bool | None = False

    def __post_init__(self) -> None:
        # Neither comparison is true of NaN.
        if not (0 <= self.max_difference_s <= _LONGEST_S and abs(self.offset_s) <= _LONGEST_S):
            raise UsageError(f"--t-max-diff and --t-offset are finite seconds, at most {_LONGEST_S}")


@dataclass(frozen=True, slots=True)
class Reference:
    """A trajectory that counts as true, how runs are compared with it, and what its file does not have as it should."""

    path: Path
    poses: PoseSeries
    how: OnTime
    warnings: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path, how: OnTime) -> Self:
        """From a TUM file. Raises UnreadableFile, TooLarge."""
        warnings = list[str]()
        return cls(path, read_tum(path, warnings), how, tuple(warnings))


@dataclass(frozen=True, slots=True)
class ReferenceErrors:
    """The samples of REFERENCE_METRICS, those that apply, and lines for people on how they were paired.

    summary: the reference's clock and the errors, in one line; warnings: a clock or a frame that is not the poses'.
    dimensions: whether errors are those in the plane or in space, and why. in_any_frame: those of the warnings that
    have nothing to do with frames.
    """

    samples: dict[str, Samples]
    said: tuple[str, ...]
    summary: str
    warnings: tuple[str, ...]
    dimensions: str
    in_any_frame: list[str]


def compare_with_reference(run: Path, reference: Reference) -> ReferenceErrors:
    """The trajectory's errors pair by pair, and those of the robot's UWB fixes. Raises as `compare_trajectory` does."""
    compared = compare_trajectory(run, reference)
    of_fixes = compare_fixes(run, reference, robot_tag_of(run)) if has_table(run, "fixes") else {}
    return replace(compared, samples=compared.samples | of_fixes)


def compare_trajectory(run: Path, reference: Reference) -> ReferenceErrors:
    """The trajectory's errors pair by pair.

    Raises NoCommonTime when no two poses are near in time, NotARun for a run without a trajectory.
    """
    how, truth, (estimate, why_planar) = reference.how, reference.poses, _trajectory_of(run)
    why_planar = why_planar or ("the reference lies in a plane" if _is_planar(truth) else "")
    planar = bool(why_planar) if how.planar is None else how.planar
    options = how.max_difference_s, how.offset_s
    compared = compare_trajectories(truth, estimate, *options, align=how.align, planar=planar)
    if compared is None:
        words = f"no two poses within {how.max_difference_s:g} s; {_ranges(truth.t_ns, estimate.t_ns, how)}"
        found = estimate_time_offset(truth, estimate)
        # A flag to paste only where no other offset would do as well: a wrong one gives errors that look like results.
        advice = f"; estimated --t-offset {found.offset_s:.3f}" if found.offset_s is not None else ""
        raise NoCommonTime(reference.path, f"{run}: {words}; {found.words()}{advice}")
    n, ranges = len(compared.truth.t_ns), _ranges(truth.t_ns, estimate.t_ns, how)
    dimensions = _dimension_words(planar, how, why_planar)
    summary = f"errors in {dimensions}; {compared.summary()}"
    said = [f"{reference.path}: {n} poses of {run} paired; {ranges}", f"{reference.path}: {summary}"]
    warnings = tuple(compared.warnings())
    said += [f"warning: {words}" for words in warnings]
    height_m = compared.truth.position_m[:, 2] - compared.estimate.position_m[:, 2]
    if (apart_m := float(np.sqrt(np.mean(height_m**2)))) >= _SEEN_M:
        said.append(
            f"heights differ by {apart_m:.3f} m rms, and errors include them; --project-to-plane xy leaves them out"
        )
    return ReferenceErrors(compared.samples, tuple(said), summary, warnings, dimensions, compared.in_any_frame)


def _dimension_words(planar: bool, how: OnTime, why_planar: str) -> str:
    if planar:
        return f"2-D ({why_planar if how.planar is None else '--project-to-plane xy'})"
    if why_planar:
        return f"3-D ({why_planar}; heights that are not known count as 0; --project-to-plane xy leaves heights out)"
    return "3-D"


def _is_planar(trajectory: PoseSeries) -> bool:
    """Whether its height never changes, as that of an odometry or a tracker of the plane."""
    return bool(np.ptp(trajectory.position_m[:, 2]) == 0)


def compare_with_own_reference(run: Path) -> ReferenceErrors | None:
    """The saved poses against the recording's own reference, in space where both have heights, else in the plane.

    In the plane too where the height of the tag, from which that of base follows, is only the default.

    None without either, or without a pair.
    """
    path = run / "reference.tum"
    if not path.is_file() or not has_table(run, "poses"):
        return None
    try:
        return compare_trajectory(run, Reference.read(path, OnTime(planar=None)))
    except NoCommonTime:
        return None


def _trajectory_of(run: Path) -> tuple[PoseSeries, str]:
    """The poses that trajectory.tum holds, which evo would be given; from poses.parquet where a run has it.

    With why they are known in the plane alone, empty where heights are known; unknown roll and pitch count as 0.
    """
    if has_table(run, "poses"):
        return _trajectory_of_poses(run)
    path = run / "trajectory.tum"
    if not path.is_file():
        raise NotARun(run, "has no trajectory to compare: neither poses.parquet nor trajectory.tum")
    try:
        trajectory = read_tum(path)
    except UnreadableFile as error:
        raise NotARun(path, f"is damaged: {error.reason}") from error
    return trajectory, "the poses lie in a plane" if _is_planar(trajectory) else ""


def _trajectory_of_poses(run: Path) -> tuple[PoseSeries, str]:
    table = read_table(run, "poses")
    if set(table["source"]) == {"fixed"}:
        raise NotARun(run, "has no trajectory to compare: its poses are fixed")
    tilt_rad = np.column_stack([table["roll_rad"], table["pitch_rad"]])
    position_m, quat_xyzw = poses_in_space(table["x_m"], table["y_m"], table["yaw_rad"], table["z_m"], tilt_rad)
    known = np.flatnonzero(np.isfinite(position_m).all(axis=1) & np.isfinite(table["yaw_rad"]))
    if len(known) == 0:
        raise NotARun(run, "has no trajectory to compare: poses.parquet holds no pose")
    trajectory = PoseSeries(table["t_ns"], position_m, quat_xyzw).rows(known)
    if not np.isfinite(table["z_m"][known]).all():
        return trajectory, "heights of the poses are not known"
    if set(table["source"]) == {"uwb"} and _tag_height_is_default(run):
        return trajectory, "the tag's height_m in [[uwb.tags]] is not set"
    return trajectory, "the poses lie in a plane" if _is_planar(trajectory) else ""


def _tag_height_is_default(run: Path) -> bool:
    """Whether nothing in the run's configuration gives the height of the robot's tags, from which base's follows."""
    path = run / "config.toml"
    uwb = (load_config(path) if path.is_file() else Config()).uwb
    own = [tag.height_m for tag in uwb.tags if tag.role == "robot"]
    return uwb.tag_height_m == UwbConfig().tag_height_m and (not own or None in own)


def compare_fixes(run: Path, reference: Reference, robot: RobotTag) -> dict[str, Samples]:
    """The errors of the fixes of the robot's tag, unaligned, where the reference has poses around them.

    Raises NotARun for a run without fixes.
    """
    fixes = read_table(run, "fixes", ["t_ns", "tag", "x_m", "y_m"])
    own = fixes["tag"] == robot.id
    t_ns = fixes["t_ns"][own]
    truth_m = tag_truth(t_ns + round(reference.how.offset_s * NS_PER_S), reference.poses, robot.lever_m)
    samples = fix_error_samples(t_ns, np.column_stack([fixes["x_m"][own], fixes["y_m"][own]]) - truth_m)
    return {name: each for name, each in samples.items() if len(each.values)}


def _ranges(truth_ns: Int, estimate_ns: Int, how: OnTime) -> str:
    offset_ns = round(how.offset_s * NS_PER_S)
    first, last = int(estimate_ns[0]) + offset_ns, int(estimate_ns[-1]) + offset_ns
    overlap_s = max(0, min(int(truth_ns[-1]), last) - max(int(truth_ns[0]), first)) / NS_PER_S
    reference = f"{truth_ns[0] / NS_PER_S:.3f} to {truth_ns[-1] / NS_PER_S:.3f} s"
    return f"reference {reference}, run {first / NS_PER_S:.3f} to {last / NS_PER_S:.3f} s, overlap {overlap_s:.3f} s"
