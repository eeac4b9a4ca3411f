"""Saved scenery for pictures and terrains: `cloud_samples.npz` and `ground.npz`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import NotARun
from quadlog.messages import Float
from quadlog.results.npz import NpzReader, write_npz

_MAX_BYTES = 1 << 30
_MAX_SAMPLES = 1000


@dataclass(frozen=True, slots=True)
class CloudSample:
    """One scan: xyz_m (N, 3) float32 in base, label (N,) uint8, the robot's pose in map (NaN where unknown)."""

    t_ns: int
    xyz_m: NDArray[np.float32]
    label: NDArray[np.uint8]
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class GroundMap:
    """Heights of the ground: origin_m (2,) lower-left corner in map, row = y, column = x.

    height_m (rows, columns) float64, NaN where no ground was seen; count (rows, columns) int64 points.
    """

    origin_m: Float
    cell_m: float
    height_m: Float
    count: NDArray[np.int64]


def write_cloud_samples(run: Path, samples: Iterable[CloudSample], classes: Sequence[str]) -> None:
    """`cloud_samples.npz`: the scans one after the other, scan k being rows offset[k] to offset[k + 1].

    `classes[label]` is what a label means; it is saved too, so that the file explains itself.
    """
    kept = list(samples)
    with write_npz(run / "cloud_samples.npz") as npz:
        npz.add("t_ns", np.array([sample.t_ns for sample in kept], np.int64))
        npz.add("offset", np.cumsum([0, *(len(sample.xyz_m) for sample in kept)], dtype=np.int64))
        npz.add("xyz_m", np.concatenate([np.empty((0, 3), np.float32), *(s.xyz_m for s in kept)], dtype=np.float32))
        npz.add("label", np.concatenate([np.empty(0, np.uint8), *(s.label for s in kept)], dtype=np.uint8))
        for name in ("x_m", "y_m", "yaw_rad"):
            npz.add(name, np.array([getattr(sample, name) for sample in kept], np.float64))
        npz.add("classes", np.array(list(classes), "U16"))


def read_cloud_samples(run: Path) -> tuple[list[CloudSample], list[str]]:
    """The scans of `cloud_samples.npz` and the name of each label. Raises NotARun, TooLarge."""
    npz = NpzReader(run / "cloud_samples.npz")
    t_ns = npz.read("t_ns", np.int64, (None,), 8 * _MAX_SAMPLES + 4096)
    offset = npz.read("offset", np.int64, (len(t_ns) + 1,), 8 * _MAX_SAMPLES + 4096)
    xyz_m = npz.read("xyz_m", np.float32, (None, 3), _MAX_BYTES)
    label = npz.read("label", np.uint8, (len(xyz_m),), _MAX_BYTES)
    classes = npz.read("classes", "U16", (None,), 1 << 20).tolist()
    pose = {name: _column(npz, name, len(t_ns)) for name in ("x_m", "y_m", "yaw_rad")}
    if offset[0] != 0 or offset[-1] != len(xyz_m) or (np.diff(offset) < 0).any():
        raise NotARun(npz.path, "is damaged: offset does not fit xyz_m")
    if len(label) and label.max() >= len(classes):
        raise NotARun(npz.path, "is damaged: a label without a class")
    scans = [slice(first, last) for first, last in pairwise(offset.tolist())]
    samples = [
        CloudSample(int(t_ns[k]), xyz_m[rows], label[rows], *(float(column[k]) for column in pose.values()))
        for k, rows in enumerate(scans)
    ]
    return samples, classes


def write_ground(run: Path, ground: GroundMap) -> None:
    """`ground.npz`: `origin_m (2,)`, `cell_m`, `height_m` and `count`, both (rows, columns)."""
    if ground.height_m.shape != ground.count.shape:
        raise ValueError(f"height_m {ground.height_m.shape} and count {ground.count.shape} differ in shape")
    with write_npz(run / "ground.npz") as npz:
        npz.add("origin_m", np.asarray(ground.origin_m, np.float64))
        npz.add("cell_m", np.array(ground.cell_m, np.float64))
        npz.add("height_m", np.asarray(ground.height_m, np.float64))
        npz.add("count", np.asarray(ground.count, np.int64))


def read_ground(run: Path) -> GroundMap:
    """The ground's height map of a run folder. Raises NotARun, TooLarge."""
    npz = NpzReader(run / "ground.npz")
    height_m = npz.read("height_m", np.float64, (None, None), _MAX_BYTES)
    count = npz.read("count", np.int64, height_m.shape, _MAX_BYTES)
    origin_m = npz.read("origin_m", np.float64, (2,), 4096)
    cell_m = float(npz.read("cell_m", np.float64, (), 4096))
    if not (np.isfinite(origin_m).all() and np.isfinite(cell_m) and cell_m > 0):
        raise NotARun(npz.path, "is damaged: a ground without a place or a size")
    return GroundMap(origin_m, cell_m, height_m, count)


def _column(npz: NpzReader, name: str, length: int) -> NDArray[Any]:
    return npz.read(name, np.float64, (length,), 8 * _MAX_SAMPLES + 4096)
