from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.metrics.planning import compare_planners
from quadlog.results.planner_comparison import folder as comparison_folder
from quadlog.results.planner_comparison.folder import ComparisonFiles
from quadlog.results.planners import REPLANS, SCENARIOS
from quadlog.storage.atomic_write import complete_folders

NAMES = ("astar", "ia_star")
WRITTEN = ("report.html", "planners.csv", "planners.parquet")


def answers(source: str = "walk", replans: int = 3, episodes: int = 1) -> dict[str, np.ndarray]:
    """Columns of replans.parquet of two planners, the second with half of the cells."""
    asked = [(e, r) for e in range(episodes) for r in range(replans)]
    columns: dict[str, list] = {name: [] for name in REPLANS.names}
    for episode, replan in asked:
        for planner in NAMES:
            row = dict.fromkeys(REPLANS.names, 0) | dict.fromkeys(("found", "from_scratch", "goal_projected"), True)
            row |= {"source": source, "planner": planner, "why_not": "", "episode": episode, "replan": replan}
            row |= {"expanded": 8 + replan if planner == "astar" else 4, "generated": 20, "touched": 80}
            row |= dict.fromkeys(("cost", "optimal_cost", "length_m", "turn_rad", "us"), 10.0)
            row |= {"curvature_max_1pm": 0.5, "from_scratch": replan == 0}
            for name, value in row.items():
                columns[name].append(value)
    return {name: np.array(values) for name, values in columns.items()}


def no_scenarios() -> dict[str, np.ndarray]:
    return {name: np.array([]) for name in SCENARIOS.names}


def add(files: ComparisonFiles, columns: dict[str, np.ndarray]) -> None:
    comparison = compare_planners(columns, np.random.default_rng(0), incremental=["ia_star"])
    files.add(comparison, columns, no_scenarios())


def test_every_source_has_its_rows_and_its_picture(tmp_path):
    with ComparisonFiles(tmp_path, force=False, has_queries=False) as files:
        for number in range(2):
            add(files, answers(f"walk {number}"))
        assert not (tmp_path / "plots").exists()  # nothing before all is whole
        files.finish([], [])
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == [
        "source-1-ratios.png",
        "source-2-ratios.png",
    ]
    assert (tmp_path / "plots" / "source-1-ratios.png").read_bytes().startswith(b"\x89PNG")
    assert pq.read_table(tmp_path / "replans.parquet").num_rows == 2 * 6
    assert not (tmp_path / "scenarios.parquet").exists()


@pytest.mark.parametrize(
    "name",
    ["report.html", "scenarios.parquet", "plots/source-2-paths.png"],
)
def test_what_is_there_is_replaced_by_force_alone(tmp_path, name):
    earlier = tmp_path / name
    earlier.parent.mkdir(exist_ok=True)
    earlier.write_text("earlier")
    (tmp_path / "plots").mkdir(exist_ok=True)
    (tmp_path / "plots" / "source-of-truth.png").write_text("mine")
    with pytest.raises(AlreadyExists, match="--force"), ComparisonFiles(tmp_path, force=False, has_queries=False):
        pass
    with pytest.raises(RuntimeError, match="stop"):
        _interrupted(ComparisonFiles(tmp_path, force=True, has_queries=False))
    assert earlier.read_text() == "earlier"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted({"plots", earlier.relative_to(tmp_path).parts[0]})
    _finished(tmp_path, force=True)
    assert earlier.name in WRITTEN or not earlier.exists()
    assert not earlier.exists() or earlier.read_bytes() != b"earlier"
    assert (tmp_path / "plots" / "source-of-truth.png").read_text() == "mine"


def _finished(folder: Path, force: bool = False) -> None:
    with ComparisonFiles(folder, force, has_queries=False) as files:
        add(files, answers())
        files.finish([], [])


def _interrupted(comparison: ComparisonFiles) -> None:
    with comparison as files:
        add(files, answers())
        raise RuntimeError("stop")


def test_room_that_cannot_be_made_leaves_no_table(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "plots").write_text("in the way")
    with pytest.raises(CannotWrite, match="cannot be written"):
        _finished(tmp_path / "out", force=True)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["plots"]


def test_a_new_folder_vanishes_with_an_error_an_old_one_stays(tmp_path):
    for name in ("new/folder", "old"):
        folder = tmp_path / name
        if name == "old":
            folder.mkdir()
        with pytest.raises(RuntimeError), ComparisonFiles(folder, force=False, has_queries=True):
            raise RuntimeError
        assert folder.exists() == (name == "old")
    assert list((tmp_path / "old").iterdir()) == []


def test_a_signal_while_the_files_appear_comes_when_all_are_there(tmp_path, monkeypatch):
    """The last chance to stop a comparison is before its first file appears."""

    def raises(number: int, _: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, raises)
    render, writes = comparison_folder.write_whole, []

    def write(path, content):
        writes.append(path)
        signal.raise_signal(signal.SIGTERM)
        render(path, content)

    monkeypatch.setattr(comparison_folder, "write_whole", write)
    try:
        with pytest.raises(KeyboardInterrupt):
            _finished(tmp_path / "out")
    finally:
        signal.signal(signal.SIGTERM, before)
    assert len(writes) > 3
    assert writes[-1].name == "report.html"
    assert all(path.is_file() for path in writes)
    assert complete_folders(0.0)[-1] == tmp_path / "out"
