"""A complete, tiny run folder: four seconds of a robot that follows a person along a quarter circle."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap_protobuf.decoder import DecoderFactory

from quadlog.config.schema import Config
from quadlog.recordings.containers.container import Loss
from quadlog.results.arrays import MapsWriter, write_arrays
from quadlog.results.foxglove import write_foxglove
from quadlog.results.record import InputRecord, RunRecord, StageRecord, TopicRecord
from quadlog.results.run import create_run, finish_run, write_result
from quadlog.results.tables import TABLES, write_table
from quadlog.storage.formats.ros_map import write_rosmap
from quadlog.storage.formats.tum import write_tum

START_NS = 1_700_000_000_123_456_789
CONFIG: dict[str, Any] = {"uwb": {"tag_height_m": 0.6, "anchors": [{"id": 0, "x_m": 0.0, "y_m": 5.0}]}}
CONFIG |= {"planner": {"name": "ia_star"}}
CLOUD = "sensor_msgs/msg/PointCloud2"
ANCHORS_M = np.array([[0.0, 5.0], [6.0, 5.0], [3.0, -5.0]])

BROWSER_FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-dev-shm-usage", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--enable-logging=stderr"),
]


@pytest.fixture
def browse(tmp_path: Path) -> Callable[..., tuple[str, list[str]]]:
    """Opens a page with more flags; gives the DOM and the console's lines."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    chromium = next((found for name in names if (found := shutil.which(name))), None)
    if chromium is None:
        pytest.skip("no Chromium is installed, so the report is not tried in a browser")

    def open_page(page: Path, *flags: str) -> tuple[str, list[str]]:
        command = [chromium, *BROWSER_FLAGS, f"--user-data-dir={tmp_path / 'profile'}", *flags, page.resolve().as_uri()]
        quiet = {**os.environ, "HOME": str(tmp_path)}
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True, env=quiet)
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return open_page


@pytest.fixture(scope="session")
def tiny_record() -> RunRecord:
    """The record of `tiny_run`."""
    return RunRecord(
        quadlog_version="0.1.0",
        command=["quadlog", "replay", "walk.mcap"],
        config=Config.model_validate(CONFIG),
        options={"seed": 0, "stamp": "header", "until": "report"},
        input=InputRecord(path="walk.mcap", size_bytes=1234, sha256="ab" * 32),
        seed=0,
        recorded_s=4.0,
        topics=[TopicRecord(role="lidar", topic="/points", messages=40, why="the only point cloud", type=CLOUD)],
        counts={"scans": 40, "scans_without_pose": 0},
        losses=[Loss("crc", "one chunk is damaged, from 1.0 s to 1.5 s", "/points", 5)],
        warnings=["no heading source: yaw is the course"],
        stages=[
            StageRecord(name="ingest", seconds=0.5, peak_memory_mb=120.0),
            StageRecord(name="position", seconds=0.3, peak_memory_mb=130.0),
        ],
        realtime_factor=4.0 / 0.8,
    )


@pytest.fixture(scope="session")
def write_run(tiny_record: RunRecord) -> Callable[[Path], Path]:
    """Writes the tiny run into a folder, the same bytes every time."""

    def write(path: Path) -> Path:
        path.mkdir(parents=True, exist_ok=True)
        run = create_run(path, tiny_record)
        t_ns = START_NS + np.arange(40, dtype=np.int64) * 100_000_000
        yaw_rad = np.linspace(0, np.pi / 2, 40)
        robot_m = 3 * np.column_stack([np.sin(yaw_rad), 1 - np.cos(yaw_rad)])
        _write_positions(path, t_ns, robot_m, yaw_rad)
        _write_uwb_quality(path, t_ns)
        _write_scans(path, t_ns, robot_m)
        _write_plans(path, t_ns, robot_m)
        _write_control(path, t_ns, robot_m, yaw_rad)
        eta_m, fallen = {"value": np.float64(0.123), "n": 200, "unit": "m"}, {"value": 0, "n": 1, "unit": ""}
        none = {"value": float("nan"), "n": 0, "unit": "m"}
        write_result(run, "metrics", {"eta_m": eta_m, "fallen": fallen, "ate_rmse_m": none})
        write_foxglove(run)
        finish_run(run, tiny_record)
        return path

    return write


@pytest.fixture(scope="session")
def tiny_original(write_run: Callable[[Path], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny run, written once; not to be changed."""
    return write_run(tmp_path_factory.mktemp("original") / "walk")


@pytest.fixture(scope="session")
def derived(tiny_original: Path) -> dict[str, list[tuple[int, Any]]]:
    """(log time, decoded message) by topic of the tiny run's `derived.mcap`, every chunk's checksum verified."""
    return decode_mcap(tiny_original / "derived.mcap")


def decode_mcap(path: Path) -> dict[str, list[tuple[int, Any]]]:
    found: dict[str, list[tuple[int, Any]]] = {}
    decode = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, message in SeekingReader(file, validate_crcs=True).iter_messages():
            assert message.publish_time == message.log_time
            is_json = (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
            decoder = json.loads if is_json else decode.decoder_for(channel.message_encoding, schema)
            assert decoder is not None
            found.setdefault(channel.topic, []).append((message.log_time, decoder(message.data)))
    return found


@pytest.fixture
def tiny_run(tiny_original: Path, tmp_path: Path) -> Path:
    """A complete run folder of the test's own."""
    return shutil.copytree(tiny_original, tmp_path / "walk")


def _table(path: Path, name: str, **columns: Any) -> None:
    """A table in which columns that are not given are 0, no text, or without values."""
    kinds = {"int64": 0, "bool": False, "string": ""}
    rows = max(np.size(of) for of in columns.values())
    rest = {of.name: kinds.get(str(of.type), np.nan) for of in TABLES[name]}
    full = {key: np.broadcast_to(of, rows) for key, of in (rest | columns).items()}
    write_table(path / f"{name}.parquet", TABLES[name], full)


def _write_positions(path: Path, t_ns: Any, robot_m: Any, yaw_rad: Any) -> None:
    rng = np.random.default_rng(1)
    fix_m = robot_m + rng.normal(0, 0.05, robot_m.shape)
    x_m = np.repeat(fix_m[:, 0], 2) + np.tile([0, 2.0], 40)
    x_m[7] = np.nan  # an epoch without a fix
    spread = {"cov_xx_m2": 0.01, "cov_xy_m2": 0.0, "cov_yy_m2": 0.01}
    fixes: dict[str, Any] = {"t_ns": np.repeat(t_ns, 2), "tag": np.tile([0, 1], 40), "x_m": x_m, "z_m": 0.6} | spread
    fixes |= {"y_m": np.repeat(fix_m[:, 1], 2), "n_ranges": 3, "residual_rms_m": 0.05}
    _table(path, "fixes", **fixes, outlier=np.arange(80) % 20 == 3)
    true_m = np.linalg.norm(robot_m[:, None] - ANCHORS_M, axis=2).ravel()
    ranges = {"range_m": true_m + rng.normal(0, 0.1, 120), "predicted_m": true_m, "weight": 1.0}
    _table(path, "ranges", t_ns=np.repeat(t_ns, 3), anchor=np.tile([0, 1, 2], 40), **ranges)
    _table(path, "poses", t_ns=t_ns, x_m=robot_m[:, 0], y_m=robot_m[:, 1], yaw_rad=yaw_rad, source="uwb")
    _table(path, "pose_uncertainty", t_ns=t_ns, **spread, yaw_std_rad=0.02)
    _table(path, "target", t_ns=t_ns, x_m=robot_m[:, 0] + 2, y_m=robot_m[:, 1], source="uwb")
    write_tum(path / "trajectory.tum", t_ns, robot_m[:, 0], robot_m[:, 1], yaw_rad)


def _write_uwb_quality(path: Path, t_ns: Any) -> None:
    """Two tags' links to three anchors, one bias of which is held back; the robot's errors; a plain bowl of HDOP."""
    applied = np.array([True, True, True, False, True, True])
    links: dict[str, Any] = {"tag": np.repeat([0, 1], 3), "anchor": np.tile([0, 1, 2], 2), "n": 40}
    links |= {"x_m": np.tile(ANCHORS_M[:, 0], 2), "y_m": np.tile(ANCHORS_M[:, 1], 2), "z_m": 1.2}
    links |= {"residual_rms_m": 0.1, "residual_median_m": -0.0004, "bias_m": np.linspace(-0.1, 0.4, 6)}
    links |= {"bias_std_m": np.where(applied, 0.02, 0.09), "bias_applied": applied, "nlos_share": 0.025}
    _table(path, "links", **links, why_not=np.where(applied, "", "known to 0.09 m only"))
    both_ns = np.tile(t_ns, 2)
    _table(path, "innovations", t_ns=both_ns, n_ranges=4, nis=1.0)
    errors = {"error_x_m": 0.03, "error_y_m": np.tile([0.04, 0.4], 40), "bound_m": 0.2}
    _table(path, "uwb_errors", t_ns=both_ns, source=np.repeat(["fixes", "track"], 40), **errors)


def _write_scans(path: Path, t_ns: Any, robot_m: Any) -> None:
    rng = np.random.default_rng(2)
    counts = {"n_raw": 5000, "n_valid": 4800, "n_outlier": 100, "n_ground": 3000, "n_obstacle": 1700}
    _table(path, "scans", t_ns=t_ns, **counts, ground_nz=1.0, ground_found=True, ms=12.5)
    with MapsWriter(path / "maps.npz", 0.1, (60, 50)) as maps:
        for t, xy in zip(t_ns, robot_m, strict=True):
            maps.append(t, np.floor(xy * 10) / 10 - 2.5, rng.random((60, 50)) < 0.1)
    cells = rng.choice(np.array([-1, 0, 100], np.int8), (60, 50))
    write_rosmap(path, cells, np.array([-2.5, -2.5]), 0.1)
    cloud = rng.normal(0, 3, (300, 3)).astype(np.float32)
    label = rng.integers(0, 5, 300).astype(np.uint8)
    scans: dict[str, Any] = {"t_ns": t_ns[[0, 0]], "offset": [0, 300, 600], "xyz_m": np.tile(cloud, (2, 1))}
    scans |= {"label": np.tile(label, 2), "x_m": [0, 0], "y_m": [0, 0], "yaw_rad": [0, 0]}
    write_arrays(path, "cloud_samples", scans | {"classes": ["invalid", "cropped", "outlier", "ground", "obstacle"]})
    height_m = np.where(rng.random((20, 30)) < 0.5, np.nan, 0.01)
    ground = {"origin_m": [-1, -2], "cell_m": 0.2, "height_m": height_m, "count": np.isfinite(height_m)}
    write_arrays(path, "ground", ground)


def _write_plans(path: Path, t_ns: Any, robot_m: Any) -> None:
    line, number = np.linspace(0, 2, 10), np.arange(40)
    _table(path, "astar", t_ns=t_ns, expanded=number + 30)
    plans: dict[str, Any] = {"t_ns": t_ns, "planner": "ia_star", "found": number != 5, "expanded": number + 20}
    plans |= {"generated": number + 60, "cost": np.where(number != 5, 200.0, np.nan), "length_m": 2.0, "us": 40.0}
    plans |= {"from_scratch": number % 10 == 0, "start_x_m": robot_m[:, 0], "start_y_m": robot_m[:, 1]}
    plans |= {"goal_x_m": robot_m[:, 0] + 2, "goal_y_m": robot_m[:, 1]}
    paths: dict[str, Any] = {"t_ns": np.repeat(t_ns, 10), "i": np.tile(np.arange(10), 40)}
    paths |= {"x_m": (robot_m[:, :1] + line).ravel(), "y_m": np.repeat(robot_m[:, 1], 10)}
    smooth_m = np.where(paths["i"] < 8, paths["x_m"], np.nan)  # a smooth path of fewer points
    for prefix in ("", "resim_"):
        _table(path, f"{prefix}plans", **plans)
        _table(path, f"{prefix}paths", **paths, smooth_x_m=smooth_m, smooth_y_m=paths["y_m"])


def _write_control(path: Path, t_ns: Any, robot_m: Any, yaw_rad: Any) -> None:
    tick_ns = START_NS + np.arange(200, dtype=np.int64) * 20_000_000
    x_m, y_m, yaw_rad = (np.interp(tick_ns - START_NS, t_ns - START_NS, of) for of in (*robot_m.T, yaw_rad))
    error_m = 0.1 * np.abs(np.sin(np.arange(200) / 20))
    control: dict[str, Any] = {"t_ns": tick_ns, "x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad, "ref_x_m": x_m}
    control |= {"vx_mps": 0.6, "vy_mps": 0.0, "yaw_rate_radps": 0.2, "ref_y_m": y_m + error_m}
    control |= {"error_m": error_m, "cross_track_m": -error_m, "time_error_m": 2 * error_m, "heading_error_rad": 0.0}
    _table(path, "control", **control, lookahead_m=2.0, cmd_v_mps=0.6, cmd_yaw_rate_radps=0.2)
    contacts = {"t_ns": tick_ns[[40, 90]], "duration_s": [0.1, 0.42], "x_m": [1.05, 2.15], "y_m": 0.35}
    causes = ["appeared inside the body", "cut_corner"]  # the words are those of a run of an earlier version
    _table(path, "contacts", **contacts, clearance_m=[-0.05, -0.031], cause=causes, collision=[False, True])
    _table(path, "clearances", t_ns=tick_ns, clearance_m=np.where(error_m < 0.09, np.inf, 0.5), target_distance_m=2.0)
