"""Maps of map_server and their pictures, against Pillow and nav2's rules."""

from __future__ import annotations

import io
import struct
import zlib
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as stn
from PIL import Image

from quadlog.errors import TooLarge, UnreadableFile
from quadlog.storage.formats.ros_map import read_picture, read_rosmap, write_rosmap

ABOUT = """\
image: map.pgm
mode: trinary
resolution: 0.1
origin: [-1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
PGM = b"P5\n3 2\n255\n" + bytes([0, 0, 254, 254, 0, 205])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "map.pgm").write_bytes(PGM)
    (tmp_path / "map.yaml").write_text(ABOUT)
    return tmp_path


def describe(folder: Path, **changes: object) -> Path:
    """map.yaml with these keys changed."""
    lines = [line for line in ABOUT.splitlines() if line.split(":")[0] not in changes]
    (folder / "map.yaml").write_text("\n".join([*lines, *(f"{key}: {value}" for key, value in changes.items())]))
    return folder / "map.yaml"


def as_nav2_does(pixel: tuple[int, ...], mode: str, negate: bool, occupied: float, free: float) -> int:
    """One pixel (red, green, blue, alpha), by the rules of nav2_map_server's map_io."""
    average = sum(pixel[:3]) / 3
    if mode == "raw":
        return round(average) if round(average) <= 100 else -1
    occupancy = (average if negate else 255 - average) / 255
    if pixel[3] < 255:
        return -1
    if occupancy > occupied:
        return 100
    if occupancy < free:
        return 0
    return round((occupancy - free) / (occupied - free) * 100) if mode == "Scale" else -1


@given(
    pixels=stn.arrays(np.uint8, st.tuples(st.integers(1, 5), st.integers(1, 5), st.just(4))),
    opaque=st.booleans(),
    kind=st.sampled_from([("L", "pgm"), *product(("1", "L", "P", "RGB", "RGBA"), ("png", "bmp")), ("LA", "png")]),
    mode=st.sampled_from(["trinary", "Scale", "raw"]),
    negate=st.booleans(),
    thresholds=st.sampled_from([(0.65, 0.196), (0.65, 0.25), (0.9, 0.1)]),
)
def test_every_mode_reads_a_picture_as_nav2_does(tmp_path_factory, pixels, opaque, kind, mode, negate, thresholds):
    folder, name = tmp_path_factory.mktemp("map"), f"map.{kind[1]}"
    pixels[..., 3] |= 255 * opaque
    Image.fromarray(pixels).convert(kind[0]).save(folder / name)
    limits = {"occupied_thresh": thresholds[0], "free_thresh": thresholds[1]}
    path = describe(folder, image=name, mode=mode, negate=int(negate), **limits)
    with Image.open(folder / name) as saved:
        colours = np.asarray(saved.convert("RGBA"))[::-1].tolist()
    expected = [[as_nav2_does(pixel, mode, negate, *thresholds) for pixel in row] for row in colours]
    ros_map = read_rosmap(path)
    assert ros_map.cells.tolist() == expected
    assert ros_map.blocked.tolist() == [[value == 100 for value in row] for row in expected]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        *(
            ("map.pgm", each, "map|gone|regular|damaged")
            for each in ("gone.pgm", ".", "/dev/zero", '"a\\0b"', "map.yaml")
        ),
        *(("0.1", value, "resolution") for value in (".nan", "nan", "1e-300", "inf", "-1", "1" + "0" * 400, "")),
        *(
            ("-1.0, 2.0, 0.0", value, "origin|rotated")
            for value in ("1e300, 2.0, 0.0", "nan, 2.0, 0.0", "-1.0, 2.0, nan", "-1.0, 2.0", "-1.0, 2.0, 0.5")
        ),
        ("mode: trinary", "mode: fine", "mode is 'fine'.*'raw', 'scale' or 'trinary'"),
        ("mode: trinary", "mode: [raw]", "mode"),
        ("mode: trinary", "mode: " + "a" * 50_000, "mode"),
        ("occupied_thresh: 0.65", "occupied_thresh: 0.1", "thresholds"),
        ("occupied_thresh: 0.65", "occupied_thresh: nan", "thresh"),
        ("image: map.pgm", "image: [unclosed", "line 2"),
        ("image: map.pgm", "image: !!python/object/apply:os.getcwd []", "line 1"),
        ("negate: 0", "negate: maybe", "negate"),
        (ABOUT, "- just a list\n", "mapping"),
    ],
)
def test_a_wrong_description_is_refused(folder: Path, old: str, new: str, words: str) -> None:
    assert old in ABOUT
    (folder / "map.yaml").write_text(ABOUT.replace(old, new, 1))
    with pytest.raises(UnreadableFile, match=words) as caught:
        read_rosmap(folder / "map.yaml")
    assert len(str(caught.value)) < 500


CELLS = np.array([[0, 100, -1], [100, 100, 0]], np.int8)  # the first row is the lowest y


@given(
    cells=stn.arrays(np.int8, stn.array_shapes(min_dims=2, max_dims=2), elements=st.sampled_from([-1, 0, 100])),
    x_m=st.floats(-1e4, 1e4),
    cell_m=st.floats(1e-3, 10),
)
def test_any_map_comes_back(tmp_path_factory, cells, x_m, cell_m):
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
    about = yaml.safe_load((tmp_path / "map.yaml").read_text())
    expected = {"image": "map.pgm", "mode": "trinary", "resolution": 0.05, "origin": [-1.0, 2.0, 0.0], "negate": 0}
    assert about == expected | {"occupied_thresh": 0.65, "free_thresh": 0.196}


GREYS = np.array([[0, 10, 100], [200, 254, 255]], np.uint8)


def saved(image: Image.Image, kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n3 2\n255\n12345",
        b"P5\n0 0\n255\n",
        b"P5\n3 2\n65535\n" + bytes(12),
        saved(Image.fromarray(GREYS.astype(np.uint16)), "PNG"),
        b"P2\n2 1\n255\n0 256",
        saved(Image.fromarray(GREYS), "GIF"),
        b"P6\n1 1\n255\n123",
        b"",
    ],
)
def test_damaged_pictures_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(UnreadableFile, match=r"a\.png"):
        read_picture(tmp_path / "a.png")


BMP = saved(Image.fromarray(GREYS), "BMP")


def _png_of_size(cols: int, rows: int) -> bytes:
    """A picture that claims to be so large; its checksum is right, and there is next to nothing in it."""
    content = saved(Image.fromarray(GREYS), "PNG")
    chunk = b"IHDR" + struct.pack(">II", cols, rows) + content[24:29]
    return content[:12] + chunk + struct.pack(">I", zlib.crc32(chunk)) + content[33:]


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n8193 8192\n255\n",
        b"P2\n8193 8192\n255\n1",
        _png_of_size(8193, 8192),
        _png_of_size(2**31 - 1, 2**31 - 1),
        BMP[:18] + struct.pack("<ii", 2**30, 2**30) + BMP[26:],
    ],
)
def test_a_huge_picture_is_refused_before_it_is_decoded(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a"
    path.write_bytes(content + bytes(2000))
    with pytest.raises(TooLarge, match=rf"a: pixels: \d+ exceeds the limit of {2**26}"):
        read_picture(path)
