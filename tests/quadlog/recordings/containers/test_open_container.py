from __future__ import annotations

import gzip
import os

import pytest

from quadlog.errors import NotARecording, RecordingNotFound
from quadlog.recordings.containers.open import open_container


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"hello", "unknown file format"),
        (gzip.compress(b"x", mtime=0), "gunzip"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (b"#ROSBAG V1.2\n", "rosbag fix"),
        (b"SQLite format 3\0", "SQLite"),
        (b"\x28\xb5\x2f\xfdnonsense", "decompress"),
    ],
)
def test_other_formats_are_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    with pytest.raises(NotARecording, match=words) as caught:
        open_container(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_pipes_are_refused(tmp_path):
    with pytest.raises(RecordingNotFound):
        open_container(tmp_path / "none.mcap")
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(NotARecording, match="regular"):
        open_container(tmp_path / "pipe.mcap")
