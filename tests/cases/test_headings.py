"""Headings of small recordings whose truth is known: how far off, how well known by their own account, what is said."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from quadlog.geometry import quat_from_euler, wrap_angle
from quadlog.messages import Imu, Odometry, Pose, UwbRanges
from quadlog.pipelines.evaluation.reference import compare_with_own_reference
from quadlog.pipelines.stages.tracks import RobotTrack
from quadlog.simulation.synthetic.recording import SynthesizedMessage
from quadlog.simulation.synthetic.writer import write_recording

START_NS = 1_767_225_600_000_000_000
ANCHORS_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [8.0, 7.0, 1.2], [0.0, 7.0, 1.2]])
LEVER_M = (0.3, -0.1)
NORTH_RAD = 2.0
DURATION_S, UWB_HZ, IMU_HZ = 20.0, 25, 50

CONFIG = """
[topics]
reference = "/truth"
[uwb]
calibrate = false
anchors = [{anchors}]
tags = [{{ id = 0, role = "robot", height_m = 0.6, x_m = 0.3, y_m = -0.1 }}]
"""


@dataclass
class Made:
    """A walk to be written: course and speed of base, what it looks away from its course, and its sensors' yaw."""

    speed_mps: float = 0.5
    looks_away: Callable[[np.ndarray], np.ndarray] = np.zeros_like
    imu_yaw: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    gyro_sign: float = 1.0
    gyro_bias_radps: float = 0.01
    gyro_nan_at: int | None = None
    odometry_yaw: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    reference_shift_m: tuple[float, float] = (0.0, 0.0)
    with_imu: bool = True
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(5))

    def base(self, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position (N, 2) and yaw (N,): a curve to the left, then one to the right."""
        fine_s = np.linspace(0, DURATION_S, 4001)
        course = 0.3 + 2.0 * np.sin(2 * np.pi * fine_s / DURATION_S)
        step = self.speed_mps * (fine_s[1] - fine_s[0]) * np.stack([np.cos(course), np.sin(course)], axis=1)
        place = np.array([3.0, 3.0]) + np.cumsum(step, axis=0) - step
        xy_m = np.stack([np.interp(t_s, fine_s, place[:, i]) for i in range(2)], axis=1)
        return xy_m, np.interp(t_s, fine_s, course) + self.looks_away(t_s)

    def messages(self) -> list[SynthesizedMessage]:
        said = [*self._uwb_and_truth(), *self._odometry()] + (list(self._imu()) if self.with_imu else [])
        return sorted(said, key=lambda each: each.log_time_ns)

    def _uwb_and_truth(self) -> Iterator[SynthesizedMessage]:
        t_s = np.arange(round(DURATION_S * UWB_HZ)) / UWB_HZ
        xy_m, yaw = self.base(t_s)
        cos, sin = np.cos(yaw), np.sin(yaw)
        tag_m = xy_m + np.stack([cos * LEVER_M[0] - sin * LEVER_M[1], sin * LEVER_M[0] + cos * LEVER_M[1]], axis=1)
        away = np.column_stack([tag_m, np.full(len(t_s), 0.6)])[:, None] - ANCHORS_M
        ranges = np.linalg.norm(away, axis=2) + 0.1 * self.rng.standard_normal((len(t_s), 4))
        for k, t_ns in enumerate(START_NS + np.rint(t_s * 1e9).astype(np.int64).astype(object)):
            yield SynthesizedMessage("/uwb", t_ns, UwbRanges(t_ns, 0, np.arange(4), ranges[k]))
            place = np.array([*(xy_m[k] + self.reference_shift_m), 0.0])
            yield SynthesizedMessage("/truth", t_ns, Pose(t_ns, "map", "base", place, quat_from_euler(yaw[k])))

    def _imu(self) -> Iterator[SynthesizedMessage]:
        t_s = np.arange(round(DURATION_S * IMU_HZ)) / IMU_HZ
        _, yaw = self.base(t_s)
        rate = self.gyro_sign * np.gradient(yaw, t_s) + self.gyro_bias_radps + 0.01 * self.rng.standard_normal(len(t_s))
        if self.gyro_nan_at is not None:
            rate[self.gyro_nan_at] = np.nan
        quat = np.zeros((len(t_s), 4)) if self.imu_yaw is None else quat_from_euler(self.imu_yaw(t_s, yaw))
        for k, t_ns in enumerate(START_NS + np.rint(t_s * 1e9).astype(np.int64).astype(object)):
            imu = Imu(t_ns, "base", quat[k], np.array([0.0, 0.0, rate[k]]), np.array([0.0, 0.0, 9.81]))
            yield SynthesizedMessage("/imu", t_ns, imu)

    def _odometry(self) -> Iterator[SynthesizedMessage]:
        if self.odometry_yaw is None:
            return
        t_s = np.arange(round(DURATION_S * UWB_HZ)) / UWB_HZ
        xy_m, yaw = self.base(t_s)
        said = self.odometry_yaw(t_s, yaw)
        for k, t_ns in enumerate(START_NS + np.rint(t_s * 1e9).astype(np.int64).astype(object)):
            place, quat = np.array([*xy_m[k], 0.0]), quat_from_euler(said[k])
            yield SynthesizedMessage(
                "/odom", t_ns, Odometry(t_ns, "odom", "base", place, quat, np.zeros(3), np.zeros(3))
            )


def turned_imu(t_s: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    return yaw - NORTH_RAD


def magnetised(t_s: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """A compass past iron: its north jumps by 60 degrees on the way."""
    return yaw + np.where(t_s < 13, 0.5, 1.5)


class Case(NamedTuple):
    """A walk, and its headings: the worst error, how many of their own standard deviations their errors have (rms).

    says: in the notes and warnings; source: whose yaw is used; late: the errors are those after that share of the walk.
    """

    made: Mapping[str, Any]
    settings: tuple[str, ...] = ()
    worst_deg: float = 180.0
    deviations: tuple[float, float] = (0.0, np.inf)
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    source: str | None = None
    late: float = 0.0


TURNED, CAUSAL = {"imu_yaw": turned_imu}, "uwb.smooth=false"
STANDS = {"speed_mps": 0.0, "looks_away": lambda t_s: -2.0 * np.sin(2 * np.pi * t_s / DURATION_S)}
UNMOVED = ("heading is the direction of travel", "the robot never moved for long enough while imu")
COURSE = {"with_imu": False, "speed_mps": 1.5}
ONLY = (
    "no IMU and no odometry: heading is the direction of travel",
    "wrong when the robot walks sideways or backwards",
)
CASES = {
    "imu": Case(TURNED, (), 3, (0.15, 2), ("heading from imu, turned by 11",), ("frame", "contradict"), "imu"),
    "gyroscope": Case({"gyro_bias_radps": 0.02}, (), 4, (0, 2), ("its drift of -",), ("upside down",), "imu"),
    "a rate that is NaN": Case({"gyro_nan_at": 200}, (), 4, says=("imu: 1 of 1000 messages",), source="imu"),
    "upside down": Case({"gyro_sign": -1.0}, (), 10, says=("upside down",), source="imu", late=0.75),
    "a frozen orientation": Case({"imu_yaw": lambda t_s, yaw: 0 * yaw}, (), 4, says=("the same in every message",)),
    "two that contradict": Case(
        {"imu_yaw": magnetised, "odometry_yaw": turned_imu}, (), 4, source="odometry",
        says=("heading from odometry (std", "odometry and imu contradict each other"),
    ),
    "stands, oriented, causal": Case(
        STANDS | {"imu_yaw": lambda t_s, yaw: 0.01 * t_s}, ("uwb.range_std_m=0.1", CAUSAL), says=UNMOVED
    ),
    "course": Case(COURSE, (), deviations=(0.2, 1.6), says=ONLY, late=0.25),
    "a reference elsewhere": Case(
        TURNED | {"reference_shift_m": (1.0, -2.0)}, (), 3, says=("reference seems to lie in another frame",)
    ),
}  # fmt: skip


@pytest.fixture
def located(tmp_path: Path, replayed: Any) -> Callable[..., tuple[Any, RobotTrack, np.ndarray]]:
    """A replay of the walk until its positions, the track, and the errors of its yaw."""

    def go(made: Made, *settings: str) -> tuple[Any, RobotTrack, np.ndarray]:
        anchors = ", ".join(f"{{ id = {i}, x_m = {x}, y_m = {y}, z_m = {z} }}" for i, (x, y, z) in enumerate(ANCHORS_M))
        write_recording(tmp_path / "walk.mcap", made.messages())
        flags = [word for each in settings for word in ("--set", each)]
        done = replayed(tmp_path / "walk.mcap", "--until", "position", *flags, config=CONFIG.format(anchors=anchors))
        robot = RobotTrack.read(done.run)
        _, yaw_rad = made.base((robot.t_ns - START_NS) * 1e-9)
        return done, robot, wrap_angle(robot.yaw_rad - yaw_rad)

    return go


@pytest.mark.parametrize("name", CASES)
def test_a_heading_is_right_and_known_as_well_as_it_says(name: str, located: Any) -> None:
    case = CASES[name]
    made = Made(**case.made)
    done, robot, error_rad = located(made, *case.settings)
    said = done.said + "\n".join(compare_with_own_reference(done.run).warnings)
    late = slice(int(case.late * len(error_rad)), None)
    assert np.degrees(np.abs(error_rad[late]).max()) < case.worst_deg
    deviations = np.sqrt(np.mean((error_rad / robot.yaw_std_rad)[late] ** 2))
    assert case.deviations[0] < deviations < case.deviations[1]
    assert all(words in said for words in case.says), said
    assert not any(words in said for words in case.never), said
    used = {each["role"] for each in done.record["topics"]} & {"imu", "odometry"}
    assert case.source is None or used == {case.source}
    if case.says == UNMOVED:
        assert (used, np.median(robot.yaw_std_rad) > np.radians(45)) == (set(), True)
    if case.says == ONLY:
        assert f"known to {np.degrees(np.median(robot.yaw_std_rad)):.1f} degrees" in said
    if name == "imu":
        off_m = robot.xy_m - made.base((robot.t_ns - START_NS) * 1e-9)[0]
        nees = np.einsum("ni,nij,nj->n", off_m, np.linalg.inv(robot.covariance_m2), off_m)
        assert 0.3 < nees.mean() < 4
        assert f"{10 * np.median(robot.yaw_std_rad):.2f} m at a distance of 10 m" in said
