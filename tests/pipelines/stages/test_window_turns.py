"""Windows: that together they are the recording, and that their scans come in order whoever is free when."""

from __future__ import annotations

import random
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.config_file import load_config
from quadlog.errors import NothingReadable, WorkerDied
from quadlog.pipelines.opening import open_configured
from quadlog.pipelines.stages import window_shares
from quadlog.pipelines.stages.parcel import pack, unpack
from quadlog.pipelines.stages.scans import ScanTally
from quadlog.pipelines.stages.window_helper import Answer, answer, help_with
from quadlog.pipelines.stages.window_shares import Shares, share
from quadlog.pipelines.stages.window_turns import GIVEN, HELD, Odd, SharedScans
from quadlog.pipelines.stages.windows import Seen, Window, cut
from quadlog.recordings.clock import Clock
from quadlog.simulation.synthesized import LIDAR_TOPIC

times_ns = st.integers(0, 2**62)
borders_ns = st.none() | times_ns


@given(span=st.tuples(times_ns, times_ns).map(sorted), whole=st.tuples(borders_ns, borders_ns), data=st.data())
def test_every_log_time_is_in_exactly_one_window_or_outside_the_whole(span, whole, data):
    windows = cut(Window(*whole), tuple(span), data.draw(st.integers(1, 40)))
    edges = [each for window in windows for each in window if each is not None]
    near = st.sampled_from([*span, *edges]).flatmap(lambda edge: st.integers(max(edge - 1, 0), edge + 1))
    t_ns = data.draw(near | times_ns)

    def holds(window: Window) -> bool:
        return (window[0] is None or t_ns >= window[0]) and (window[1] is None or t_ns < window[1])

    assert sum(holds(each) for each in windows) == holds(whole)


def test_windows_are_as_long_as_each_other():
    windows = cut(Window(None, None), (1_000, 1_999), 4)
    assert windows == [(None, 1250), (1250, 1500), (1500, 1750), (1750, None)]
    assert cut(Window(1_500, 1_600), (1_000, 1_999), 2) == [(1500, 1550), (1550, 1600)]


shapes = st.tuples(st.integers(0, 40), st.integers(0, 3))
arrays = st.builds(
    lambda shape, kind, order: np.asarray(np.arange(shape[0] * shape[1]).reshape(shape) % 251, dtype=kind, order=order),
    shapes,
    st.sampled_from(["u1", "f4", "f8"]),
    st.sampled_from("CF"),
)


@given(value=st.lists(st.tuples(arrays, st.integers(), st.none() | st.text())))
def test_a_parcel_gives_back_what_was_put_in_as_compiled_code_wants_it(value, tmp_path_factory):
    path = tmp_path_factory.mktemp("parcels") / "1"
    received = unpack(pack(value, path))
    assert [rest for _, *rest in received] == [rest for _, *rest in value]
    for (sent, *_), (got, *_) in zip(value, received, strict=True):
        np.testing.assert_array_equal(got, sent, strict=True)
        assert got.flags.writeable
        assert got.flags.aligned
        assert (got.flags.c_contiguous, got.flags.f_contiguous) == (sent.flags.c_contiguous, sent.flags.f_contiguous)
    assert not path.exists()


@dataclass
class Reader:
    """Windows that hold the numbers between their borders."""

    raises_in: int = -1
    last: tuple[int, int] = (0, 0)

    def read(self, window: Any) -> Any:
        self.last = window
        if window[0] <= self.raises_in < window[1]:
            raise NothingReadable(Path("r"), "for the test")
        yield from range(*window)

    def seen(self) -> Seen:
        tally = ScanTally()
        tally.routes["rings"] += self.last[1] - self.last[0]
        return Seen(tally, self.last[1] - self.last[0], Clock(Path("r"), "header"), True)


@dataclass
class Pool:
    """Helpers that begin, end, are late and die when a seed says so: whenever this process looks at them."""

    seed: int
    deaths: tuple[int, ...] = ()
    most_waiting: int = 0
    _waiting: list[tuple[Future, Callable[[], Any]]] = field(default_factory=list)
    _begun: list[tuple[Future, Callable[[], Any]]] = field(default_factory=list)
    _ended: int = 0

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def submit(self, call: Any, *args: Any) -> Future:
        pool = self

        class Looked(Future):
            def done(self) -> bool:
                pool.go_on()
                return super().done()

            def result(self, timeout: float | None = None) -> Any:
                while not super().done():
                    pool.go_on()
                return super().result()

        future = Looked()
        work = (lambda: True) if call is not help_with else (lambda: self._answer(*args))
        self._waiting.append((future, work))
        self.most_waiting = max(
            self.most_waiting, sum(not Future.done(each) for each, _ in self._waiting + self._begun)
        )
        return future

    def _not_done(self) -> int:
        return sum(not Future.done(each) for each, _ in self._waiting + self._begun)

    def go_on(self) -> None:
        if self._waiting and self._random.random() < 0.5:
            future, work = self._waiting.pop(0)
            if future.set_running_or_notify_cancel():
                self._begun.append((future, work))
        if self._begun and self._random.random() < 0.5:
            future, work = self._begun.pop(self._random.randrange(len(self._begun)))
            self._ended += 1
            if self._ended in self.deaths:
                future.set_exception(WorkerDied(-9))
            else:
                future.set_result(work())

    def _answer(self, window: Window) -> Answer:
        reader = Reader()
        scans = list(reader.read(window))
        return Answer(scans if len(scans) <= 9 else None, reader.seen())


@given(
    lengths=st.lists(st.integers(0, 12), min_size=1, max_size=30),
    helpers=st.integers(1, 4),
    seed=st.integers(0, 10**6),
    deaths=st.lists(st.integers(1, 12), max_size=2).map(tuple),
)
def test_scans_come_in_order_whoever_is_free_and_whoever_dies(lengths, helpers, seed, deaths):
    edges = np.concatenate([[0], np.cumsum(lengths)]).tolist()
    windows = [Window(*pair) for pair in pairwise(edges)]
    said, pool = [], Pool(seed, deaths)
    shares = Shares(windows, helpers, most_scans=9, n_clouds=edges[-1])
    scans = SharedScans(shares, Reader(), pool, Clock(Path("r"), "header"), said.append)
    assert list(scans.read()) == list(range(edges[-1]))
    assert scans.tally.routes["rings"] == edges[-1]
    assert pool.most_waiting <= max(GIVEN + 1, 2) * helpers + HELD
    assert len(said) <= len(deaths)


def test_a_window_with_too_many_scans_is_not_held():
    reader = Reader()
    assert answer(reader, Window(0, 9), 9).scans == list(range(9))
    assert answer(reader, Window(0, 1000), 9).scans is None


@given(raises_in=st.integers(0, 39), seed=st.integers(0, 10**6))
def test_an_error_or_a_wrong_number_of_clouds_is_odd(raises_in, seed):
    windows = [Window(first, first + 4) for first in range(0, 40, 4)]
    known = Clock(Path("r"), "header")
    for reader, n_clouds in ((Reader(raises_in), 40), (Reader(), 41)):
        scans = SharedScans(Shares(windows, 0, 9, n_clouds), reader, Pool(seed), known, print)
        with pytest.raises(Odd):
            list(scans.read())


@pytest.mark.parametrize("count", [2, 5])
def test_what_is_worth_it_depends_on_the_points_alone(count, recorded, monkeypatch):
    with open_configured(recorded("mcap"), load_config(None, [], {})) as recording:

        def shared(processes: int, method: str = "range_image", whole: Window = Window(None, None)) -> int:  # noqa: B008
            config = load_config(None, [f"lidar.method={method}"], {})
            source = SimpleNamespace(topic=LIDAR_TOPIC, around=SimpleNamespace(config=config))
            shares = share(source, recording, whole, processes)
            return 0 if shares is None else shares.helpers

        assert shared(8) == 0, "three seconds of thin scans are not"
        points = len(recording.sample(LIDAR_TOPIC, 1)[0].xyz_m) * 31
        monkeypatch.setattr(window_shares, "WORTH_S", points * 0.15e-6 / count * 0.99)
        assert shared(1) == 0
        assert shared(8) == count
        assert shared(count) == count - 1
        assert shared(99, "paper") == 4 * count
        start_ns, end_ns = recording.span_ns
        assert shared(99, whole=Window(start_ns, (start_ns + end_ns) // 2)) == count // 2
