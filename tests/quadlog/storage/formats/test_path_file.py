from __future__ import annotations

import pytest

from quadlog.errors import TooLarge, UnreadableFile
from quadlog.storage.formats import path_file
from quadlog.storage.formats.path_file import read_path


@pytest.fixture
def write(tmp_path):
    def write(text: str, name: str = "path.csv"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("path.csv", "# a path\n1, 2\n\n2.5,-3e0\r\n"),
        ("path.csv", "\ufefft_ns,y_m,x_m,source\n0,2,1,uwb\n1,-3,2.5,uwb\n"),
        ("path.tum", "0 1 2 0 0 0 0 1\n1.5 2.5 -3 9 0 0 0 1\n"),
        ("path.txt", "0 1 2 0 0 0 0 1\n1.5 2.5 -3 9 0 0 0 1\n"),
    ],
)
def test_columns_with_or_without_a_header_and_tum(write, name, text):
    assert read_path(write(text, name)).tolist() == [[1, 2], [2.5, -3]]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("0,0\n1\n", 2),
        ("0,0\n1,2,3\n", 2),
        ("0,0\n\n1,nan\n", 3),
        ("0,0\n1,inf\n", 2),
        ("x_m,y_m\n0,\n", 2),
        ("x,y\n0,0\n", 1),
        ("1,2,3\n", 1),
        ("0,0\n" + "1" * 20_000 + ",0\n", 2),
        ('0,0\n"1,0\n', 2),
    ],
)
def test_a_malformed_line_is_named(write, text, line):
    with pytest.raises(UnreadableFile) as caught:
        read_path(write(text))
    assert f", line {line}: " in str(caught.value)


def test_no_file_no_point_and_too_many_are_refused(write, tmp_path, monkeypatch):
    with pytest.raises(UnreadableFile, match="No such file"):
        read_path(tmp_path / "none.csv")
    with pytest.raises(UnreadableFile, match="no regular file"):
        read_path(tmp_path)
    with pytest.raises(UnreadableFile, match="no point"):
        read_path(write("x_m,y_m\n"))
    monkeypatch.setattr(path_file, "MAX_POINTS", 2)
    with pytest.raises(TooLarge):
        read_path(write("0,0\n1,1\n2,2\n"))
