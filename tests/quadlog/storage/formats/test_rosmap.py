from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as stn
from PIL import Image

from quadlog.storage.formats.ros_map import read_rosmap, write_rosmap

CELLS = np.array([[0, 100, -1], [100, 100, 0]], np.int8)  # the first row is the lowest y


@settings(max_examples=40, deadline=None)
@given(
    cells=stn.arrays(np.int8, stn.array_shapes(min_dims=2, max_dims=2), elements=st.sampled_from([-1, 0, 100])),
    x_m=st.floats(-1e4, 1e4),
    cell_m=st.floats(1e-3, 10),
)
def test_any_map_comes_back(
    tmp_path_factory: pytest.TempPathFactory, cells: np.ndarray, x_m: float, cell_m: float
) -> None:
    folder = tmp_path_factory.mktemp("run")
    write_rosmap(folder, cells, np.array([x_m, -x_m]), cell_m)
    back = read_rosmap(folder / "map.yaml")
    np.testing.assert_array_equal(back.cells, cells)
    assert (back.origin_m.tolist(), back.cell_m) == ([x_m, -x_m], cell_m)


def test_other_libraries_see_the_map_upright(tmp_path: Path) -> None:
    write_rosmap(tmp_path, CELLS, np.array([-1.0, 2.0]), 0.05)
    top_first = [[0, 0, 254], [254, 0, 205]]
    with Image.open(tmp_path / "map.pgm") as image:
        assert np.asarray(image).tolist() == top_first
    assert matplotlib.image.imread(tmp_path / "map.pgm").tolist() == top_first
    about = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert about == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [-1.0, 2.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


def as_map_server_reads(folder: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """The occupancy grid by the rules of nav2's map_server in trinary mode, cell by cell, row 0 being the lowest."""
    about = yaml.safe_load((folder / "map.yaml").read_text())
    with Image.open(folder / about["image"]) as image:
        assert image.mode == "L"
        width, height = image.size
        data = np.full((height, width), 111, np.int8)
        for x in range(width):
            for y in range(height):
                shade = image.getpixel((x, y)) / 255
                occupied = shade if about["negate"] else 1 - shade
                if occupied > about["occupied_thresh"]:
                    value = 100
                elif occupied < about["free_thresh"]:
                    value = 0
                else:
                    value = -1
                data[height - 1 - y, x] = value
    return data, about


@settings(max_examples=25, deadline=None)
@given(cells=stn.arrays(np.int8, stn.array_shapes(min_dims=2, max_dims=2), elements=st.sampled_from([-1, 0, 100])))
def test_map_server_makes_the_same_grid_of_it(tmp_path_factory: pytest.TempPathFactory, cells: np.ndarray) -> None:
    folder = tmp_path_factory.mktemp("run")
    write_rosmap(folder, cells, np.array([-1.25, 2.5]), 0.05)
    np.testing.assert_array_equal(as_map_server_reads(folder)[0], cells)


def test_a_place_in_map_is_the_cell_that_was_meant(tmp_path: Path) -> None:
    """A post at (-0.93, 2.18) m, looked up as costmap_2d's worldToMap does: whole cells from the lower-left corner."""
    cells = np.zeros((6, 4), np.int8)
    cells[3, 1] = 100
    write_rosmap(tmp_path, cells, np.array([-1.0, 2.0]), 0.05)
    data, about = as_map_server_reads(tmp_path)
    x_m, y_m, yaw_rad = about["origin"]
    assert yaw_rad == 0
    assert about["mode"] == "trinary"
    column, row = (int((place - low) / about["resolution"]) for place, low in ((-0.93, x_m), (2.18, y_m)))
    assert np.argwhere(data == 100).tolist() == [[row, column]]


def test_only_the_three_values_are_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="-1, 0 or 100"):
        write_rosmap(tmp_path, CELLS + 1, np.zeros(2), 0.1)
    assert not list(tmp_path.iterdir())
