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

from quadlog.errors import TooLarge, UnreadableFile
from quadlog.results.rosmap import read_rosmap, write_rosmap

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


def test_greys_between_the_thresholds_and_negated_maps(tmp_path: Path) -> None:
    (tmp_path / "m.pgm").write_bytes(b"P5 # made by hand\n# two comments\n4 1\n255\n" + bytes([0, 100, 205, 255]))
    text = "image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "m.yaml").write_text(text)
    assert read_rosmap(tmp_path / "m.yaml").cells.tolist() == [[100, -1, -1, 0]]
    (tmp_path / "m.yaml").write_text(text + "negate: 1\n")
    assert read_rosmap(tmp_path / "m.yaml").cells.tolist() == [[0, -1, 100, 100]]


def test_only_the_three_values_are_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="-1, 0 or 100"):
        write_rosmap(tmp_path, CELLS + 1, np.zeros(2), 0.1)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("image: map.pgm", "image: gone.pgm", r"gone\.pgm: No such file"),
        ("resolution: 0.1", "resolution: .nan", "impossible"),
        ("resolution: 0.1", "resolution: fine", "no map_server file: ValueError"),
        ("resolution: 0.1", "", "KeyError 'resolution'"),
        ("2.0, 0.0]", "2.0, 0.5]", "rotated"),
        ("mode: trinary", "mode: raw", "mode is raw"),
        ("image: map.pgm", "image: [unclosed", "is no YAML"),
        ("image: map.pgm", "image: !!python/object/apply:os.getcwd []", r"map\.yaml: is no YAML"),
        ("image: map.pgm", "image: map.yaml", r"map\.yaml: is no binary PGM"),
    ],
)
def test_a_wrong_description_is_refused(tmp_path: Path, old: str, new: str, match: str) -> None:
    write_rosmap(tmp_path, CELLS, np.array([-1.0, 2.0]), 0.1)
    text = (tmp_path / "map.yaml").read_text()
    assert old in text
    (tmp_path / "map.yaml").write_text(text.replace(old, new))
    with pytest.raises(UnreadableFile, match=match):
        read_rosmap(tmp_path / "map.yaml")


@pytest.mark.parametrize(
    ("pgm", "error"),
    [
        (b"P5\n3 2\n255\n12345", UnreadableFile),
        (b"P5\n0 0\n255\n", UnreadableFile),
        (b"P5\n3 2\n65535\n" + bytes(12), UnreadableFile),
        (b"P2\n1 1\n255\n0", UnreadableFile),
        (b"", UnreadableFile),
        (b"P5\n999999999 999999999\n255\n", TooLarge),
    ],
)
def test_a_wrong_picture_is_refused(tmp_path: Path, pgm: bytes, error: type) -> None:
    write_rosmap(tmp_path, CELLS, np.zeros(2), 0.1)
    (tmp_path / "map.pgm").write_bytes(pgm)
    with pytest.raises(error, match=r"map\.pgm"):
        read_rosmap(tmp_path / "map.yaml")


def test_a_huge_description_is_refused(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_bytes(b"#" * 100_000)
    with pytest.raises(UnreadableFile, match="too long"):
        read_rosmap(tmp_path / "map.yaml")
