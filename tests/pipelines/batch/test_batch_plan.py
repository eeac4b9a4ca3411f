from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import RecordingNotFound
from quadlog.pipelines import replay as replay_module
from quadlog.pipelines.batch.batch import replay_batch
from quadlog.pipelines.batch.plan import Previewed, existing_runs, preview_batch, total_s
from quadlog.pipelines.batch.progress import BatchCounts, BatchLines
from quadlog.pipelines.request import Existing


@pytest.fixture(scope="module")
def finished(planned, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("out") / "runs"
    replay_batch(planned(output), 1, None, BatchLines([].append))
    return output


def actions(batch):
    return sorted(each.action for each in preview_batch(batch))


def test_a_preview_says_what_would_happen_and_writes_nothing(planned, finished, tmp_path):
    assert actions(planned(tmp_path / "runs")) == ["run"] * 4
    assert not (tmp_path / "runs").exists()
    assert actions(planned(finished, existing=Existing.RESUME)) == ["run", "skip", "skip", "skip"]
    assert actions(planned(finished, existing=Existing.REFUSE)) == ["refuse", "refuse", "refuse", "run"]
    assert actions(planned(finished, existing=Existing.FORCE)) == ["replace", "replace", "replace", "run"]
    assert actions(planned(finished, until="position", existing=Existing.RESUME)) == ["resume"] * 3 + ["run"]
    (finished / "walk.bag" / "extra").mkdir(parents=True)
    assert len(existing_runs(planned(finished))) == 3


def test_only_recordings_that_have_a_run_folder_are_read(planned, tmp_path, monkeypatch):
    monkeypatch.setattr(replay_module, "describe_input", lambda path: pytest.fail(f"{path} is hashed"))
    batch = planned(tmp_path / "runs", existing=Existing.RESUME)
    (tmp_path / "runs" / "walk.bag").mkdir(parents=True)
    (tmp_path / "runs" / "walk.bag" / ".quadlog-0-0.part").touch()
    assert actions(batch) == ["run"] * 4


def test_the_expected_time_is_that_of_finished_runs_by_their_bytes(planned, finished, tmp_path):
    """Runs that took 10 s for each of 2 MB, 30 s for 4 MB: 10 s for 1 MB."""
    for name, stages_s, size_bytes in (("a", (4.0, 5.0), 2e6), ("b", (9.0, 20.0), 2e6), ("c", (1e6,), 1)):
        (tmp_path / name).mkdir()
        record = json.loads((finished / "walk.bag" / "run.json").read_text())
        record |= {
            "startup_s": 1.0,
            "stages": [{"name": "ingest", "seconds": each, "peak_memory_mb": 1.0} for each in stages_s],
        }
        record["input"]["size_bytes"] = int(size_bytes)
        record["options"]["until"] = "map" if name == "c" else "ingest"
        (tmp_path / name / "run.json").write_text(json.dumps(record))
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "run.json").write_text("no JSON")
    for each in preview_batch(planned(tmp_path)):
        assert each.expected_s == pytest.approx(each.planned.size_bytes * 1e-5)
    assert {each.expected_s for each in preview_batch(planned(tmp_path, until="position"))} == {None}


@given(st.lists(st.floats(0, 1e4), min_size=1, max_size=30), st.integers(1, 8))
def test_so_many_workers_take_no_less_than_their_share_and_no_longer_than_graham_says(seconds, jobs):
    """Graham 1969: the longest first takes at most 4/3 - 1/(3 m) of the shortest time there is."""
    total = total_s([Previewed(None, "run", (), each) for each in seconds], jobs)
    least = max(sum(seconds) / jobs, max(seconds))
    if len(seconds) > jobs:
        least = max(least, sum(sorted(seconds)[-jobs - 1 :][:2]))
    assert least - 1e-6 <= total + 1e-6
    assert total <= sum(seconds) / jobs + max(seconds) * (1 - 1 / jobs) + 1e-6


def test_an_unknown_time_is_no_time():
    assert total_s([Previewed(None, "run"), Previewed(None, "run", (), 1.0)], 2) is None
    assert total_s([Previewed(None, "run", (), 8.0), *[Previewed(None, "run", (), 4.0)] * 3], 2) == 12.0


def test_time_left_is_by_the_bytes_that_are_left():
    tally = BatchCounts(4, 100)
    assert tally.left_s(2) is None
    tally.count(40, False, None)  # was done already
    tally.count(20, False, 10.0)
    assert (tally.done, tally.failed, tally.left_s(2)) == (2, 0, 10.0)
    tally.count(20, True, 30.0)
    assert (tally.done, tally.failed, tally.left_s(1)) == (3, 1, 20.0)
    assert tally.left_s(0) is None


def test_an_argument_without_recordings_is_refused(planned, tmp_path):
    with pytest.raises(RecordingNotFound):
        planned(tmp_path / "runs", str(tmp_path))
