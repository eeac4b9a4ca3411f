from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from quadlog.results.compare.common_clock import not_comparable, open_runs
from quadlog.results.run.tables import TIMED


def test_runs_of_one_recording_share_its_clock(tiny_run: Path, other: Path, change: Callable[..., None]) -> None:
    for name in TIMED:
        change(other, name, t_ns=lambda t_ns: t_ns + 500_000_000)
    a, b, clock = open_runs((other, tiny_run))
    assert clock.is_shared
    assert a.start_ns == b.start_ns
    first = [float(run.seconds(run.table("poses")["t_ns"][:1])[0]) for run in (a, b)]  # type: ignore[index]
    assert first == pytest.approx([0.5, 0.0])
    assert list(not_comparable(a, b, clock)) == []


def test_a_run_without_instants_does_not_move_the_clock(tiny_run: Path, other: Path) -> None:
    for name in TIMED:
        (other / f"{name}.parquet").unlink()
    a, b, clock = open_runs((tiny_run, other))
    assert clock.is_shared
    assert np.array_equal([a.start_ns], [b.start_ns])
    assert float(a.seconds(a.table("poses")["t_ns"][:1])[0]) == 0.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("entries", "why"),
    [
        ({"options.stamp": "log"}, "their stamps are of different clocks: header in A, log in B"),
        ({"input.sha256": "cd" * 32}, "A and B are of different recordings"),
        ({"options.course": "line"}, "B is a simulated walk and A the replay of a recording"),
    ],
)
def test_other_runs_have_their_own_clocks(
    tiny_run: Path, other: Path, change_json: Callable[..., None], entries: dict[str, str], why: str
) -> None:
    change_json(other / "run.json", entries)
    a, b, clock = open_runs((tiny_run, other))
    assert (clock.is_shared, clock.why_not) == (False, why)
    (said,) = not_comparable(a, b, clock)
    assert said.lower().startswith(why.lower())
