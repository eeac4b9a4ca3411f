from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.anchor_survey import MAX_EPOCHS, TagEpochs, find_exchanges, layout_misfit, thin_rows
from quadlog.positioning.epochs import Epochs

IRREGULAR_M = np.array([[0.0, 0.0, 1.2], [8.0, 1.0, 1.2], [7.0, 7.0, 1.2], [1.0, 5.0, 1.2], [4.0, -1.5, 1.2]])


def log_of(lab, anchors_m, seed: int, walk=None, **options) -> TagEpochs:
    options = {"duration_s": 30, "rate_hz": 10, "bursts": True, "bias_m": 0.15} | options
    simulated = lab.simulate(walk or lab.walk_figure_eight, anchors_m, seed, **options)
    return TagEpochs(Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m), lab.TAG_HEIGHT_M)


def test_every_pair_is_named(lab):
    log = log_of(lab, IRREGULAR_M, 0)
    for i in range(5):
        for j in range(i + 1, 5):
            order = np.arange(5)
            order[[i, j]] = j, i
            got = find_exchanges([log], IRREGULAR_M[order], 0.1)
            assert (got.swapped, got.turned) == (((i, j),), ())


@pytest.mark.parametrize("step", [1, 2, 4])
def test_ids_that_all_moved_on(lab, step):
    """Named anchor i stands where anchor i + step is configured."""
    log = log_of(lab, IRREGULAR_M, 1)
    got = find_exchanges([log], IRREGULAR_M[(np.arange(5) - step) % 5], 0.1)
    assert (got.swapped, got.turned) == ((), (step,))


def test_nothing_is_named_where_nothing_is_wrong(lab):
    for seed in range(4):
        log = log_of(lab, IRREGULAR_M, seed)
        got = find_exchanges([log], IRREGULAR_M, 0.1)
        assert (got.swapped, got.turned) == ((), ())
        assert got.misfit == layout_misfit([log], IRREGULAR_M, 0.1)


def test_symmetry_hides_what_it_must(lab):
    """A swap across a square's diagonal mirrors it. In a rectangle that of one side looks like that of the other."""
    square_m = np.array([[0.0, 0.0, 1.2], [7.0, 0.0, 1.2], [7.0, 7.0, 1.2], [0.0, 7.0, 1.2]])
    got = find_exchanges([log_of(lab, square_m, 2)], square_m[[2, 1, 0, 3]], 0.1)
    assert (got.swapped, got.turned) == ((), ())
    oblong_m = square_m * [1.6, 1.0, 1.0]
    got = find_exchanges([log_of(lab, oblong_m, 3)], oblong_m[[1, 0, 2, 3]], 0.1)
    assert sorted(got.swapped) == [(0, 1), (2, 3)]


def test_several_tags_are_one_log(lab):
    logs = [log_of(lab, IRREGULAR_M, seed, duration_s=6) for seed in (4, 5)]
    n = [layout_misfit([log], IRREGULAR_M, 0.1) for log in logs]
    assert layout_misfit(logs, IRREGULAR_M, 0.1) == pytest.approx(np.mean(n))


def test_an_anchor_that_nobody_heard_is_no_part_of_an_exchange(lab):
    log = log_of(lab, IRREGULAR_M, 6)
    log.epochs.range_m[:, 4] = np.nan
    got = find_exchanges([log], IRREGULAR_M[[1, 0, 2, 3, 4]], 0.1)
    assert got.swapped[0] == (0, 1)
    assert all(4 not in pair for pair in got.swapped)


def test_misfit_of_no_epochs_is_unknown(lab):
    log = log_of(lab, IRREGULAR_M, 7)
    log.epochs.range_m[:, 3:] = np.nan
    assert np.isnan(layout_misfit([log], IRREGULAR_M, 0.1))


@pytest.mark.parametrize("n", [0, 1, MAX_EPOCHS, MAX_EPOCHS + 1, 5 * MAX_EPOCHS - 1])
def test_rows_are_thinned_evenly(n):
    usable = np.ones(2 * n, dtype=bool)
    usable[::2] = False
    rows = thin_rows(usable, MAX_EPOCHS)
    assert usable[rows].all()
    assert len(rows) <= MAX_EPOCHS
    assert len(rows) >= min(n, MAX_EPOCHS / 2)
    assert len(np.unique(np.diff(rows))) <= 1
