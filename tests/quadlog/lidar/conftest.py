from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from quadlog.lidar.classified_scan import GroundPlane, PointClass
from quadlog.lidar.scan_classifier import ScanClassifier
from quadlog.messages import PointCloud


@pytest.fixture(scope="session")
def room_scan():
    """A function that makes a scan of a square room without a ceiling by 16 beams, with 2 cm of noise.

    mount: of the lidar in base, whose floor is z = 0. Returns points, rings, and which are floor and which false.
    """

    def made(mount, wall_m=6.0, n_azimuth=900, half_view_deg=15.0, false_share=0.0):
        random, azimuth = np.random.default_rng(0), np.linspace(-np.pi, np.pi, n_azimuth, endpoint=False)
        elevation = np.deg2rad(np.linspace(-half_view_deg, half_view_deg, 16))
        azimuth, elevation = (each.ravel() for each in np.meshgrid(azimuth, elevation, indexing="ij"))
        flat = np.cos(elevation)
        beams = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
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


class Labelled(NamedTuple):
    """A scan classified by itself: of every point (N,) of the message, NaN and INVALID where it is no return."""

    xyz_base_m: np.ndarray
    label: np.ndarray
    height_m: np.ndarray
    ground: GroundPlane | None
    route: str

    @property
    def counts(self) -> list[int]:
        """Invalid, cropped, outliers, ground and obstacles."""
        return np.bincount(self.label, minlength=len(PointClass)).tolist()


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
