"""Replays that are killed, meet a full disk or one another: what is done stays done, and the rest is done once more."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from quadlog.config.file import load_config
from quadlog.errors import CannotWrite
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import planned_keys, replay, reusable_stages
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.pipelines.store import Store

pytestmark = pytest.mark.nightly
ALL = ("position", "filter", "map", "plan", "control")
CHILD = """
import sys
from pathlib import Path
from quadlog.config.file import load_config
from quadlog.errors import QuadlogError
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
fixtures, run = map(Path, sys.argv[1:])
config = load_config(fixtures / "follow.toml", ["simulation.controller=kinematic"], {})
try:
    recording, options = fixtures / "follow.mcap", ReplayOptions()
    replay(ReplayRequest(recording, run, config, options, Existing.RESUME, plots=False), Silent())
except QuadlogError as error:
    print(error)
    sys.exit(1)
"""


@pytest.fixture(scope="module")
def ask(fixtures: Path) -> Callable[..., ReplayRequest]:
    """What the child process asks for: the whole recording, so that it is busy for some seconds."""

    def request(run: Path, **options: Any) -> ReplayRequest:
        config = load_config(fixtures / "follow.toml", ["simulation.controller=kinematic"], {})
        chosen = replace(ReplayOptions(), **options)
        return ReplayRequest(fixtures / "follow.mcap", run, config, chosen, Existing.RESUME, plots=False)

    return request


@pytest.fixture(scope="module")
def in_one_go(ask, saved, tmp_path_factory) -> dict[str, object]:
    """The results of the whole recording."""
    run = tmp_path_factory.mktemp("fresh") / "follow"
    replay(ask(run), Silent())
    return saved(run)


def start(fixtures: Path, run: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", CHILD, str(fixtures), str(run)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def stored(request: ReplayRequest) -> list[str]:
    """The stages whose results are in the store."""
    store = Store(request.run.parent)
    return [name for name, key in planned_keys(request).items() if store.has(key)]


@pytest.mark.parametrize("last", ["position", "plan"])
def test_a_killed_replay_goes_on_behind_its_last_stage(last, ask, fixtures, in_one_go, saved, tmp_path):
    """SIGKILL at once when a result is there: amid the next stage, wherever that is by then."""
    run = tmp_path / "runs" / "run"
    process = start(fixtures, run)
    while last not in stored(ask(run)):
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not run.exists()
    reused = reusable_stages(ask(run))
    assert reused[: ALL.index(last) + 1] == ALL[: ALL.index(last) + 1]
    assert replay(ask(run), Silent()).reused == reused
    assert saved(run) == in_one_go  # and nothing that was half-written
    Store(run.parent).trim()
    assert not list(run.parent.rglob("*.part"))


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("error", [KeyboardInterrupt(), CannotWrite("plans.parquet", "No space left on device")])
def test_a_run_stands_until_the_one_that_replaces_it_is_complete(error, ask, saved, monkeypatch, tmp_path):
    forced = replace(ask(tmp_path / "runs" / "run", duration_s=1.0, until="plan"), existing=Existing.FORCE)
    replay(forced, Silent())
    (forced.run / "notes.txt").write_text("mine")
    before, results = files_of(forced.run), saved(forced.run)

    def stop(*_: Any) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr("quadlog.pipelines.stages.plan.recorded_maps", stop)
        with pytest.raises(type(error)):
            replay(forced, Silent())
    assert files_of(forced.run) == before
    assert replay(replace(forced, existing=Existing.REPLACE), Silent()).reused == ("position", "filter", "map")
    assert saved(forced.run) == results
    assert (forced.run / "notes.txt").read_text() == "mine"
    assert sorted(path.name for path in forced.run.parent.iterdir()) == [".stages", "run"]


FULL = resource.RLIMIT_FSIZE
"""No file gets larger: what the system then says is the same as on a full disk but for its number."""


@pytest.mark.parametrize(
    ("work", "most_bytes", "file", "count"),
    [
        ("positions.position:write_uwb", 5000, "ranges.parquet", 0),
        ("positions.position:write_uwb", 50_000, "dilution.npz", 0),
        ("maps:_Tally", 20_000, "cloud_samples.npz", 1),
        ("plan:recorded_maps", 2000, "paths.parquet", 3),
        ("control:_write_walk", 2000, "control.parquet", 4),
        ("report:saved_metrics", 1000, "metrics.json", 5),
        ("report:write_derived", 20_000, "derived.mcap", 5),
        ("report:write_run_page", 20_000, "report.html", 5),
    ],
)
def test_a_full_disk_ends_with_one_line_and_a_run_that_goes_on(
    work, most_bytes, file, count, ask, tmp_path, monkeypatch
):
    module, work = work.split(":")
    does, before = getattr(import_module(f"quadlog.pipelines.stages.{module}"), work), resource.getrlimit(FULL)

    def on_a_full_disk(*arguments: Any) -> Any:
        resource.setrlimit(FULL, (most_bytes, before[1]))
        return does(*arguments)

    request = ask(tmp_path / "runs" / "run", duration_s=1.0)
    with monkeypatch.context() as patch:
        patch.setattr(f"quadlog.pipelines.stages.{module}.{work}", on_a_full_disk)
        try:
            with pytest.raises(CannotWrite) as told:
                replay(request, Silent())
        finally:
            resource.setrlimit(FULL, before)
    assert str(told.value).startswith(f"{request.run / file}: cannot be written: ")
    assert str(told.value).endswith("; --resume goes on")
    assert not request.run.exists()
    assert not list(request.run.parent.rglob("*.part"))
    assert reusable_stages(request) == ALL[:count]
    assert replay(request, Silent()).reused == ALL[:count]


def test_two_processes_in_one_folder_end_with_the_results_of_one(ask, fixtures, in_one_go, saved, tmp_path):
    """A retry while the one that was taken for dead still writes: neither crashes, and either's results are right."""
    run = tmp_path / "runs" / "run"
    processes = [start(fixtures, run)]
    while "position" not in stored(ask(run)):
        assert processes[0].poll() is None, processes[0].communicate()
        time.sleep(0.002)
    processes.append(start(fixtures, run))
    for process in processes:
        out, err = process.communicate()
        assert "Traceback" not in err, err
        assert process.returncode == 0, (out, err)
    assert not list(run.parent.rglob("*.part"))
    assert saved(run) == in_one_go
