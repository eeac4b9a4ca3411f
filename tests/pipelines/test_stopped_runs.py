"""Replays that are killed, meet a full disk or one another: what is done stays done, and the rest is done once more."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from quadlog.config.file import load_config
from quadlog.errors import CannotWrite
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay, reusable_stages
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.pipelines.stages import report
from quadlog.results.record import is_finished

pytestmark = pytest.mark.nightly
ALL = ("position", "filter", "map", "plan", "control")
MARKS = ("position", "plan")
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


def marked(run: Path) -> list[str]:
    path = run / "stages.json"
    return [each["stage"] for each in json.loads(path.read_text())["stages"]] if path.exists() else []


@pytest.mark.parametrize("last", MARKS)
def test_a_killed_replay_goes_on_behind_its_last_mark(last, ask, fixtures, in_one_go, saved, tmp_path):
    """SIGKILL at once when a mark is there: amid the next stage, wherever that is by then."""
    run = tmp_path / "run"
    process = start(fixtures, run)
    while last not in marked(run):
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not is_finished(run)
    reused = reusable_stages(ask(run))
    assert reused[: ALL.index(last) + 1] == ALL[: ALL.index(last) + 1]
    replay(ask(run), Silent())
    assert tuple(json.loads((run / "run.json").read_text())["reused"]) == reused
    assert saved(run) == in_one_go  # and nothing that was half-written


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def forced(ask, tmp_path) -> ReplayRequest:
    """Replaces a finished run, beside a file of the user's in its folder."""
    request = replace(ask(tmp_path / "runs" / "run", duration_s=1.0, until="plan"), existing=Existing.FORCE)
    replay(request, Silent())
    (request.run / "notes.txt").write_text("mine")
    return request


@pytest.mark.parametrize("stage", ["positions.position:locate_walk", "plan:replan_walk"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), CannotWrite("plans.parquet", "No space left on device")])
def test_a_run_stands_until_the_one_that_replaces_it_is_complete(stage, error, forced, saved, monkeypatch):
    def stop(*_: Any) -> None:
        raise error

    before, results = files_of(forced.run), saved(forced.run)
    module, work = stage.split(":")
    with monkeypatch.context() as patch:
        patch.setattr(import_module(f"quadlog.pipelines.stages.{module}"), work, stop)
        with pytest.raises(type(error)):
            replay(forced, Silent())
    assert files_of(forced.run) == before
    resumed = replay(replace(forced, existing=Existing.RESUME), Silent())
    # Without a finished stage of the new run, the old one is what was asked for.
    assert resumed.reused == (("position", "filter", "map") if stage.startswith("plan") else ALL[:4])
    assert (files_of(forced.run) == before) == (not stage.startswith("plan"))
    assert saved(forced.run) == results
    assert files_of(forced.run).keys() == before.keys()
    assert [path.name for path in forced.run.parent.iterdir()] == ["run"]


@pytest.mark.parametrize("moved", [0, 1, 5])
def test_a_kill_while_the_new_run_takes_the_place_of_the_old_is_put_right(moved, forced, saved, monkeypatch):
    results, left = saved(forced.run), [moved]

    def killed(path: Path, target: Path) -> None:
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        path.replace(target)

    with monkeypatch.context() as patch:
        patch.setattr("quadlog.results.places.move_whole", killed)
        with pytest.raises(KeyboardInterrupt):
            replay(forced, Silent())
    assert replay(replace(forced, existing=Existing.RESUME), Silent()).reused == ALL[:4]
    assert saved(forced.run) == results
    assert (forced.run / "notes.txt").read_text() == "mine"
    assert [path.name for path in forced.run.parent.iterdir()] == ["run"]


def test_what_was_forced_for_another_configuration_is_not_gone_on_with(ask, forced, monkeypatch):
    fixed = {"topics.position": "fixed", "topics.target": "fixed"}
    other = replace(forced, config=load_config(settings=fixed, environ={}))
    with monkeypatch.context() as patch:
        patch.setattr("quadlog.pipelines.stages.plan.replan_walk", lambda _: signal.raise_signal(signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            replay(other, Silent())
    before = files_of(forced.run)
    assert replay(replace(forced, existing=Existing.RESUME), Silent()).reused == ALL[:4]
    assert files_of(forced.run) == before
    assert [path.name for path in forced.run.parent.iterdir()] == ["run"]


@contextmanager
def full_disk(most_bytes: int) -> Iterator[None]:
    """No file gets larger: what the system then says is the same as on a full disk but for its number."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("work", "most_bytes", "file", "count"),
    [
        ("positions.position:locate_walk", 5000, "ranges.parquet", 0),
        ("positions.position:locate_walk", 50_000, "dilution.npz", 0),
        ("perceive:filter_and_map", 2000, "scans.parquet", 1),
        ("perceive:filter_and_map", 20_000, "cloud_samples.npz", 1),
        ("plan:replan_walk", 2000, "paths.parquet", 3),
        ("control:resimulate_walk", 2000, "control.parquet", 4),
        ("report:finish_walk", 1000, "metrics.json", 5),
        ("report:finish_walk", 20_000, "derived.mcap", 5),
        ("report:write_page", 20_000, "report.html", 5),
    ],
)
def test_a_full_disk_ends_with_one_line_and_a_run_that_goes_on(
    work, most_bytes, file, count, ask, tmp_path, monkeypatch
):
    module, work = work.split(":")
    module = import_module(f"quadlog.pipelines.stages.{module}")
    does = getattr(module, work)

    def on_a_full_disk(*arguments: Any) -> Any:
        with full_disk(most_bytes):
            return does(*arguments)

    request = ask(tmp_path / "run", duration_s=1.0)
    monkeypatch.setattr(module, work, on_a_full_disk)
    with pytest.raises(CannotWrite) as told:
        replay(request, Silent())
    monkeypatch.setattr(module, work, does)
    run = tmp_path / "run"
    assert str(told.value).startswith(f"{run / file}: cannot be written: ")
    assert str(told.value).endswith("; --resume goes on")
    assert not is_finished(run)
    assert not [path for path in run.glob("*") if path.name.startswith(".")]
    assert reusable_stages(request) == ALL[:count]
    replay(request, Silent())
    assert is_finished(run)


def test_a_picture_that_finds_no_room_is_told_as_well(ask, tmp_path, monkeypatch):
    from quadlog.results.figures import write_plots

    def draw(run: Path, drawings: Any) -> None:
        with full_disk(5000):
            write_plots(run, drawings)

    monkeypatch.setattr(report, "write_plots", draw)
    with pytest.raises(CannotWrite, match=r"plots/\w+\.png: cannot be written: .*; --resume goes on"):
        replay(replace(ask(tmp_path / "run", duration_s=0.5, until="map"), plots=True), Silent())


def test_a_mark_that_finds_no_room_is_no_mark(ask, tmp_path, monkeypatch):
    from quadlog.pipelines.stages import resume as reuse

    write, written = reuse.write_marks, []

    def write_marks(run: Path, marks: Any) -> None:
        written.append(len(marks))
        with full_disk(100 if len(marks) == 2 else 1 << 30):
            write(run, marks)

    monkeypatch.setattr(reuse, "write_marks", write_marks)
    with pytest.raises(CannotWrite, match=r"stages\.json: cannot be written: "):
        replay(ask(tmp_path / "run", duration_s=0.5, until="map"), Silent())
    assert written == [1, 2]
    assert reusable_stages(ask(tmp_path / "run", duration_s=0.5)) == ("position",)


def test_two_processes_in_one_folder_end_with_the_results_of_one(ask, fixtures, in_one_go, saved, tmp_path):
    """A retry while the one that was taken for dead still writes: neither crashes, and either's results are right."""
    run = tmp_path / "run"
    processes = [start(fixtures, run)]
    while "position" not in marked(run):
        assert processes[0].poll() is None, processes[0].communicate()
        time.sleep(0.002)
    processes.append(start(fixtures, run))
    for process in processes:
        out, err = process.communicate()
        assert "Traceback" not in err, err
        assert process.returncode in (0, 1), (out, err)
        assert process.returncode == 0 or out.count("\n") == 1
    assert 0 in [process.returncode for process in processes]
    assert not [path.name for path in run.iterdir() if path.name.startswith(".")]
    replay(ask(run), Silent())
    assert saved(run) == in_one_go
