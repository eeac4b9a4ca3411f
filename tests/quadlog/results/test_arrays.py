from __future__ import annotations

import tracemalloc
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import NotARun, TooLarge
from quadlog.results import arrays
from quadlog.results.arrays import MapsWriter, load_maps, read_arrays, write_arrays


def write(path: Path, count: int, shape: tuple[int, int], seed: int = 0) -> np.ndarray[Any, Any]:
    occupied = np.random.default_rng(seed).random((count, *shape)) < 0.3
    with MapsWriter(path, 0.1, shape) as writer:
        for t in range(count):
            writer.append(t * 10, np.array([t / 10, -1.0]), occupied[t])
    return occupied


@given(count=st.integers(0, 12), rows=st.integers(1, 20), columns=st.integers(1, 20), block=st.integers(1, 200))
def test_any_sequence_of_maps_comes_back(
    tmp_path_factory: pytest.TempPathFactory, count: int, rows: int, columns: int, block: int
) -> None:
    run = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arrays, "_BLOCK_BYTES", block)
        occupied = write(run / "maps.npz", count, (rows, columns))
        back = load_maps(run)
        assert (len(back), back.shape, back.cell_m) == (count, (rows, columns), 0.1)
        for i, (t_ns, origin_m, cells) in enumerate(back):
            assert (t_ns, *origin_m, cells.dtype) == (i * 10, i / 10, -1.0, np.bool_)
        for i in np.random.default_rng(0).permutation(count):
            np.testing.assert_array_equal(back.occupied(i), occupied[i])
        for wrong in (-1, count):
            with pytest.raises(IndexError):
                back.occupied(wrong)


def test_numpy_alone_reads_maps_and_the_same_maps_have_the_same_bytes(tmp_path: Path) -> None:
    occupied = write(tmp_path / "maps.npz", 5, (7, 11))
    with np.load(tmp_path / "maps.npz", allow_pickle=False) as npz:
        assert set(npz) == {"t_ns", "origin_m", "cell_m", "shape", "occupied_bits_000000"}
        bits = npz["occupied_bits_000000"]
        np.testing.assert_array_equal(np.unpackbits(bits, axis=-1, count=npz["shape"][1]), occupied)
    write(tmp_path / "again", 5, (7, 11))
    assert (tmp_path / "maps.npz").read_bytes() == (tmp_path / "again").read_bytes()


def test_memory_does_not_grow_with_the_sequence(tmp_path: Path) -> None:
    occupied = np.random.default_rng(0).random((200, 200)) < 0.02

    def peak(count: int) -> int:
        tracemalloc.start()
        with MapsWriter(tmp_path / "maps.npz", 0.1, (200, 200)) as writer:
            for t in range(count):
                writer.append(t, np.zeros(2), occupied)
        for one in load_maps(tmp_path):
            assert one.occupied.any()
        try:
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(10)
    assert peak(900) < 1.2 * peak(300)  # 300 maps are 1.5 MB, and a block about 1 MB


def test_an_error_in_the_middle_or_a_wrong_map_leaves_nothing(tmp_path: Path) -> None:
    for wrong in (np.zeros((4, 5), bool), np.zeros((4, 4))):
        with pytest.raises(ValueError, match="a map is bool"), MapsWriter(tmp_path / "m", 0.1, (4, 4)) as writer:
            list(map(partial(writer.append, 0, np.zeros(2)), (np.zeros((4, 4), bool), wrong)))
    with pytest.raises(ValueError, match=r"count .* does not fit"):
        write_arrays(tmp_path, "ground", SOUND["ground"] | {"count": [[1], [2]]})
    assert [each.name for each in tmp_path.iterdir()] == []


MAPS: dict[str, Any] = {
    "t_ns": np.zeros(2, np.int64),
    "origin_m": np.zeros((2, 2)),
    "cell_m": np.array(0.1),
    "shape": np.array([4, 4]),
    "occupied_bits_000000": np.zeros((2, 4, 1), np.uint8),
}


@pytest.mark.parametrize(
    ("changed", "error", "match"),
    [
        ({"t_ns": None}, NotARun, "has no t_ns"),
        ({"t_ns": np.zeros(2)}, NotARun, "t_ns is float64"),
        ({"origin_m": np.zeros((3, 2))}, (NotARun, TooLarge), "origin_m"),
        ({"shape": np.array([4, 1 << 40])}, TooLarge, "cells on a side"),
        ({"occupied_bits_000000": np.zeros((2, 4, 2), np.uint8)}, NotARun, "occupied_bits_000000 is"),
        ({"occupied_bits_000000": np.zeros(100_000_000, np.uint8)}, TooLarge, "100000128"),
    ],
)
def test_foreign_or_hostile_maps_are_refused(tmp_path: Path, changed: Any, error: Any, match: str) -> None:
    members = {name: value for name, value in (MAPS | changed).items() if value is not None}
    np.savez_compressed(tmp_path / "maps.npz", **members)
    with pytest.raises(error, match=match):
        load_maps(tmp_path).occupied(0)


CELLS: dict[str, Any] = {"origin_m": [-1.0, 2.0], "cell_m": 0.2}
SOUND: dict[str, dict[str, Any]] = {
    "ground": CELLS | {"height_m": [[0.1, np.nan, 0.3]], "count": [[0, 1, 2]]},
    "cloud_samples": {"t_ns": [1, 2], "offset": [0, 0, 2], "xyz_m": [[np.nan] * 3, [1, 2, 3]], "label": [1, 0]}
    | {"x_m": [1.0, np.nan], "y_m": [0.0, 1.0], "yaw_rad": [0.5, 0.5], "classes": ["ground", "obstacle"]},
}


@pytest.mark.parametrize("name", SOUND)
def test_arrays_come_back_and_the_same_have_the_same_bytes(tmp_path: Path, name: str) -> None:
    write_arrays(tmp_path, name, SOUND[name])
    first = (tmp_path / f"{name}.npz").read_bytes()
    back = read_arrays(tmp_path, name)
    assert back.keys() == SOUND[name].keys()
    for key, value in SOUND[name].items():
        np.testing.assert_array_equal(back[key], value)
    write_arrays(tmp_path, name, back)
    assert (tmp_path / f"{name}.npz").read_bytes() == first


@pytest.mark.parametrize(
    ("name", "changed", "match"),
    [
        ("ground", {"cell_m": np.array(0.0)}, "without a place or a size"),
        ("ground", {"origin_m": np.array([0.0, np.nan])}, "without a place or a size"),
        ("ground", {"height_m": np.array([[{}]], dtype=object)}, "height_m"),
        ("cloud_samples", {"offset": np.array([0, 3, 2])}, "offset does not fit"),
        ("cloud_samples", {"label": np.full(2, 7, np.uint8)}, "a label without a class"),
        ("cloud_samples", None, ""),
    ],
)
def test_arrays_that_contradict_each_other_are_damage(tmp_path: Path, name: str, changed: Any, match: str) -> None:
    path = tmp_path / f"{name}.npz"
    with pytest.raises(NotARun, match=rf"has no {name}\.npz"):
        read_arrays(tmp_path, name)
    write_arrays(tmp_path, name, SOUND[name])
    if changed is None:
        path.write_bytes(b"not a zip")
    else:
        np.savez(path, **(read_arrays(tmp_path, name) | changed))
    with pytest.raises(NotARun, match=rf"{name}\.npz: is damaged: .*{match}"):
        read_arrays(tmp_path, name)
