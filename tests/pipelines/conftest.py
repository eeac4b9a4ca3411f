"""One short replay of the committed recording, shared by the tests that only look at it; and what makes two alike."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from dask.local import SynchronousExecutor

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.pipelines.batch import batch
from quadlog.pipelines.batch.plan import Planned, plan_batch
from quadlog.pipelines.executor.executor import Engine
from quadlog.pipelines.executor.progress import Listener, Silent, told_to
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.simulation.synthesize import make_recording, synthesize

FIXTURES = Path(__file__).parents[2] / "fixtures"
SHORT_S = 3.0


def fixture_request(run: Path, **options: object) -> ReplayRequest:
    """The committed recording's first seconds, into the folder `run`."""
    config = load_config(FIXTURES / "follow.toml", environ={})
    chosen = replace(ReplayOptions(duration_s=SHORT_S), **options)  # type: ignore[arg-type]
    return ReplayRequest(FIXTURES / "follow.mcap", run, config, chosen)


@pytest.fixture(scope="session")
def fixtures() -> Path:
    """Where the committed recording is."""
    return FIXTURES


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs a batch's recordings in this process, where a test can replace functions."""

    @contextmanager
    def open_engine(jobs: int, scheduler: str | None, listener: Listener) -> Iterator[Engine]:
        with told_to(listener):
            yield Engine(SynchronousExecutor(), lambda: 1, lambda: 1, lambda: None)

    monkeypatch.setattr(batch, "open_engine", open_engine)


@pytest.fixture(scope="session")
def follow_request() -> Callable[..., ReplayRequest]:
    """Makes requests to replay the committed recording's first seconds into a folder."""
    return fixture_request


LIAS_ANCHORS_M = (
    (-3.4203, 3.0053, 1.0442),
    (0.0016, 3.0110, 1.0446),
    (3.6056, 2.9795, 1.0463),
    (3.6011, -0.0008, 1.0422),
    (3.5674, -3.0087, 1.0443),
    (-0.0072, -2.9652, 1.0444),
    (-3.4673, -2.9587, 1.0445),
    (-3.4858, -0.0098, 1.0457),
)


@dataclass(frozen=True)
class Lias:
    """A real recording of three tags on a trolley: its folder, and where on the trolley the tags are."""

    folder: Path
    levers_m: tuple[tuple[float, float], ...] = ((-0.0689, -0.1423), (-0.0750, 0.1402), (0.2034, 0.1451))

    def config(self, robot: int) -> Config:
        """With one of the tags as the robot's."""
        anchors = [{"id": i, "x_m": x, "y_m": y, "z_m": z} for i, (x, y, z) in enumerate(LIAS_ANCHORS_M)]
        tags = [
            {"id": i, "role": "robot" if i == robot else "none", "height_m": 0.97, "x_m": x, "y_m": y}
            for i, (x, y) in enumerate(self.levers_m)
        ]
        return Config.model_validate({"uwb": {"anchors": anchors, "tags": tags}})


@pytest.fixture(scope="session")
def lias() -> Lias:
    if "QUADLOG_DATASETS" not in os.environ:
        pytest.skip("QUADLOG_DATASETS is not set")
    folder = Path(os.environ["QUADLOG_DATASETS"]) / "uwb_lias"
    if not folder.exists():
        pytest.skip(f"{folder} is not there")
    return Lias(folder)


TIMINGS = {"ms", "us"}
RUN_OWN = {"stages", "startup_s", "realtime_factor", "host", "reused", "command"}
"""What run.json may say of one run alone."""


def results_of(run: Path) -> dict[str, object]:
    """All that a replay has saved, timings and what shows them apart: equal for equal runs, byte for byte."""
    found: dict[str, object] = {}
    for path in sorted(path for path in run.rglob("*") if path.is_file()):
        name = path.relative_to(run).as_posix()
        if path.suffix == ".parquet":
            table = pq.read_table(path)
            columns = [column for column in table.column_names if column not in TIMINGS]
            timed = len(columns) != len(table.column_names)
            found[name] = table.select(columns) if timed else path.read_bytes()
        elif name == "run.json":
            record = json.loads(path.read_text())
            found[name] = {key: value for key, value in record.items() if key not in RUN_OWN}
        elif name == "metrics.json":
            found[name] = {key: each for key, each in json.loads(path.read_text()).items() if key != "realtime_factor"}
        else:
            found[name] = None if name in ("stages.json", "report.html") else path.read_bytes()
    return found


@pytest.fixture(scope="session")
def saved() -> Callable[[Path], dict[str, object]]:
    """See results_of."""
    return results_of


@pytest.fixture(scope="session")
def season(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of the same second in the three containers, and a file that is no recording."""
    folder = tmp_path_factory.mktemp("season")
    recording = make_recording("follow", seed=1, duration_s=1.0, azimuth_steps=90)
    for suffix in ("mcap", "bag", "db3"):
        synthesize(recording, folder / f"walk.{suffix}")
    (folder / "broken.bag").write_text("not a bag at all")
    return folder


@pytest.fixture(scope="session")
def season_config() -> Config:
    """The anchors of `season`, and its ground truth."""
    rows = [(0, 1.0, 1.0, 1.15), (1, 20.0, 1.2, 1.2), (2, 17.5, 15.8, 1.26), (3, 1.2, 14.8, 1.22)]
    anchors = ", ".join(f"{{id={i}, x_m={x}, y_m={y}, z_m={z}}}" for i, x, y, z in rows)
    return load_config(None, [f"uwb.anchors=[{anchors}]", "topics.reference=/truth/robot/pose"], {})


@pytest.fixture(scope="session")
def planned(season: Path, season_config: Config) -> Callable[..., list[Planned]]:
    """Plans to replay all of `season`, or what of it is named, into a folder."""

    def plan(output: Path, *names: str, until: str = "ingest", existing: Existing = Existing.REFUSE) -> list[Planned]:
        arguments = [str(season / name) for name in names] or [str(season)]
        return plan_batch(arguments, output, season_config, ReplayOptions(until=until), existing, ("quadlog",))

    return plan


@pytest.fixture(scope="session")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> ReplayOutcome:
    return replay(fixture_request(tmp_path_factory.mktemp("runs") / "follow"), Silent())


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> ReplayOutcome:
    request = fixture_request(tmp_path_factory.mktemp("runs") / "follow", duration_s=None)
    return replay(request, Silent())
