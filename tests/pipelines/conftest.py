"""One short replay of the committed recording, shared by the tests that only look at it; and what makes two alike."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from quadlog.cli.main import run as run_cli
from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.pipelines.batch import batch
from quadlog.pipelines.batch.plan import Planned, plan_batch
from quadlog.pipelines.executor.pool import Workers
from quadlog.pipelines.executor.progress import BatchLines, Silent, send_to
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.simulation.synthesize import make_recording, synthesize
from quadlog.results.record import is_finished
from quadlog.results.tables import read_table
from quadlog.simulation.sensors.scene import Cylinder, Obstacle

FIXTURES = Path(__file__).parents[2] / "fixtures"
SHORT_S = 3.0
Once = Callable[[str, Callable[[Path], Any]], Any]
"""See tests/conftest.py."""


def fixture_request(run: Path, **options: object) -> ReplayRequest:
    """The committed recording's first seconds, into the folder `run`."""
    config = load_config(FIXTURES / "follow.toml", environ={})
    chosen = replace(ReplayOptions(duration_s=SHORT_S), **options)  # type: ignore[arg-type]
    return ReplayRequest(FIXTURES / "follow.mcap", run, config, chosen)


@pytest.fixture(scope="session")
def fixtures() -> Path:
    """Where the committed recording is."""
    return FIXTURES


@dataclass(frozen=True)
class CommandResult:
    """What a user gets from `quadlog replay`: the exit code, stderr, and the run folder."""

    code: int
    err: str
    run: Path

    def record(self) -> dict[str, Any]:
        return json.loads((self.run / "run.json").read_text())

    def table(self, name: str) -> dict[str, Any]:
        return read_table(self.run, name)

    def warned(self) -> list[str]:
        return [line for line in self.err.splitlines() if line.startswith("warning: ")]


@pytest.fixture
def replay_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., CommandResult]:
    """`quadlog replay` in this process: it prints no traceback, and the run is finished where the exit code says so."""

    def go(recording: Path, *flags: str) -> CommandResult:
        code = run_cli(["replay", str(recording), "-o", str(tmp_path / "runs"), *flags])
        err = capsys.readouterr().err
        assert "Traceback" not in err
        result = CommandResult(code, err, tmp_path / "runs" / recording.stem)
        assert is_finished(result.run) == (code in (0, 3))
        return result

    return go


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """A replay draws nothing, which takes most of a short one's time."""
    monkeypatch.setattr("quadlog.pipelines.stages.report.write_plots", lambda run, drawings: None)


@pytest.fixture(scope="session")
def from_obstacle() -> Callable[[Obstacle, np.ndarray], np.ndarray]:
    """How far places (N, 2) are from an obstacle, 0 inside of it."""

    def distance_m(obstacle: Obstacle, places_m: np.ndarray) -> np.ndarray:
        away_m = places_m - [obstacle.x_m, obstacle.y_m]
        if isinstance(obstacle, Cylinder):
            return np.maximum(np.linalg.norm(away_m, axis=1) - obstacle.radius_m, 0)
        cos, sin = np.cos(obstacle.yaw_rad), np.sin(obstacle.yaw_rad)
        own_m = np.abs(away_m @ np.array([[cos, -sin], [sin, cos]]))
        return np.linalg.norm(np.maximum(own_m - np.array([obstacle.length_m, obstacle.width_m]) / 2, 0), axis=1)

    return distance_m


class InTurn(deque[tuple[Future[Any], Callable[[], Any]]]):
    """Workers of this process, where a test can replace functions: a task is done when nothing else is to be read."""

    def __init__(self) -> None:
        self._came: SimpleQueue[Any] = SimpleQueue()
        self.put = self._came.put

    def submit(self, call: Callable[..., Any], *args: Any) -> Future[Any]:
        self.append((Future(), partial(call, *args)))
        return self[-1][0]

    def stop(self) -> None:
        while self:
            self.pop()[0].cancel()

    def get(self, timeout: float) -> Any:
        while self._came.empty():
            future, call = self.popleft()
            try:
                future.set_result(call())
            except BaseException as error:
                future.set_exception(error)
        return self._came.get()


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Runs a batch's recordings in this process, one after the other."""

    @contextmanager
    def open_executor(jobs: int, scheduler: str | None) -> Iterator[Workers]:
        workers = InTurn()
        send_to(workers.put)
        yield Workers(workers.submit, workers, workers.stop, lambda: 1)  # type: ignore[arg-type]

    monkeypatch.setattr(batch, "open_executor", open_executor)
    yield
    send_to(None)


@pytest.fixture(scope="session")
def follow_request() -> Callable[..., ReplayRequest]:
    """Makes requests to replay the committed recording's first seconds into a folder."""
    return fixture_request


@dataclass(frozen=True)
class Lias:
    """A real recording of three tags on a trolley: its folder, and where on the trolley the tags are."""

    folder: Path
    anchors_m: np.ndarray
    levers_m: np.ndarray

    def config(self, robot: int) -> Config:
        """With one of the tags as the robot's."""
        anchors = [{"id": i, "x_m": x, "y_m": y, "z_m": z} for i, (x, y, z) in enumerate(self.anchors_m.tolist())]
        tags = [
            {"id": i, "role": "robot" if i == robot else "none", "height_m": 0.97, "x_m": x, "y_m": y}
            for i, (x, y) in enumerate(self.levers_m.tolist())
        ]
        return Config.model_validate({"uwb": {"anchors": anchors, "tags": tags}})


@pytest.fixture(scope="session")
def lias(lias_site: SimpleNamespace) -> Lias:
    return Lias(lias_site.folder, lias_site.anchors_m, lias_site.levers_m[:, :2])


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
            found[name] = None if name == "report.html" else path.read_bytes()
    return found


@pytest.fixture(scope="session")
def saved() -> Callable[[Path], dict[str, object]]:
    """See results_of."""
    return results_of


@pytest.fixture(scope="session")
def season(once: Once) -> Path:
    """Three recordings of the same second in the three containers, and a file that is no recording."""

    def make(folder: Path) -> Path:
        recording = make_recording("follow", seed=1, duration_s=1.0, azimuth_steps=90)
        for suffix in ("mcap", "bag", "db3"):
            synthesize(recording, folder / f"walk.{suffix}")
        (folder / "broken.bag").write_text("not a bag at all")
        return folder

    return once("season", make)


@pytest.fixture(scope="session")
def season_config() -> Config:
    """The anchors of `season`, and its ground truth."""
    rows = [(0, 1.0, 1.0, 1.15), (1, 20.0, 1.2, 1.2), (2, 17.5, 15.8, 1.26), (3, 1.2, 14.8, 1.22)]
    anchors = ", ".join(f"{{id={i}, x_m={x}, y_m={y}, z_m={z}}}" for i, x, y, z in rows)
    settings = ["topics.reference=/truth/robot/pose", "simulation.controller=kinematic"]
    return load_config(None, [f"uwb.anchors=[{anchors}]", *settings], {})


@pytest.fixture(scope="session")
def planned(season: Path, season_config: Config) -> Callable[..., list[Planned]]:
    """Plans to replay all of `season`, or what of it is named, into a folder, without plots."""

    def plan(output: Path, *names: str, until: str = "ingest", existing: Existing = Existing.REFUSE) -> list[Planned]:
        arguments = [str(season / name) for name in names] or [str(season)]
        options = ReplayOptions(until=until)
        return plan_batch(arguments, output, season_config, options, existing, ("quadlog",), plots=False)

    return plan


@pytest.fixture(scope="session")
def replayed_season(planned: Callable[..., list[Planned]], once: Once) -> Path:
    """All of `season` until positions, one after the other in a worker; not to be changed."""

    def make(output: Path) -> Path:
        batch.replay_batch(planned(output, until="position"), 1, None, BatchLines([].append))
        return output

    return once("replayed", make)


@pytest.fixture(scope="session")
def located_run(once: Once) -> ReplayOutcome:
    """The same seconds as far as positions; not to be changed."""
    return once("located", lambda runs: replay(fixture_request(runs / "follow", until="position"), Silent()))


@pytest.fixture(scope="session")
def cut() -> Callable[..., Path]:
    """Copies an MCAP file's beginning: (source, target, seconds, keep(schema name, topic), changed(n, data))."""

    def copy(
        source: Path,
        target: Path,
        seconds: float,
        keep: Callable[[str, str], bool],
        changed: Callable[[int, bytes], bytes] = lambda _, data: data,
    ) -> Path:
        with source.open("rb") as read, target.open("wb") as written:
            writer, channels = Writer(written), {}
            writer.start()
            reader = make_reader(read)
            end_ns = reader.get_summary().statistics.message_start_time + int(seconds * 1e9)
            kept = (each for each in reader.iter_messages(ending_before=end_ns) if keep(each[0].name, each[1].topic))
            for count, (schema, channel, message) in enumerate(kept):
                if channel.id not in channels:
                    known = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known)
                data = changed(count, message.data)
                writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
            writer.finish()
        return target

    return copy


@pytest.fixture(scope="session")
def short_run(once: Once) -> ReplayOutcome:
    return once("short", lambda runs: replay(fixture_request(runs / "follow"), Silent()))


@pytest.fixture(scope="session")
def whole_run(once: Once) -> ReplayOutcome:
    return once("whole", lambda runs: replay(fixture_request(runs / "follow", duration_s=None), Silent()))
