from __future__ import annotations

import gzip
import itertools
import os
import shutil

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from quadlog.errors import NotARecording, QuadlogError, RecordingNotFound
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
def test_what_is_no_recording_is_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    with pytest.raises(NotARecording, match=words) as caught:
        open_container(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_not_there_or_no_file_is_refused(tmp_path):
    with pytest.raises(RecordingNotFound):
        open_container(tmp_path / "none.mcap")
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(NotARecording, match="regular"):
        open_container(tmp_path / "pipe.mcap")


@pytest.fixture(scope="module")
def originals(tmp_path_factory, recordings):
    """One small file of each kind and how many messages it has."""
    folder = tmp_path_factory.mktemp("originals")
    messages = recordings.some(24)
    return [
        recordings.build("mcap", folder / "a.mcap", messages),
        recordings.build("mcap-loose", folder / "loose.mcap", messages, enable_data_crcs=True),
        *(recordings.build(form, folder / f"{form}.bag", messages) for form in ("bag", "bag-lz4", "bag-bz2")),
        recordings.build("db3", folder / "a.db3", messages),
    ]


damages = st.lists(st.tuples(st.floats(0, 0.999), st.integers(1, 255)), max_size=4)


@settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 5), flips=damages, keep=st.one_of(st.just(1.0), st.floats(0, 1)))
def test_damage_never_ends_in_anything_but_a_known_error(tmp_path_factory, originals, recordings, which, flips, keep):
    data = bytearray(originals[which].read_bytes())
    for place, bits in flips:
        data[int(place * len(data))] ^= bits
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / originals[which].name
    path.write_bytes(bytes(data[: int(keep * len(data))]))
    told = ""
    try:
        with open_container(path) as container:
            # Reading twice must neither fail nor report twice. A bound on what is read shows a loop without end.
            for _ in range(2):
                got = [recordings.read_one(each) for each in itertools.islice(container.messages(), 1000)]
            assert len(got) < 1000
            assert len(set(container.losses)) == len(container.losses)
            if which < 2 and len(got) < 24:
                assert container.losses
            if which < 2 and any(message not in recordings.some(24) for message in got):
                assert container.losses
    except QuadlogError as error:
        told = str(error)
    finally:
        assert [each.name for each in folder.iterdir()] == [path.name]
        shutil.rmtree(folder)
    assert "\n" not in told
