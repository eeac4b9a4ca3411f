from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from quadlog.lidar.classified_scan import ClassifiedScan, GroundPlane, PointClass
from quadlog.lidar.scan_classifier import ScanClassifier
from quadlog.messages import PointCloud


@pytest.fixture(scope="session")
def ring_scan():
    """A 16-beam scan (N, 3) in a 16 m square room, and which points are (floor, wall, false): see `make_ring_scan`."""
    return make_ring_scan(n_azimuth=320, seed=0)


def make_ring_scan(n_azimuth: int, seed: int, height_m: float = 0.5, wall_m: float = 8.0):
    """Beams of -15..15 degrees over a flat floor between four walls, 2 cm noise, 1 % of the ranges false."""
    random = np.random.default_rng(seed)
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.linspace(-15, 15, 16)), np.linspace(-np.pi, np.pi, n_azimuth, endpoint=False)
    )
    beams = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    to_wall_m = (wall_m / np.maximum(np.abs(beams[:, :2]), 1e-9)).min(axis=1)
    to_floor_m = np.where(beams[:, 2] < 0, height_m / np.maximum(-beams[:, 2], 1e-9), np.inf)
    range_m = np.minimum(to_wall_m, to_floor_m) + random.normal(0, 0.02, len(beams))
    false = random.random(len(beams)) < 0.01
    range_m[false] = random.uniform(0.5, wall_m, false.sum())
    floor = (to_floor_m < to_wall_m) & ~false
    return beams * range_m[:, None], {"floor": floor, "wall": ~floor & ~false, "false": false}


@pytest.fixture(scope="session")
def real_scans():
    """name -> list of (N, 3) float32 of the two real 16-beam recordings."""
    root = os.environ.get("QUADLOG_DATASETS")
    if root is None:
        pytest.skip("QUADLOG_DATASETS is not set: no real recordings to test with")
    folder = Path(root) / "lidar_16beam"
    return {path.stem: read_clouds(path) for path in sorted(folder.glob("*.mcap"))}


def read_clouds(path: Path) -> list[np.ndarray]:
    """x, y, z of every PointCloud2 of an MCAP file, read with the mcap library and not with quadlog."""
    with path.open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        return [xyz_of(ros) for schema, _, _, ros in messages if schema and schema.name.endswith("PointCloud2")]


def xyz_of(cloud) -> np.ndarray:
    """The fields x, y, z of a decoded PointCloud2: (N, 3) float32."""
    offsets = [next(field.offset for field in cloud.fields if field.name == name) for name in "xyz"]
    points = np.dtype({"names": list("xyz"), "formats": ["<f4"] * 3, "offsets": offsets, "itemsize": cloud.point_step})
    rows = np.frombuffer(bytes(cloud.data), dtype=np.uint8).reshape(cloud.height, cloud.row_step)
    table = np.frombuffer(rows[:, : cloud.width * cloud.point_step].tobytes(), dtype=points)
    return np.stack([table["x"], table["y"], table["z"]], axis=-1)


class Labelled(NamedTuple):
    """A scan classified by itself: of every point (N,) of the message, NaN and INVALID where it is no return."""

    xyz_base_m: np.ndarray
    label: np.ndarray
    height_m: np.ndarray
    ground: GroundPlane | None
    route: str


@pytest.fixture(scope="session")
def classify():
    """A function that classifies points (N, 3) of the lidar's frame by a classifier of their own."""

    def made(xyz_m, ring, transform, settings, seed: int = 0, classifier: ScanClassifier | None = None) -> Labelled:
        cloud = PointCloud(None, "", np.asarray(xyz_m), ring)
        return labelled((classifier or ScanClassifier(settings, seed)).classify(cloud, transform), len(xyz_m))

    return made


def labelled(scan: ClassifiedScan, n: int) -> Labelled:
    """The scan in the order of its message."""
    points, numbers = scan.points(), np.sort(scan.returns.point[scan.returns.label != PointClass.INVALID])
    xyz_m, label, height_m = np.full((n, 3), np.nan, np.float32), np.zeros(n, np.uint8), np.full(n, np.nan, np.float32)
    xyz_m[numbers], label[numbers], height_m[numbers] = points.xyz_base_m, points.label, points.height_m
    return Labelled(xyz_m, label, height_m, scan.ground, scan.route)
