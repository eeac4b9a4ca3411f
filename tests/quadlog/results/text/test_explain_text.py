from __future__ import annotations

import pytest

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.text.metrics import RunAtWorst, WorstInstant, explain_text


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_metric_can_be_explained(name: str) -> None:
    text = explain_text(name, [])
    entry = CATALOGUE[name]
    for what in (name, entry.meaning, entry.formula, entry.source, entry.counted):
        assert what in text
    assert max(map(len, text.splitlines())) <= 120


def test_runs_with_without_and_without_samples() -> None:
    instants = [
        WorstInstant(1_700_000_000_500_000_000, 0.5, 0.052),
        WorstInstant(1_700_000_002_000_000_000, 2.0, -0.01),
    ]
    runs = [
        RunAtWorst("a\x1b", 0.0075, 596, instants),
        RunAtWorst("b", None, 0, ()),
        RunAtWorst("c", 1.0, 3, (), "at no instant bad"),
    ]
    text = explain_text("cross_track_rmse_m", runs)
    assert "a\N{REPLACEMENT CHARACTER}: 0.0075 m, n = 596; worst, at least 1 s apart:" in text
    assert "  1700000000500000000         0.500     0.052\n  1700000002000000000         2.000     -0.01\n" in text
    assert "b: has no such metric" in text
    assert "c: 1 m, n = 3; at no instant bad" in text
