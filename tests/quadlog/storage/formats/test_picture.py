from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra import numpy as stn
from PIL import Image

from quadlog.errors import QuadlogError, TooLarge, UnreadableFile
from quadlog.storage.formats import ros_map as picture
from quadlog.storage.formats.ros_map import GreyImage, read_picture

GREYS = np.array([[0, 10, 100], [200, 254, 255]], np.uint8)


def plain_pgm(greys: np.ndarray) -> bytes:
    rows = "\n".join(" ".join(map(str, row)) for row in greys.tolist())
    return f"P2\n# by hand\n{greys.shape[1]} {greys.shape[0]}\n255\n{rows}\n".encode()


def saved(image: Image.Image, kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


@given(greys=stn.arrays(np.uint8, stn.array_shapes(min_dims=2, max_dims=2, max_side=6)))
@settings(max_examples=30, deadline=None)
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
    "content",
    [saved(Image.fromarray(GREYS), "PPM"), plain_pgm(GREYS)]
    + [saved(Image.fromarray(GREYS).convert(mode), kind) for mode, kind in (("P", "PNG"), ("RGB", "BMP"))],
)
def test_a_damaged_picture_is_read_or_refused(tmp_path: Path, content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Above all nothing but a QuadlogError comes out; the formats themselves cannot tell every damage."""
    monkeypatch.setattr(picture, "_MAX_PIXELS", 10_000)
    path = tmp_path / "a"
    refused = 0
    # A colour table is long, and each of its entries like the next.
    places = [*range(min(len(content), 120)), *range(max(120, len(content) - 60), len(content))]
    for at in places:
        for byte in (None, 0x00, 0x01, 0x20, 0x39, 0x7F, 0xFF):
            path.write_bytes(content[:at] + (b"" if byte is None else bytes([byte]) + content[at + 1 :]))
            read = _answer(path)
            if isinstance(read, QuadlogError):
                assert str(path) in str(read)
                refused += 1
            else:
                assert read.sums.ndim == 2
                assert 0 < read.sums.size <= 10_000
    assert refused > 20


def _answer(path: Path) -> GreyImage | QuadlogError:
    try:
        return read_picture(path)
    except QuadlogError as error:
        return error


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
def test_what_is_wrong_with_a_picture_is_said(tmp_path: Path, content: bytes, match: str) -> None:
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
