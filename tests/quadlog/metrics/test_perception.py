from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.lidar.classified_scan import PointClass
from quadlog.metrics.perception import Detection, detect, ground_detection

GROUND, OBSTACLE, FALSE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE), np.uint8(PointClass.OUTLIER)
CROPPED, INVALID = np.uint8(PointClass.CROPPED), np.uint8(PointClass.INVALID)


def test_counts_of_a_case_done_by_hand():
    is_true = np.array([[1, 1, 1, 0], [0, 0, 0, 0]], bool)
    is_called = np.array([[1, 0, 1, 1], [0, 0, 0, 1]], bool)
    made = detect(is_true, is_called)
    assert made == Detection(n_all=8, n_true=3, n_called=4, n_found=2)
    assert made.n_false == 2
    assert (made.recall, made.precision, made.lost) == (2 / 3, 2 / 4, 2 / 5)


def test_what_is_not_there_has_no_share():
    nothing = detect(np.zeros(4, bool), np.zeros(4, bool))
    assert math.isnan(nothing.recall)
    assert math.isnan(nothing.precision)
    assert nothing.lost == 0.0
    everything = detect(np.ones(4, bool), np.ones(4, bool))
    assert (everything.recall, everything.precision) == (1.0, 1.0)
    assert math.isnan(everything.lost)


def test_scans_are_pooled_by_their_counts_not_by_their_shares():
    few = detect(np.array([1, 0], bool), np.array([1, 1], bool))
    many = detect(np.ones(8, bool), np.zeros(8, bool))
    assert few + many == Detection(10, 9, 2, 1)
    assert (few + many).recall == 1 / 9


def test_different_shapes_are_refused():
    with pytest.raises(ValueError, match=r"\(3,\).*\(4,\)"):
        detect(np.zeros(3, bool), np.zeros(4, bool))


def test_ground_is_compared_with_everything_else():
    truth = np.array([GROUND, GROUND, GROUND, OBSTACLE, FALSE, OBSTACLE])
    label = np.array([GROUND, OBSTACLE, FALSE, GROUND, GROUND, OBSTACLE])
    assert ground_detection(truth, label) == Detection(6, 3, 3, 1)


@given(arrays(np.bool_, 40), arrays(np.bool_, 40), st.integers(0, 40))
def test_parts_add_up_and_shares_are_those_of_sets(is_true, is_called, at):
    whole = detect(is_true, is_called)
    assert whole == detect(is_true[:at], is_called[:at]) + detect(is_true[at:], is_called[at:])
    wanted, got = set(np.flatnonzero(is_true)), set(np.flatnonzero(is_called))
    assert whole.n_false == len(got - wanted)
    if wanted:
        assert whole.recall == len(wanted & got) / len(wanted)
    if got:
        assert whole.precision == len(wanted & got) / len(got)
    if len(wanted) < 40:
        assert whole.lost == len(got - wanted) / (40 - len(wanted))
