from __future__ import annotations

import pytest

from quadlog.errors import UnknownName, WorkerDied
from quadlog.pipelines.executor.executor import side_by_side
from quadlog.pipelines.executor.progress import Kept


def test_results_come_in_the_order_of_the_tasks_with_what_each_said(tasks):
    kept = Kept()
    assert side_by_side(tasks.square_aloud, [3, 1, 2], 2, kept) == [9, 1, 4]
    assert sorted(kept.lines) == ["1 squared", "2 squared", "3 squared"]


def test_the_first_error_is_raised_once_all_others_are_done(tasks):
    kept = Kept()
    with pytest.raises(UnknownName) as caught:
        side_by_side(tasks.square_aloud, [1, -2, -1, 2], 2, kept)
    assert caught.value.name == "-2"
    assert sorted(kept.lines) == ["1 squared", "2 squared"]


def test_a_worker_that_dies_is_told(tasks):
    with pytest.raises(WorkerDied, match="killed by signal 9"):
        side_by_side(tasks.die_with, [9], 1, Kept())
