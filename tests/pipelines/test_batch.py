from __future__ import annotations

import os
import shutil
from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from quadlog.config_file import load_config
from quadlog.errors import RecordingNotFound
from quadlog.pipelines.batch import plan_batch, replay_batch
from quadlog.pipelines.progress import Kept, Silent
from quadlog.pipelines.replay import Existing, ReplayOptions
from quadlog.pipelines.synthesize import make_recording, synthesize


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    """Three recordings of the same second in the three containers, and a file that is no recording."""
    folder = tmp_path_factory.mktemp("season")
    recording = make_recording("follow", seed=1, duration_s=1.0, azimuth_steps=90)
    for suffix in ("mcap", "bag", "db3"):
        synthesize(recording, folder / f"walk.{suffix}")
    (folder / "broken.bag").write_text("not a bag at all")
    return folder


def run_all(season, output, jobs, existing=Existing.REFUSE, until="control"):
    config = load_config(None, _anchors(), {})
    batch = plan_batch([str(season)], output, config, ReplayOptions(until=until), existing, ("quadlog",))
    return batch, replay_batch(batch, jobs, Silent())


def _anchors():
    rows = [(0, 1.0, 1.0, 1.15), (1, 20.0, 1.2, 1.2), (2, 17.5, 15.8, 1.26), (3, 1.2, 14.8, 1.22)]
    anchors = ", ".join(f"{{id={i}, x_m={x}, y_m={y}, z_m={z}}}" for i, x, y, z in rows)
    return [f"uwb.anchors=[{anchors}]", "topics.reference=/truth/robot/pose"]


@pytest.fixture(scope="module")
def finished(season, tmp_path_factory):
    output = tmp_path_factory.mktemp("out") / "runs"
    _, outcome = run_all(season, output, jobs=1)
    return output, outcome


def test_a_failure_never_stops_the_rest_and_stands_in_the_summary(finished):
    output, outcome = finished
    assert outcome.exit_code == 3
    assert [run.failed for run in outcome.runs] == [True, False, False, False]
    summary = pq.read_table(output / "summary.parquet").to_pandas().set_index("recording")
    assert set(summary.index) == {"broken", "walk.mcap", "walk.bag", "walk.db3"}
    assert summary.loc["broken", "exit_code"] == 1
    assert summary.loc["broken", "reason"].startswith("its first bytes are none of a recording")
    assert summary["eta_m"].notna().sum() == 3
    assert "its first bytes are none of a recording" in (output / "report.html").read_text()


@pytest.mark.parametrize("other", ["bag", "db3"])
def test_the_same_messages_in_three_containers_give_identical_tables(finished, other):
    output, _ = finished
    for path in sorted((output / "walk.mcap").glob("*.parquet")):
        one, two = (pq.read_table(path), pq.read_table(output / f"walk.{other}" / path.name))
        kept = [name for name in one.column_names if name not in ("ms", "us")]
        assert one.select(kept).equals(two.select(kept)), path.name
    for name in ("maps.npz", "cloud_samples.npz", "ground.npz", "trajectory.tum", "map.pgm", "derived.mcap"):
        assert (output / "walk.mcap" / name).stat().st_size > 0
        if name != "derived.mcap":
            assert (output / "walk.mcap" / name).read_bytes() == (output / f"walk.{other}" / name).read_bytes(), name


def test_jobs_do_not_change_a_byte(season, finished, tmp_path):
    output, _ = finished
    run_all(season, tmp_path / "runs", jobs=2)
    for path in sorted((output / "walk.mcap").glob("*.npz")):
        assert path.read_bytes() == (tmp_path / "runs" / "walk.mcap" / path.name).read_bytes()
    for name in ("fixes", "ranges", "poses", "target", "paths", "control", "resim_paths"):
        parquet = f"walk.mcap/{name}.parquet"
        assert (output / parquet).read_bytes() == (tmp_path / "runs" / parquet).read_bytes()


def test_dry_run_says_what_would_happen_and_writes_nothing(season, finished, tmp_path):
    config, options = load_config(None, _anchors(), {}), ReplayOptions(until="control")
    arguments, command = [str(season)], ("quadlog",)
    fresh = plan_batch(arguments, tmp_path / "runs", config, options, Existing.REFUSE, command)
    assert [each.action for each in fresh] == ["run"] * 4
    assert not (tmp_path / "runs").exists()
    again = plan_batch(arguments, finished[0], config, options, Existing.RESUME, command)
    assert sorted(each.action for each in again) == ["run", "skip", "skip", "skip"]
    refused = plan_batch(arguments, finished[0], config, options, Existing.REFUSE, command)
    assert sorted(each.action for each in refused) == ["refuse", "refuse", "refuse", "run"]


def test_rows_of_earlier_commands_stay_while_their_runs_do(season, tmp_path):
    config, options = load_config(None, _anchors(), {}), ReplayOptions(until="ingest")
    for name in ("walk.bag", "walk.mcap"):
        copied = tmp_path / name.replace("walk", name[5:])
        shutil.copy(season / name, copied)
        batch = plan_batch([str(copied)], tmp_path / "runs", config, options, Existing.REFUSE, ())
        replay_batch(batch, None, Silent())
    summary = pq.read_table(tmp_path / "runs" / "summary.parquet").to_pandas()
    assert list(summary["recording"]) == ["bag", "mcap"]


def test_a_refused_run_keeps_its_row(season, tmp_path):
    for _ in range(2):
        _, outcome = run_all(season, tmp_path / "runs", jobs=1, until="ingest")
    assert outcome.exit_code == 1
    summary = pq.read_table(tmp_path / "runs" / "summary.parquet").to_pandas().set_index("recording")
    assert (summary.loc[["walk.mcap", "walk.bag", "walk.db3"], "exit_code"] == 0).all()


def test_somebody_elses_report_is_left_alone(season, tmp_path):
    (tmp_path / "report.html").write_text("my thesis")
    config, options = load_config(None, _anchors(), {}), ReplayOptions(until="ingest")
    batch = plan_batch([str(season / "walk.bag")], tmp_path, config, options, Existing.REFUSE, ())
    kept = Kept()
    assert replay_batch(batch, None, kept).exit_code == 0
    assert (tmp_path / "report.html").read_text() == "my thesis"
    assert not (tmp_path / "summary.parquet").exists()
    assert any("is left alone" in line for line in kept.lines)


def test_what_workers_have_to_say_reaches_the_terminal(season, tmp_path):
    config, options = load_config(None, _anchors(), {}), ReplayOptions(until="position")
    batch = plan_batch([str(season)], tmp_path / "runs", config, options, Existing.REFUSE, ())
    kept = Kept()
    replay_batch(batch, 2, kept)
    for name in ("walk.mcap", "walk.bag", "walk.db3"):
        assert any(name in line and "robot position from uwb" in line for line in kept.lines)


class Deadly:
    """A request that kills the worker which unpickles it, as running out of memory would."""

    def __init__(self, request):
        self.recording, self.run = request.recording, request.run

    def __reduce__(self):
        return os._exit, (9,)


def test_a_killed_worker_is_blamed_on_its_own_recording_alone(season, tmp_path):
    config, options = load_config(None, _anchors(), {}), ReplayOptions(until="ingest")
    recordings = [str(season / f"walk.{suffix}") for suffix in ("mcap", "bag", "db3")]
    batch = plan_batch(recordings, tmp_path / "runs", config, options, Existing.REFUSE, ())
    batch[1] = replace(batch[1], request=Deadly(batch[1].request))
    outcome = replay_batch(batch, 2, Silent())
    assert outcome.exit_code == 3
    assert [run.failed for run in outcome.runs] == [False, True, False]
    assert "killed" in outcome.runs[1].reason


def test_an_argument_without_recordings_is_refused(tmp_path):
    config = load_config(None, environ={})
    with pytest.raises(RecordingNotFound):
        plan_batch([str(tmp_path)], tmp_path / "runs", config, ReplayOptions(), Existing.REFUSE, ())
