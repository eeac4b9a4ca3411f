from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadlog.errors import NotARun, TooLarge
from quadlog.results.run.maps import DilutionGrid, read_dilution, write_dilution

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


def test_a_map_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(NotARun, match=r"has no dilution\.npz"):
        read_dilution(tmp_path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    write_dilution(tmp_path, GRID)
    with np.load(tmp_path / "dilution.npz") as npz:
        members = dict(npz)
    np.savez_compressed(tmp_path / "dilution.npz", **(members | {"hdop": np.zeros((2000, 2000))}))
    with pytest.raises(TooLarge, match="bytes of hdop"):
        read_dilution(tmp_path)
