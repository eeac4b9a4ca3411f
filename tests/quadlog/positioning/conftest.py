"""Walks, ranges and the real trolley recording that several positioning tests share."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, TagResult, locate
from quadlog.recordings.recording import open_recording
from quadlog.recordings.streams import gather

TRIANGLE_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [4.0, 7.0, 1.2]])
SQUARE_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [8.0, 7.0, 1.2], [0.0, 7.0, 1.2]])
TAG_HEIGHT_M = 0.6


@dataclass(frozen=True)
class Simulated:
    """A walk with known truth and the ranges along it; range_m (T, A) is what `series` holds row by row."""

    t_ns: Int
    position_m: Float
    range_m: Float
    series: RangeSeries

    def truth_at(self, t_ns: Int) -> Float:
        return np.stack([np.interp(t_ns, self.t_ns, self.position_m[:, i]) for i in range(2)], axis=1)


def true_ranges(position_m: Float, anchors_m: Float, height_m: float = TAG_HEIGHT_M) -> Float:
    xyz_m = np.column_stack([position_m, np.full(len(position_m), height_m)])
    return np.linalg.norm(xyz_m[:, None, :] - anchors_m[None, :, :], axis=2)


def rmse(error_m: Float) -> float:
    return float(np.sqrt((error_m**2).sum(axis=1).mean()))


def share_in_ellipses(error_m: Float, covariance_m2: Float) -> float:
    """Share of errors (N, 2) within the 95 % ellipses of (N, 2, 2)."""
    squared = np.einsum("ei,eij,ej->e", error_m, np.linalg.inv(covariance_m2), error_m)
    return float(np.mean(squared < 5.991))


def walk_straight(t_s: Float) -> Float:
    """0.5 m/s past the middle of the anchors."""
    return np.array([4.0, 3.0]) + np.array([0.4, 0.3]) * (t_s - t_s.mean())[:, None]


def walk_figure_eight(t_s: Float) -> Float:
    """About 0.5 m/s, all over the place."""
    phase = 2 * np.pi * t_s / 30
    return np.array([4.0, 3.5]) + np.stack([2.5 * np.sin(phase), 1.8 * np.sin(2 * phase)], axis=1)


def simulate(
    walk, anchors_m: Float, seed: int, *, duration_s=12, rate_hz=50, std_m=0.1, bias_m=0.0, bursts=False, place_m=0.0
) -> Simulated:
    """Gaussian ranges; bursts: every anchor spends a tenth of the 0.6 s slots behind something, late by Exp(0.5 m).

    place_m: rms of errors that depend on the place, as those of reflections do.
    """
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    position_m = walk(t_s)
    range_m = true_ranges(position_m, anchors_m) + bias_m + std_m * rng.standard_normal((len(t_s), len(anchors_m)))
    slot = round(0.6 * rate_hz)
    if bursts:
        for begin in range(0, len(t_s), slot):
            late = (rng.random(len(anchors_m)) < 0.1) * rng.exponential(0.5, len(anchors_m))
            range_m[begin : begin + slot] += late
    t_ns = 1_700_000_000_000_000_000 + np.rint(t_s * 1e9).astype(np.int64)
    n, a = range_m.shape
    waves, phase = rng.normal(0, 1.2, (a, 20, 2)), rng.uniform(0, 6.3, (a, 20, 1))
    range_m += place_m * np.sqrt(2 / 20) * np.cos(waves @ position_m.T + phase).sum(axis=1).T
    series = RangeSeries(
        np.repeat(t_ns, a), np.zeros(n * a, dtype=np.int64), np.tile(np.arange(a), n), range_m.reshape(-1).copy()
    )
    return Simulated(t_ns, position_m, range_m, series)


def locate_tag(series: RangeSeries, anchors_m: Float, *tag, height_m: float = TAG_HEIGHT_M, **settings) -> TagResult:
    """Tag 0; tag: odometry of what carries it, and where it sits there."""
    anchors = Anchors(np.arange(len(anchors_m)), np.asarray(anchors_m), np.zeros(len(anchors_m)))
    return locate(series, anchors, [TagInfo(0, height_m, *tag)], LocateSettings(**settings)).tags[0]


@dataclass(frozen=True)
class Trolley:
    """uwb_lias: three tags on a trolley among eight anchors, and where motion capture saw the trolley."""

    series: RangeSeries
    anchors_m: Float
    lever_m: Float
    t_ns: Int
    position_m: Float
    rotation: Rotation

    def truth_at(self, tag: int, t_ns: Int) -> Float:
        place_m = self.position_m + self.rotation.apply(self.lever_m[tag])
        return np.stack([np.interp(t_ns - self.t_ns[0], self.t_ns - self.t_ns[0], place_m[:, i]) for i in range(2)], 1)


@pytest.fixture(scope="session")
def trolley(lias_site: SimpleNamespace) -> Trolley:
    with open_recording(lias_site.folder / "lias_fast.mcap") as recording:
        series = gather(recording, uwb=["/nlink_linktrack_tagframe0"]).ranges
    truth = np.loadtxt(lias_site.folder / "lias_fast_mocap.tum")
    t_ns, rotation = np.rint(truth[:, 0] * 1e9).astype(np.int64), Rotation.from_quat(truth[:, 4:8])
    return Trolley(series, lias_site.anchors_m, lias_site.levers_m, t_ns, truth[:, 1:4], rotation)


@pytest.fixture(scope="session")
def lab() -> ModuleType:
    """This file."""
    return sys.modules[__name__]
