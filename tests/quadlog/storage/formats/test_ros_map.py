"""Maps of map_server and their pictures, against Pillow and nav2's rules."""

from __future__ import annotations

import io
import struct
import zlib
from itertools import product
from pathlib import Path

import matplotlib.image
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
def test_every_mode_reads_a_picture_as_nav2_does(
    tmp_path_factory: pytest.TempPathFactory,
    pixels: np.ndarray,
    opaque: bool,
    kind: tuple[str, str],
    mode: str,
    negate: bool,
    thresholds: tuple[float, float],
) -> None:
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


def test_thresholds_may_coincide(folder: Path) -> None:
    (folder / "map.pgm").write_bytes(b"P5\n3 1\n255\n" + bytes([203, 204, 205]))  # 204 is exactly 0.2
    for mode in ("trinary", "scale"):
        path = describe(folder, mode=mode, occupied_thresh=0.2, free_thresh=0.2)
        assert read_rosmap(path).cells.tolist() == [[100, -1, 0]]


def test_optional_keys_and_an_absolute_picture_path(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "m.pgm"
    elsewhere.write_bytes(PGM)
    lines = ABOUT.replace("image: map.pgm", f"image: {elsewhere}").splitlines()
    kept = [line for line in lines if not line.startswith(("mode", "negate"))]
    (folder / "map.yaml").write_text("\n".join(kept))
    assert read_rosmap(folder / "map.yaml").cells.tolist() == [[0, 100, -1], [100, 100, 0]]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("image: map.pgm", "image: gone.pgm", r"gone\.pgm: No such file"),
        ("image: map.pgm", "image: .", r"is no regular file"),
        ("image: map.pgm", "image: /dev/zero", r"/dev/zero: is no regular file"),
        ("image: map.pgm", 'image: "a\\0b"', r"is damaged"),
        ("resolution: 0.1", "resolution: .nan", "no map_server file: resolution is no number: '.nan'"),
        *(
            ("resolution: 0.1", f"resolution: {value}", "resolution is .* it must be between 0.001 and 1000")
            for value in ("1e-300", "inf", "-1", "1" + "0" * 400)
        ),
        ("[-1.0, ", "[1e300, ", "origin must be"),
        ("resolution: 0.1", "", "resolution is no text"),
        ("2.0, 0.0]", "2.0, 0.5]", "rotated"),
        ("2.0, 0.0]", "2.0]", "origin must be"),
        ("mode: trinary", "mode: fine", "mode is 'fine'; choose one of: raw, scale, trinary"),
        ("occupied_thresh: 0.65", "occupied_thresh: 0.1", "thresholds are not"),
        ("image: map.pgm", "image: [unclosed", r"map\.yaml, line 2: no map_server file: is no YAML"),
        ("image: map.pgm", "image: !!python/object/apply:os.getcwd []", r"map\.yaml, line 1: .* has the tag"),
        ("negate: 0", "negate: maybe", "negate is 'maybe'; choose one of"),
        ("mode: trinary", "mode: " + "a" * 50_000, "mode is 'a{50}... "),
        ("image: map.pgm", "image: map.yaml", r"map\.yaml: is no PGM, PNG or BMP"),
        (ABOUT, "- just a list\n", "the document is no mapping"),
    ],
)
def test_a_wrong_description_is_refused(folder: Path, old: str, new: str, match: str) -> None:
    assert old in ABOUT
    (folder / "map.yaml").write_text(ABOUT.replace(old, new))
    with pytest.raises(UnreadableFile, match=match):
        read_rosmap(folder / "map.yaml")


def test_a_huge_description_is_refused(folder: Path) -> None:
    (folder / "map.yaml").write_bytes(b"#" * 100_000)
    with pytest.raises(UnreadableFile, match="too long"):
        read_rosmap(folder / "map.yaml")


CELLS = np.array([[0, 100, -1], [100, 100, 0]], np.int8)  # the first row is the lowest y


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


GREYS = np.array([[0, 10, 100], [200, 254, 255]], np.uint8)


def plain_pgm(greys: np.ndarray) -> bytes:
    rows = "\n".join(" ".join(map(str, row)) for row in greys.tolist())
    return f"P2\n# by hand\n{greys.shape[1]} {greys.shape[0]}\n255\n{rows}\n".encode()


def saved(image: Image.Image, kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


@given(greys=stn.arrays(np.uint8, stn.array_shapes(min_dims=2, max_dims=2, max_side=6)))
def test_a_pgm_in_plain_text_is_read(tmp_path_factory: pytest.TempPathFactory, greys: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("picture") / "a.pgm"
    path.write_bytes(plain_pgm(greys))
    assert read_picture(path).sums.tolist() == greys.tolist()


def test_a_colour_may_be_declared_transparent(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(saved(Image.fromarray(GREYS), "PNG", transparency=100))
    read = read_picture(path)
    assert read.opaque is not None
    assert read.opaque.tolist() == [[True, True, False], [True, True, True]]
    assert (read.sums // 3).tolist() == GREYS.tolist()


def test_fewer_greys_are_stretched_to_all(tmp_path: Path) -> None:
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P5\n3 1\n2\n\x00\x01\x02")
    assert read_picture(path).sums.tolist() == [[0, 128, 255]]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"P5\n3 2\n255\n12345", "is damaged"),
        (b"P5\n0 0\n255\n", "is damaged"),
        (b"P5\n3 2\n65535\n" + bytes(12), "more than 8 bits"),
        (saved(Image.fromarray(GREYS.astype(np.uint16)), "PNG"), "more than 8 bits"),
        (b"P2\n2 1\n255\n0", "is damaged"),
        (b"P2\n2 1\n255\n0 256", "is damaged"),
        (saved(Image.fromarray(GREYS), "GIF"), "is no PGM, PNG or BMP"),
        (b"P6\n1 1\n255\n123", "is no PGM, PNG or BMP"),
        (b"", "is no PGM, PNG or BMP"),
    ],
)
def test_damaged_pictures_are_refused_with_a_reason(tmp_path: Path, content: bytes, match: str) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(UnreadableFile, match=rf"a\.png: .*{match}"):
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
