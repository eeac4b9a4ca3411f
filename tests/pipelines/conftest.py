"""One short replay of the committed recording, shared by the tests that only look at it; and what makes two alike."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.metrics.catalogue import THEMES
from quadlog.pipelines.batch import batch
from quadlog.pipelines.batch.plan import plan_batch
from quadlog.pipelines.executor.pool import Workers
from quadlog.pipelines.executor.progress import BatchLines, Silent, send_to
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.simulation.synthesize import make_recording
from quadlog.simulation.synthetic.ros_encoding import ENCODED, RosEncoder
from tests.lab.recordings import written

FIXTURES = Path(__file__).parents[2] / "fixtures"
SHORT_S = 3.0
Once = Callable[[str, Callable[[Path], Any]], Any]
"""See tests/conftest.py."""


def fixture_request(run: Path, **options: object) -> ReplayRequest:
    """The committed recording's first seconds, into the folder `run`."""
    config = load_config(FIXTURES / "follow.toml")
    chosen = replace(ReplayOptions(duration_s=SHORT_S), **options)  # type: ignore[arg-type]
    return ReplayRequest(FIXTURES / "follow.mcap", run, config, chosen)


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
            columns = [
                column for column in table.column_names if column not in TIMINGS and not column.startswith("us_")
            ]
            timed = len(columns) != len(table.column_names)
            found[name] = table.select(columns) if timed else path.read_bytes()
        elif name == "run.json":
            record = json.loads(path.read_text())
            found[name] = {key: value for key, value in record.items() if key not in RUN_OWN}
        elif name == "metrics.json":
            found[name] = {
                key: each for key, each in json.loads(path.read_text()).items() if key not in THEMES["Computing"]
            }
        else:
            found[name] = None if name == "report.html" else path.read_bytes()
    return found


@pytest.fixture(scope="session")
def season(once: Once) -> Path:
    """Three recordings of the same second in the three containers, and a file that is no recording."""

    def make(folder: Path) -> Path:
        recording = make_recording("follow", seed=1, duration_s=1.0, azimuth_steps=90)
        encoder = RosEncoder()
        messages = [
            (each.topic, each.log_time_ns, ENCODED[type(each.message)][0], encoder.encode(each.message))
            for each in recording.messages()
        ]
        for suffix in ("mcap", "bag", "db3"):
            written(folder / f"walk.{suffix}", messages)
        (folder / "broken.bag").write_text("not a bag at all")
        return folder

    return once("season", make)


@pytest.fixture(scope="session")
def season_config() -> Config:
    """The anchors of `season`, and its ground truth."""
    rows = [(0, 1.0, 1.0, 1.15), (1, 20.0, 1.2, 1.2), (2, 17.5, 15.8, 1.26), (3, 1.2, 14.8, 1.22)]
    anchors = ", ".join(f"{{id={i}, x_m={x}, y_m={y}, z_m={z}}}" for i, x, y, z in rows)
    settings = ["topics.reference=/truth/robot/pose", "simulation.controller=kinematic"]
    return load_config(None, [f"uwb.anchors=[{anchors}]", *settings])


@pytest.fixture(scope="session")
def planned(season: Path, season_config: Config) -> Callable[..., list[ReplayRequest]]:
    """Plans to replay all of `season`, or what of it is named, into a folder, without plots."""

    def plan(
        output: Path, *names: str, until: str = "ingest", existing: Existing = Existing.REFUSE
    ) -> list[ReplayRequest]:
        arguments = [str(season / name) for name in names] or [str(season)]
        options = ReplayOptions(until=until)
        return plan_batch(arguments, output, season_config, options, existing, ("quadlog",), plots=False)

    return plan


@pytest.fixture(scope="session")
def replayed_season(planned: Callable[..., list[ReplayRequest]], once: Once) -> Path:
    """All of `season` until positions, one after the other in a worker; not to be changed."""

    def make(output: Path) -> Path:
        batch.replay_batch(planned(output, until="position"), 1, None, BatchLines([].append))
        return output

    return once("replayed", make)


def undrawn(run: Path, **options: object) -> ReplayRequest:
    return replace(fixture_request(run, **options), plots=False)


@pytest.fixture(scope="session")
def located_run(once: Once) -> ReplayOutcome:
    """The same seconds as far as positions; not to be changed."""
    return once("located", lambda runs: replay(undrawn(runs / "follow", until="position"), Silent()))


@pytest.fixture(scope="session")
def short_run(once: Once) -> ReplayOutcome:
    return once("short", lambda runs: replay(fixture_request(runs / "follow"), Silent()))


@pytest.fixture(scope="session")
def whole_run(once: Once) -> ReplayOutcome:
    return once("whole", lambda runs: replay(undrawn(runs / "follow", duration_s=None), Silent()))


def cut(
    source: Path,
    target: Path,
    seconds: float,
    keep: Callable[[str, str], bool],
    changed: Callable[[int, bytes], bytes] = lambda _, data: data,
) -> Path:
    """Copies an MCAP file's beginning: messages to keep by schema and topic, the n-th one's data changed."""
    with source.open("rb") as read, target.open("wb") as written:
        writer, channels, reader = Writer(written), {}, make_reader(read)
        writer.start()
        end_ns = reader.get_summary().statistics.message_start_time + int(seconds * 1e9)
        early = (each for each in reader.iter_messages() if each[2].log_time < end_ns)
        kept = (each for each in early if keep(each[0].name, each[1].topic))
        for count, (schema, channel, message) in enumerate(kept):
            if channel.id not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known)
            data = changed(count, message.data)
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
        writer.finish()
    return target
