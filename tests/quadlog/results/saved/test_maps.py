from __future__ import annotations

import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import NotARun, TooLarge
from quadlog.results.arrays import (
    CloudSample,
    DilutionGrid,
    GroundMap,
    MapsWriter,
    load_maps,
    read_cloud_samples,
    read_dilution,
    read_ground,
    write_cloud_samples,
    write_dilution,
    write_ground,
)
from quadlog.results.saved import maps


def write(path: Path, count: int, shape: tuple[int, int], seed: int = 0) -> np.ndarray[Any, Any]:
    occupied = np.random.default_rng(seed).random((count, *shape)) < 0.3
    with MapsWriter(path, 0.1, shape) as writer:
        for t in range(count):
            writer.append(t * 10, np.array([t / 10, -1.0]), occupied[t])
    return occupied


@given(count=st.integers(0, 12), rows=st.integers(1, 20), columns=st.integers(1, 20), block=st.integers(1, 200))
def test_any_sequence_comes_back(
    tmp_path_factory: pytest.TempPathFactory, count: int, rows: int, columns: int, block: int
) -> None:
    run = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(maps, "_BLOCK_BYTES", block)
        occupied = write(run / "maps.npz", count, (rows, columns))
        back = load_maps(run)
        assert (len(back), back.shape, back.cell_m) == (count, (rows, columns), 0.1)
        np.testing.assert_array_equal(back.t_ns, np.arange(count) * 10)
        np.testing.assert_array_equal(back.origin_m, [[t / 10, -1.0] for t in range(count)] or np.empty((0, 2)))
        for i in np.random.default_rng(0).permutation(count):
            np.testing.assert_array_equal(back.occupied(i), occupied[i])
        for i, (t_ns, origin_m, cells) in enumerate(back):
            assert (t_ns, origin_m[0], cells.dtype) == (i * 10, i / 10, np.bool_)
            np.testing.assert_array_equal(cells, occupied[i])


def test_numpy_alone_reads_it_and_the_same_maps_have_the_same_bytes(tmp_path: Path) -> None:
    occupied = write(tmp_path / "maps.npz", 5, (7, 11))
    with np.load(tmp_path / "maps.npz", allow_pickle=False) as npz:
        assert set(npz) == {"t_ns", "origin_m", "cell_m", "shape", "occupied_bits_000000"}
        bits = npz["occupied_bits_000000"]
        np.testing.assert_array_equal(np.unpackbits(bits, axis=-1, count=npz["shape"][1]), occupied)
    for wrong in (-1, 5):
        with pytest.raises(IndexError):
            load_maps(tmp_path).occupied(wrong)
    write(tmp_path / "again", 5, (7, 11))
    assert (tmp_path / "maps.npz").read_bytes() == (tmp_path / "again").read_bytes()
    with zipfile.ZipFile(tmp_path / "again") as archive:
        assert {member.date_time[0] for member in archive.infolist()} == {1980}


def test_memory_does_not_grow_with_the_sequence(tmp_path: Path) -> None:
    occupied = np.random.default_rng(0).random((200, 200)) < 0.02

    def peak(count: int) -> int:
        tracemalloc.start()
        with MapsWriter(tmp_path / "maps.npz", 0.1, (200, 200)) as writer:
            for t in range(count):
                writer.append(t, np.zeros(2), occupied)
        for one in load_maps(tmp_path):
            assert one.occupied.sum() == occupied.sum()
        try:
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(10)
    assert peak(900) < 1.2 * peak(300)  # 300 maps are 1.5 MB, and a block about 1 MB


def test_an_error_in_the_middle_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with MapsWriter(tmp_path / "maps.npz", 0.1, (4, 4)) as writer:
            writer.append(0, np.zeros(2), np.zeros((4, 4), bool))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [each.name for each in tmp_path.iterdir()] == []


def test_a_map_of_another_shape_or_type_is_refused(tmp_path: Path) -> None:
    for wrong in (np.zeros((4, 5), bool), np.zeros((4, 4))):
        with pytest.raises(ValueError, match="a map is bool"), MapsWriter(tmp_path / "m", 0.1, (4, 4)) as writer:
            writer.append(0, np.zeros(2), wrong)


@given(place=st.integers(0, 10_000), flip=st.integers(1, 255), end=st.integers(0, 10_000))
def test_a_damaged_file_is_refused_or_right(
    tmp_path_factory: pytest.TempPathFactory, place: int, flip: int, end: int
) -> None:
    run = tmp_path_factory.mktemp("run")
    occupied = write(run / "maps.npz", 5, (20, 20))
    content = bytearray((run / "maps.npz").read_bytes())
    content[place % len(content)] ^= flip
    for damaged in (content, content[: end % len(content)]):
        (run / "maps.npz").write_bytes(damaged)
        try:
            back = np.array([cells for _, _, cells in load_maps(run)])
        except (NotARun, TooLarge) as error:
            assert "maps.npz" in str(error)  # noqa: PT017 - either outcome is right
        else:
            np.testing.assert_array_equal(back, occupied)


def save(path: Path, **changed: Any) -> None:
    members: dict[str, Any] = {"t_ns": np.zeros(2, np.int64), "origin_m": np.zeros((2, 2)), "cell_m": np.array(0.1)}
    members |= {"shape": np.array([4, 4]), "occupied_bits_000000": np.zeros((2, 4, 1), np.uint8)}
    np.savez_compressed(path, **{name: value for name, value in (members | changed).items() if value is not None})


@pytest.mark.parametrize(
    ("changed", "error", "match"),
    [
        ({"t_ns": None}, NotARun, "has no t_ns"),
        ({"t_ns": np.zeros(2)}, NotARun, "t_ns is float64"),
        ({"t_ns": np.array([None, None])}, NotARun, "t_ns"),  # a pickle, never opened
        ({"origin_m": np.zeros((3, 2))}, NotARun, "origin_m is"),
        ({"origin_m": np.full((2, 2), np.nan)}, NotARun, "without a place"),
        ({"cell_m": np.array(0.0)}, NotARun, "without a place"),
        ({"shape": np.array([4, 1 << 40])}, TooLarge, "cells on a side"),
        ({"shape": np.array([0, 4])}, TooLarge, "cells on a side"),
        ({"occupied_bits_000000": np.zeros((2, 4, 2), np.uint8)}, NotARun, "occupied_bits_000000 is"),
        ({"occupied_bits_000000": np.zeros(100_000_000, np.uint8)}, TooLarge, "100000128"),
    ],
)
def test_a_foreign_or_hostile_file_is_refused(tmp_path: Path, changed: Any, error: type, match: str) -> None:
    save(tmp_path / "maps.npz", **changed)
    with pytest.raises(error, match=match):
        load_maps(tmp_path).occupied(0)


def test_the_package_itself_imports_nothing_heavy() -> None:
    script = "import quadlog.results, sys; print([m for m in ('numpy', 'pyarrow', 'matplotlib') if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
    with pytest.raises(AttributeError, match="no attribute 'load_map'"):
        __import__("quadlog.results").results.load_map  # noqa: B018


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


GRID = DilutionGrid(np.array([-3.0, 2.0]), 0.5, 0.6, np.array([[0.8, 1.0, np.inf], [0.9, 1.1, 4.0]]))


def test_a_map_comes_back(tmp_path: Path) -> None:
    write_dilution(tmp_path, GRID)
    back = read_dilution(tmp_path)
    np.testing.assert_array_equal(back.hdop, GRID.hdop)
    assert (back.origin_m.tolist(), back.cell_m, back.tag_height_m) == ([-3.0, 2.0], 0.5, 0.6)
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
