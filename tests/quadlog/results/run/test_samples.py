from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadlog.errors import NotARun, TooLarge
from quadlog.results.run.maps import (
    CloudSample,
    DilutionGrid,
    GroundMap,
    read_cloud_samples,
    read_dilution,
    read_ground,
    write_cloud_samples,
    write_dilution,
    write_ground,
)
from quadlog.storage.npz import NpzReader

CLASSES = ["invalid", "cropped", "outlier", "ground", "obstacle"]


def sample(points: int, t_ns: int) -> CloudSample:
    rng = np.random.default_rng(t_ns)
    xyz_m = rng.normal(size=(points, 3)).astype(np.float32)
    xyz_m[:1] = np.nan
    return CloudSample(t_ns, xyz_m, rng.integers(0, 5, points).astype(np.uint8), 1.0, -2.0, 0.5)


@pytest.mark.parametrize("sizes", [[], [0], [3, 0, 5]])
def test_scans_come_back(tmp_path: Path, sizes: list[int]) -> None:
    written = [sample(points, t_ns) for t_ns, points in enumerate(sizes)]
    write_cloud_samples(tmp_path, written, CLASSES)
    back, classes = read_cloud_samples(tmp_path)
    assert classes == CLASSES
    assert len(back) == len(written)
    for one, other in zip(back, written, strict=True):
        assert (one.t_ns, one.x_m, one.y_m, one.yaw_rad) == (other.t_ns, 1.0, -2.0, 0.5)
        np.testing.assert_array_equal(one.xyz_m, other.xyz_m)
        np.testing.assert_array_equal(one.label, other.label)


def test_the_ground_comes_back(tmp_path: Path) -> None:
    height_m = np.array([[0.1, np.nan, 0.3], [np.nan, 0.0, -0.2]])
    write_ground(tmp_path, GroundMap(np.array([-1.0, 2.0]), 0.2, height_m, np.arange(6).reshape(2, 3)))
    back = read_ground(tmp_path)
    np.testing.assert_array_equal(back.height_m, height_m)
    np.testing.assert_array_equal(back.count, [[0, 1, 2], [3, 4, 5]])
    assert (back.origin_m.tolist(), back.cell_m) == ([-1.0, 2.0], 0.2)
    with pytest.raises(ValueError, match="differ in shape"):
        write_ground(tmp_path, GroundMap(np.zeros(2), 0.2, height_m, np.zeros((3, 2), np.int64)))


def test_missing_and_inconsistent_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NotARun, match=r"has no cloud_samples\.npz"):
        read_cloud_samples(tmp_path)
    write_cloud_samples(tmp_path, [sample(5, 1)], CLASSES)
    with np.load(tmp_path / "cloud_samples.npz") as npz:
        members = dict(npz)
    for name, value, match in [
        ("offset", np.array([0, 9]), "offset does not fit"),
        ("label", np.full(5, 7, np.uint8), "a label without a class"),
        ("x_m", np.zeros(2), "x_m is"),
    ]:
        np.savez(tmp_path / "cloud_samples.npz", **(members | {name: value}))
        with pytest.raises(NotARun, match=match):
            read_cloud_samples(tmp_path)
    (tmp_path / "ground.npz").write_bytes(b"not a zip")
    with pytest.raises(NotARun, match=r"ground\.npz: is damaged or no \.npz"):
        read_ground(tmp_path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "bomb.npz", x=np.zeros(50_000_000, np.uint8))
    assert (tmp_path / "bomb.npz").stat().st_size < 100_000
    with pytest.raises(TooLarge, match="bytes of x"):
        NpzReader(tmp_path / "bomb.npz").read("x", np.uint8, (None,), 1_000_000)


GRID = DilutionGrid(np.array([-3.0, 2.0]), 0.5, 0.6, np.array([[0.8, 1.0, np.inf], [0.9, 1.1, 4.0]]))


def test_a_map_comes_back(tmp_path: Path) -> None:
    write_dilution(tmp_path, GRID)
    back = read_dilution(tmp_path)
    np.testing.assert_array_equal(back.hdop, GRID.hdop)
    assert (back.origin_m.tolist(), back.cell_m, back.tag_height_m) == ([-3.0, 2.0], 0.5, 0.6)
    assert back.extent_m == (-3.0, -1.5, 2.0, 3.0)
    first = (tmp_path / "dilution.npz").read_bytes()
    write_dilution(tmp_path, GRID)
    assert (tmp_path / "dilution.npz").read_bytes() == first


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("cell_m", np.array(0.0), "without a place or a size"),
        ("origin_m", np.array([np.nan, 0.0]), "without a place or a size"),
        ("tag_height_m", np.array(np.inf), "without a place or a size"),
        ("hdop", np.zeros((0, 3)), "without a place or a size"),
        ("hdop", np.zeros(3), "hdop is"),
        ("hdop", np.array([[{}]], dtype=object), "hdop"),
    ],
)
def test_a_damaged_map_is_refused(tmp_path: Path, name: str, value: np.ndarray, match: str) -> None:
    write_dilution(tmp_path, GRID)
    with np.load(tmp_path / "dilution.npz") as npz:
        members = dict(npz)
    np.savez(tmp_path / "dilution.npz", **(members | {name: value}))
    with pytest.raises(NotARun, match=match):
        read_dilution(tmp_path)
