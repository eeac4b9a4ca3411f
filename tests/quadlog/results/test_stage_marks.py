from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import CannotWrite
from quadlog.results.stage_marks import (
    MARKS_FILE,
    FileMark,
    StageMark,
    files_are_whole,
    mark_files,
    read_marks,
    write_marks,
)

# As Python has them: any float, bytes of names that are no text, numbers beyond 64 bits.
TEXT = st.text(st.characters(exclude_categories=["Cs"]) | st.sampled_from(["\udc80", "\udcff"]), max_size=8)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=12,
)
MARK = st.builds(
    StageMark,
    stage=TEXT,
    key=TEXT,
    files=st.lists(
        st.builds(FileMark, name=TEXT, size_bytes=st.integers(0, 2**63), sha256=TEXT),
        max_size=3,
    ),
    known=st.dictionaries(TEXT, JSON, max_size=4),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("run")


def a_mark(run: Path) -> StageMark:
    return StageMark(stage="plan", key="k", files=mark_files(run, ["plans.parquet"]), known={"first_ns": 1})


@given(st.lists(MARK, max_size=4, unique_by=lambda mark: mark.stage))
def test_marks_come_back_as_they_were(folder: Path, marks: list[StageMark]) -> None:
    write_marks(folder, marks)
    found = read_marks(folder)
    assert list(found.values()) == marks
    assert [json.dumps(each.model_dump()) for each in found.values()] == [json.dumps(m.model_dump()) for m in marks]


def test_floats_that_are_no_numbers_come_back_too(tmp_path: Path) -> None:
    write_marks(tmp_path, [StageMark(stage="control", key="", files=[], known={"a": [math.nan, math.inf, -0.0]})])
    nan, inf, zero = read_marks(tmp_path)["control"].known["a"]
    assert math.isnan(nan)
    assert (inf, math.copysign(1, zero)) == (math.inf, -1)


@given(JSON)
def test_any_json_is_no_marks(folder: Path, content: object) -> None:
    (folder / MARKS_FILE).write_text(json.dumps(content))
    assert read_marks(folder) == {}
    for marks in ({"marks_format": 1, "stages": [content]}, {"marks_format": 2, "stages": []}):
        (folder / MARKS_FILE).write_text(json.dumps(marks))
        assert read_marks(folder) == {}


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_a_damaged_byte_is_another_mark_or_none_and_no_traceback(folder: Path, place: int, flip: int) -> None:
    (folder / "plans.parquet").write_bytes(b"plans")
    write_marks(folder, [a_mark(folder)])
    content = bytearray((folder / MARKS_FILE).read_bytes())
    content[place % len(content)] ^= flip
    (folder / MARKS_FILE).write_bytes(content)
    assert len(read_marks(folder)) <= 1


@pytest.mark.parametrize(
    "content",
    ["[" * 100_000, '{"marks_format": 1, "stages": [' + "9" * 5000 + "]}", " " * ((16 << 20) + 1), "NaN", "\xff", ""],
)
def test_what_would_swell_or_nest_without_end_is_no_marks(tmp_path: Path, content: str) -> None:
    (tmp_path / MARKS_FILE).write_text(content)
    assert read_marks(tmp_path) == {}


def test_files_are_whole_while_they_are_what_they_were(tmp_path: Path) -> None:
    (tmp_path / "plans.parquet").write_bytes(b"plans")
    mark = a_mark(tmp_path)
    assert files_are_whole(tmp_path, mark)
    (tmp_path / "paths.parquet").write_bytes(b"of somebody else")
    assert files_are_whole(tmp_path, mark)
    for other in (b"plant", b"plan", b"plans!", b""):
        (tmp_path / "plans.parquet").write_bytes(other)
        assert not files_are_whole(tmp_path, mark)
    (tmp_path / "plans.parquet").unlink()
    assert not files_are_whole(tmp_path, mark)
    with pytest.raises(CannotWrite, match=r"plans\.parquet: cannot be written: another process has removed it"):
        a_mark(tmp_path)


def test_a_link_or_a_folder_is_no_whole_file(tmp_path: Path) -> None:
    (tmp_path / "plans.parquet").write_bytes(b"plans")
    mark = a_mark(tmp_path)
    (tmp_path / "plans.parquet").rename(tmp_path / "elsewhere")
    (tmp_path / "plans.parquet").symlink_to(tmp_path / "elsewhere")
    assert not files_are_whole(tmp_path, mark)
    (tmp_path / "plans.parquet").unlink()
    (tmp_path / "plans.parquet").mkdir()
    assert not files_are_whole(tmp_path, mark)


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname", "notes.md", "", "plots/ranges.png"])
def test_a_mark_names_quadlogs_own_files_alone(tmp_path: Path, name: str) -> None:
    run = tmp_path / "run"
    run.mkdir()
    mark = StageMark(stage="plan", key="", files=[FileMark(name=name, size_bytes=0, sha256="")], known={})
    assert not files_are_whole(run, mark)
