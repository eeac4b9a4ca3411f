from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
import pytest

from quadlog.cli.main import run as run_cli
from quadlog.pipelines.tables import make_tables as measuring
from quadlog.pipelines.tables.real import uwb_real
from quadlog.pipelines.tables.real.recordings import real_logs
from quadlog.positioning.locate import LocateSettings, locate


def tables(folder: Path, *more: str) -> int:
    return run_cli(["tables", "uwb-real", "--fast", "-o", str(folder), *more])


@pytest.mark.parametrize("value", [None, "", "/nowhere"])
def test_without_recordings_it_is_skipped_and_says_how_to_have_it(tmp_path, monkeypatch, capsys, value):
    monkeypatch.setattr(measuring, "code_digest", lambda: "this code")
    monkeypatch.delenv("QUADLOG_DATASETS", raising=False)
    if value is not None:
        monkeypatch.setenv("QUADLOG_DATASETS", value)
    assert tables(tmp_path / "out") == 0
    out = capsys.readouterr().out
    assert "uwb-real: Skipped: QUADLOG_DATASETS" in out
    assert "Set QUADLOG_DATASETS to a folder" in out
    assert "Set QUADLOG_DATASETS" in (tmp_path / "out" / "report.html").read_text()
    with (tmp_path / "out" / "uwb-real.csv").open() as file:
        assert len(list(csv.reader(file))) == 1


@pytest.fixture
def datasets() -> Path:
    if "QUADLOG_DATASETS" not in os.environ:
        pytest.skip("QUADLOG_DATASETS is not set")
    return Path(os.environ["QUADLOG_DATASETS"])


def test_once_the_recordings_are_there_a_skipped_table_is_made(tmp_path, datasets, monkeypatch):
    """And is the same again, byte for byte; on the labyrinth alone, which is the shortest."""
    monkeypatch.setattr(measuring, "code_digest", lambda: "this code")
    folder, some = tmp_path / "out", tmp_path / "datasets"
    some.mkdir()
    (some / "uwb_labyrinth").symlink_to(datasets / "uwb_labyrinth")
    monkeypatch.delenv("QUADLOG_DATASETS")
    assert tables(folder) == 0
    monkeypatch.setenv("QUADLOG_DATASETS", str(some))
    assert tables(folder, "--force") == 0
    with (folder / "uwb-real.csv").open() as file:
        rows = {row["quantity"]: row for row in csv.DictReader(file)}
    assert all(row["paper"] == row["reproduces"] == "" for row in rows.values())
    ratio = rows["labyrinth: RMSE of quadlog / causal EKF (1)"]
    assert 0 < float(ratio["low"]) < float(ratio["ours"]) < float(ratio["high"]) < 1
    own = float(rows["labyrinth: RMSE of quadlog (m)"]["ours"])
    other = float(rows["labyrinth: RMSE of causal EKF (m)"]["ours"])
    assert float(ratio["ours"]) == pytest.approx(own / other, rel=1e-4)
    assert any("without odometry" in name for name in rows)
    assert tables(tmp_path / "again") == 0
    assert (folder / "uwb-real.csv").read_bytes() == (tmp_path / "again" / "uwb-real.csv").read_bytes()


def test_errors_are_those_of_the_track(datasets):
    """Against the truth interpolated by numpy at the track's own instants, the first second left out."""
    *_, log = real_logs(datasets, None)
    assert log.name == "labyrinth"
    track = locate(log.ranges, log.anchors, [log.tag], LocateSettings()).tags[0].track
    true_m = np.column_stack([np.interp(track.t_ns, log.truth.t_ns, log.truth.position_m[:, k]) for k in range(2)])
    late = track.t_ns > track.t_ns[0] + 10**9
    rmse_m = np.sqrt(np.mean(np.sum((track.position_m - true_m)[late] ** 2, axis=1)))
    scored = uwb_real.score_log(log)
    assert np.sqrt(np.mean(scored.square_m2["quadlog"])) == pytest.approx(rmse_m, rel=0.03)


def test_the_trolley_has_three_tags_where_the_authors_put_them(datasets):
    """Levers the wrong way round would put tags 20 cm off: fixes on biased ranges are within 0.2 m of the truth."""
    logs = [log for log in real_logs(datasets, 15.0) if log.name.startswith("trolley")]
    assert [log.tag.id for log in logs] == [0, 1, 2]
    for log in logs:
        assert log.ranges.t_ns[-1] - log.ranges.t_ns[0] < 15e9
        scored = uwb_real.score_log(log)
        assert np.sqrt(np.mean(scored.square_m2["quadlog"])) < 0.12
