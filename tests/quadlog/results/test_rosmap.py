from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as stn
from PIL import Image

from quadlog.map_files.ros_map import read_rosmap
from quadlog.results.rosmap import write_rosmap

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


def test_only_the_three_values_are_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="-1, 0 or 100"):
        write_rosmap(tmp_path, CELLS + 1, np.zeros(2), 0.1)
    assert not list(tmp_path.iterdir())
