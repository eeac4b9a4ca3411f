from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from quadlog.lidar.classified_scan import GroundPlane, PointClass
from quadlog.lidar.scan_classifier import ScanClassifier
from quadlog.messages import PointCloud


@pytest.fixture(scope="session")
def room_scan():
    """A function that makes a scan of a square room without a ceiling by 16 beams, with 2 cm of noise.

    mount: of the lidar in base, whose floor is z = 0. Returns points, rings, and which are floor and which false.
    """

    def made(mount, wall_m=6.0, n_azimuth=900, half_view_deg=15.0, false_share=0.0):
        random = np.random.default_rng(0)
        azimuth, elevation = np.meshgrid(
            np.linspace(-np.pi, np.pi, n_azimuth, endpoint=False),
            np.deg2rad(np.linspace(-half_view_deg, half_view_deg, 16)),
            indexing="ij",
        )
        flat = np.cos(elevation)
        beams = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
        out, start = beams @ mount[:3, :3].T, mount[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            to_walls = ((wall_m - np.sign(out[:, :2]) * start[:2]) / np.abs(out[:, :2])).min(axis=1)
            to_floor = np.where(out[:, 2] < 0, -start[2] / out[:, 2], np.inf)
        range_m = np.minimum(to_walls, to_floor) + random.normal(0, 0.02, len(beams))
        false = random.random(len(beams)) < false_share
        range_m[false] = random.uniform(0.5, wall_m, false.sum())
        ring = np.tile(np.arange(16, dtype=np.uint16), n_azimuth)
        return (beams * range_m[:, None]).astype(np.float32), ring, (to_floor < to_walls) & ~false, false

    return made


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
        scan = (classifier or ScanClassifier(settings, seed)).classify(cloud, transform)
        found, invalid = scan.returns, scan.returns.label == PointClass.INVALID
        places_m, height_m = (np.where(invalid, np.nan, each.T).T for each in (scan.xyz_base_m, found.height_m))
        return Labelled(places_m, found.label, height_m, scan.ground, scan.route)

    return made
