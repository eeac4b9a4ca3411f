from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.find_runs import run_name, run_names


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("walk 2024.05", "walk 2024.05"),
        ("..", "recording"),
        ("../../etc/passwd", "_.._etc_passwd"),
        (".hidden", "hidden"),
        ("-rf", "rf"),
        ("a\nb\x00c", "a_b_c"),
        ("C:\\x", "C__x"),
        ("", "recording"),
        ("report.html", "report.html_"),
        ("é" * 200, "é" * 60),
    ],
)
def test_a_name_is_made_safe(name: str, safe: str) -> None:
    assert run_name(name) == safe


@given(st.text())
def test_any_name_stays_one_folder_below(name: str) -> None:
    safe = run_name(name)
    assert Path("runs", safe).parent == Path("runs")
    assert Path("/runs", safe).resolve().parent == Path("/runs")
    assert len(safe.encode()) <= 121
    assert not safe.startswith((".", "-"))


def test_the_extension_tells_recordings_apart_where_it_must(tmp_path: Path) -> None:
    (tmp_path / "rosbag2_2024.05.01").mkdir()
    recordings = ["a/walk.mcap", "a/walk.bag", "a/run.mcap", "b/Run.mcap", "c/run.mcap", "d/alone.db3"]
    names = run_names([*map(Path, recordings), tmp_path / "rosbag2_2024.05.01"])
    assert names == ["walk.mcap", "walk.bag", "run.mcap", "Run.mcap-2", "run.mcap-3", "alone", "rosbag2_2024.05.01"]


@given(st.lists(st.text(st.sampled_from("aA.b/-"), min_size=1), max_size=12))
def test_no_two_recordings_share_a_folder(stems: list[str]) -> None:
    names = run_names([Path(f"{stem}.mcap") for stem in stems])
    assert len({name.casefold() for name in names}) == len(stems)
