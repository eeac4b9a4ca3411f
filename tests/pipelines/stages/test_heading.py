"""Headings of small recordings whose truth is known, through the stages that read and locate them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.geometry import interpolate_angle, quat_from_yaw, wrap_angle
from quadlog.messages import Imu, Odometry, Pose, UwbRanges
from quadlog.pipelines.evaluation.reference import compare_with_own_reference
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.log import open_log, read_log
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.stages.tracks import RobotTrack
from quadlog.results.record import read_record
from quadlog.simulation.synthetic.recording import SynthesizedMessage
from quadlog.simulation.synthetic.writer import WRITERS, write_recording

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
    silent_s: tuple[float, float] = (0.0, 0.0)
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
            yield SynthesizedMessage("/truth", t_ns, Pose(t_ns, "map", "base", place, quat_from_yaw(yaw[k])))

    def _imu(self) -> Iterator[SynthesizedMessage]:
        t_s = np.arange(round(DURATION_S * IMU_HZ)) / IMU_HZ
        t_s = t_s[(t_s < self.silent_s[0]) | (t_s >= self.silent_s[1])]
        _, yaw = self.base(t_s)
        rate = self.gyro_sign * np.gradient(yaw, t_s) + self.gyro_bias_radps + 0.01 * self.rng.standard_normal(len(t_s))
        if self.gyro_nan_at is not None:
            rate[self.gyro_nan_at] = np.nan
        quat = np.zeros((len(t_s), 4)) if self.imu_yaw is None else quat_from_yaw(self.imu_yaw(t_s, yaw))
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
            place, quat = np.array([*xy_m[k], 0.0]), quat_from_yaw(said[k])
            yield SynthesizedMessage(
                "/odom", t_ns, Odometry(t_ns, "odom", "base", place, quat, np.zeros(3), np.zeros(3))
            )


def turned_imu(t_s: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    return yaw - NORTH_RAD


def magnetised(t_s: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """A compass past iron: its north jumps by 60 degrees on the way."""
    return yaw + np.where(t_s < 13, 0.5, 1.5)


@contextmanager
def located(folder: Path, made: Made, *overrides: str) -> Iterator[SimpleNamespace]:
    """What a replay of the recording, once written, leaves of its positions."""
    anchors = ", ".join(f"{{ id = {i}, x_m = {x}, y_m = {y}, z_m = {z} }}" for i, (x, y, z) in enumerate(ANCHORS_M))
    (folder / "quadlog.toml").write_text(CONFIG.format(anchors=anchors))
    write_recording(WRITERS["mcap"](folder / "walk.mcap"), made.messages())
    config, options = load_config(folder / "quadlog.toml", list(overrides), {}), ReplayOptions(until="position")
    request = ReplayRequest(folder / "walk.mcap", folder / "run", config, options, draws=False, plots=False)
    replay(request, Silent())
    record = read_record(request.run)
    used = {each.role: (each.topic,) for each in record.topics}
    robot = RobotTrack.read(request.run)
    yield SimpleNamespace(robot=robot, notes=record.notes, warnings=record.warnings, used=used, run=request.run)


def yaw_error(walk: SimpleNamespace, made: Made) -> np.ndarray:
    _, yaw = made.base((walk.robot.t_ns - START_NS) * 1e-9)
    return wrap_angle(walk.robot.yaw_rad - yaw)


def note(walk: SimpleNamespace, start: str) -> str:
    return next(each for each in walk.notes if each.startswith(start))


def test_an_imu_is_turned_and_what_is_left_of_the_error_is_said_and_saved(tmp_path):
    made = Made(imu_yaw=turned_imu)
    with located(tmp_path, made) as walk:
        error, std = yaw_error(walk, made), walk.robot.yaw_std_rad
        assert np.abs(error).max() < np.radians(3)
        assert 0.15 < np.sqrt(np.mean((error / std) ** 2)) < 2  # measured 0.21
        words = note(walk, "heading from imu, turned by 11")
        assert f"+- {np.degrees(np.median(std)):.1f} degrees" in words
        assert f"{10 * np.median(std):.2f} m at a distance of 10 m" in words
        assert walk.used["imu"] == ("/imu",)
        poses, saved = (pq.read_table(tmp_path / "run" / f"{name}.parquet").to_pandas() for name in TABLES)
        np.testing.assert_array_equal(poses["t_ns"], saved["t_ns"])
        np.testing.assert_array_equal(saved["yaw_std_rad"], std)
        xy_m, _ = made.base((walk.robot.t_ns - START_NS) * 1e-9)
        off = walk.robot.xy_m - xy_m
        covariance = saved[["cov_xx_m2", "cov_xy_m2", "cov_xy_m2", "cov_yy_m2"]].to_numpy().reshape(-1, 2, 2)
        np.testing.assert_array_equal(covariance, walk.robot.covariance_m2)
        assert 0.3 < np.mean(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)) < 4
        assert not [each for each in walk.warnings if "frame" in each or "heading" in each]


TABLES = ("poses", "pose_uncertainty")


def test_an_imu_without_orientation_is_summed_up_and_its_bias_found(tmp_path):
    made = Made(gyro_bias_radps=0.02)
    with located(tmp_path, made) as walk:
        error = yaw_error(walk, made)
        assert np.abs(error).max() < np.radians(4)
        assert np.sqrt(np.mean((error / walk.robot.yaw_std_rad) ** 2)) < 2
        assert "its drift of -" in note(walk, "heading from imu")
        assert not [each for each in walk.notes if "upside down" in each]


def test_one_yaw_rate_that_is_no_number_costs_one_message(tmp_path):
    made = Made(gyro_nan_at=200)
    with located(tmp_path, made) as walk:
        assert np.abs(yaw_error(walk, made)).max() < np.radians(4)
        assert any("imu: 1 of 1000 messages" in each for each in walk.warnings)


@pytest.mark.parametrize("smooth", ["true", "false"])
def test_an_imu_upside_down_is_turned_over(tmp_path, smooth):
    made = Made(gyro_sign=-1.0)
    with located(tmp_path, made, f"uwb.smooth={smooth}") as walk:
        late = slice(3 * len(walk.robot.t_ns) // 4, None)
        assert np.abs(yaw_error(walk, made)[late]).max() < np.radians(10)
        assert any("upside down" in each for each in walk.notes) == (smooth == "true")


def test_an_orientation_that_never_changes_is_none_but_its_gyroscope_is_used(tmp_path):
    made = Made(imu_yaw=lambda t_s, yaw: np.zeros_like(yaw))
    with located(tmp_path, made) as walk:
        assert any("the same in every message" in each for each in walk.warnings)
        assert np.abs(yaw_error(walk, made)).max() < np.radians(4)


def test_silence_of_a_gyroscope_is_told(tmp_path):
    with located(tmp_path, Made(silent_s=(8.0, 11.0))) as walk:
        assert any("imu: silent for 3.0 s" in each for each in walk.warnings)


def test_the_better_of_two_sensors_is_taken_and_the_other_named(tmp_path):
    made = Made(imu_yaw=magnetised, odometry_yaw=turned_imu)
    with located(tmp_path, made) as walk:
        assert walk.used["odometry"] == ("/odom",)
        assert "imu" not in walk.used
        assert np.abs(yaw_error(walk, made)).max() < np.radians(4)
        assert "not from imu" in note(walk, "heading from odometry (std")
        assert any("odometry and imu contradict each other" in each for each in walk.warnings)


def test_two_sensors_that_agree_give_no_warning(tmp_path):
    with located(tmp_path, Made(imu_yaw=turned_imu, odometry_yaw=lambda t_s, yaw: yaw + 1.0)) as walk:
        assert "not from odometry" in note(walk, "heading from imu (")
        assert not [each for each in walk.warnings if "contradict" in each]


@pytest.mark.parametrize("smooth", ["true", "false"])
@pytest.mark.parametrize("with_orientation", [True, False])
def test_a_robot_that_never_moves_has_the_course_for_a_heading_and_is_told(tmp_path, smooth, with_orientation):
    made = Made(speed_mps=0.0, imu_yaw=(lambda t_s, yaw: 0.01 * t_s) if with_orientation else None)
    made.looks_away = lambda t_s: -2.0 * np.sin(2 * np.pi * t_s / DURATION_S)
    with located(tmp_path, made, f"uwb.smooth={smooth}", "uwb.range_std_m=0.1") as walk:
        said = [each for each in walk.warnings if "heading is the direction of travel" in each]
        assert len(said) == 1
        assert "the robot never moved for long enough while imu gave yaw" in said[0]
        assert "imu" not in walk.used
        assert np.median(walk.robot.yaw_std_rad) > np.radians(45)


@pytest.mark.parametrize("smooth", ["true", "false"])
def test_without_another_sensor_the_course_is_the_heading_and_its_std_is_said(tmp_path, smooth):
    made = Made(with_imu=False, speed_mps=1.5)
    with located(tmp_path, made, f"uwb.smooth={smooth}") as walk:
        said = next(
            each for each in walk.warnings if "no IMU and no odometry: heading is the direction of travel" in each
        )
        std_deg = np.degrees(np.median(walk.robot.yaw_std_rad))
        assert f"known to {std_deg:.1f} degrees, and wrong when the robot walks sideways or backwards" in said
        error = yaw_error(walk, made)[len(walk.robot.t_ns) // 4 :]
        std = walk.robot.yaw_std_rad[len(walk.robot.t_ns) // 4 :]
        assert 0.2 < np.sqrt(np.mean((error / std) ** 2)) < 1.6
        # A causal course is a quarter of a second late or more, in which walkers turn; a smoothed one is not.
        assert (std.min() > 0.125) == (smooth == "false")


def test_a_tag_beside_base_leaves_base_less_known_where_the_yaw_is_unknown(tmp_path):
    with located(tmp_path, Made(with_imu=False), "uwb.smooth=false") as walk:
        assert walk.robot.yaw_std_rad[0] == pytest.approx(np.pi / np.sqrt(3))
        lever_m2 = np.square(LEVER_M).sum() * np.pi**2 / 3
        assert np.trace(walk.robot.covariance_m2[0]) == pytest.approx(lever_m2, abs=0.1)


def test_steps_backwards_are_told_and_do_not_turn_the_heading(tmp_path):
    made = Made(imu_yaw=turned_imu, looks_away=lambda t_s: np.where(t_s > 15.0, np.pi, 0.0))
    with located(tmp_path, made) as walk:
        assert any("more than 60 degrees off its heading" in each for each in walk.warnings)
        at_once = np.abs((walk.robot.t_ns - START_NS) * 1e-9 - 15.0) < 0.1
        assert np.abs(yaw_error(walk, made)[~at_once]).max() < np.radians(6)


def test_a_causal_heading_comes_with_what_was_known_then(tmp_path):
    made = Made(imu_yaw=turned_imu)
    with located(tmp_path, made, "uwb.smooth=false") as walk:
        std = walk.robot.yaw_std_rad
        assert std[0] == pytest.approx(np.pi / np.sqrt(3))
        assert std[-1] < np.radians(5)
        assert np.abs(yaw_error(walk, made)[-1]) < 3 * std[-1]
        assert f"std at the end {np.degrees(std[-1]):.1f} degrees" in note(walk, "heading from imu, aligned to")


def test_a_reference_in_another_frame_is_told(tmp_path):
    with located(tmp_path, Made(imu_yaw=turned_imu, reference_shift_m=(1.0, -2.0))) as walk:
        warnings = compare_with_own_reference(walk.run).warnings
        said = next(each for each in warnings if "reference seems to lie in another frame" in each)
        assert "shifted by (" in said


def test_a_heading_between_the_imus_messages_is_that_of_the_imu(tmp_path):
    """The oracle is the sensor itself, turned: the stage adds one number to it."""
    made = Made(imu_yaw=turned_imu)
    with located(tmp_path, made) as walk:
        with open_log(tmp_path / "walk.mcap", Config(), ReplayOptions()) as log:
            imu = read_log(log, Silent()).streams.imu
        z, w = imu.quat_xyzw[:, 2], imu.quat_xyzw[:, 3]
        sensor = interpolate_angle(walk.robot.t_ns, imu.t_ns, 2 * np.arctan2(z, w))
        added = wrap_angle(walk.robot.yaw_rad - sensor)
        # What drift it found, it found as a line.
        left = added - np.polyval(np.polyfit(np.arange(len(added)), added, 1), np.arange(len(added)))
        np.testing.assert_allclose(left, 0, atol=1e-3)
