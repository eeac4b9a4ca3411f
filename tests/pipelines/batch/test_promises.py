"""What every command that writes promises of what is there: refused, replaced by --force, and whole at any moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest.mock import Mock

import pytest

from quadlog.config.file import load_config
from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.pipelines.comparison.compare import compare
from quadlog.pipelines.comparison.sources import CompareOptions
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.info import write_new
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing
from quadlog.pipelines.simulation import trot
from quadlog.pipelines.simulation.simulate import SimulateRequest, simulate
from quadlog.pipelines.simulation.synthesize import make_recording, synthesize
from tests.pipelines.conftest import fixture_request


def replayed(folder: Path, force: bool) -> None:
    existing = Existing.FORCE if force else Existing.REFUSE
    request = fixture_request(folder / "run", until="position", duration_s=0.5)
    replay(replace(request, existing=existing, plots=False), Silent())


def simulated(folder: Path, force: bool, course: str = "") -> None:
    path = folder.parent / "path.csv"
    path.write_text("0,0\n0.5,0\n")
    config = load_config(None, [] if course else ["simulation.controller=kinematic"])
    request = SimulateRequest(course or str(path), config, output=folder / "runs", force=force, plots=False)
    simulate(request, 1, Silent())


def synthesized(folder: Path, force: bool) -> None:
    recording = make_recording("follow", seed=0, duration_s=0.3, azimuth_steps=24)
    synthesize(recording, folder / "walk.mcap", config_output=folder / "walk.toml", force=force)


def compared(folder: Path, force: bool) -> None:
    compare(["forest:0.1"], CompareOptions(planners=("ia_star",), episodes=1), folder / "out", force, Silent())


def initialised(folder: Path, force: bool) -> None:
    write_new(folder / "quadlog.toml", "[uwb]\n", force=force)


class Maker(NamedTuple):
    """make(folder, force), and a function that it calls before its last file is there."""

    make: Callable[[Path, bool], None]
    late: str


WALK_PAGE = "quadlog.pipelines.simulation.simulate.write_run_page"
MAKERS = {
    "replay": Maker(replayed, "quadlog.pipelines.stages.report.saved_metrics"),
    "simulate": Maker(simulated, WALK_PAGE),
    "simulate trot-32s": Maker(lambda folder, force: simulated(folder, force, "trot-32s"), WALK_PAGE),
    "synthesize": Maker(synthesized, "quadlog.simulation.synthetic.ros_encoding.RosEncoder.encode"),
    "compare-planners": Maker(compared, "quadlog.pipelines.comparison.compare.verdict"),
    "init": Maker(initialised, "os.fsync"),
}


@pytest.fixture
def short_trots(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trot, "TROT_S", 3.0)


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and ".stages" not in path.parts
    }


def folders_of(folder: Path) -> list[Path]:
    return [folder, *(path for path in folder.rglob("*") if path.is_dir() and ".stages" not in path.parts)]


@pytest.mark.usefixtures("short_trots")
@pytest.mark.parametrize("name", MAKERS)
def test_what_is_there_is_refused_or_replaced_and_stays_until_the_new_one_is_whole(name, tmp_path, monkeypatch):
    make, late = MAKERS[name]
    (folder := tmp_path / "work").mkdir()

    def stop(error: BaseException, force: bool) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(late, Mock(side_effect=error))
            with pytest.raises(type(error)):
                make(folder, force)

    stop(KeyboardInterrupt(), force=False)
    assert files_of(folder) == {}
    make(folder, False)  # nothing is in its way
    for each in folders_of(folder):
        (each / "mine.txt").write_text("mine")
    before = files_of(folder)
    with pytest.raises(AlreadyExists, match="--force"):
        make(folder, False)
    for error in (KeyboardInterrupt(), CannotWrite("x", "No space left on device")):
        stop(error, force=True)
    assert files_of(folder) == before
    made = [path for path in folder.rglob("*") if path.is_file() and path.name != "mine.txt"]
    stamps = {path: path.stat().st_mtime_ns for path in made}
    make(folder, True)
    after = files_of(folder)
    assert after.keys() == before.keys()
    assert any(path.stat().st_mtime_ns > stamp for path, stamp in stamps.items() if path.exists())
    assert not list(tmp_path.rglob("*.part"))
