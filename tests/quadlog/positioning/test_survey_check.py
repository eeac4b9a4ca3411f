from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.positioning import anchor_survey as survey_check
from quadlog.positioning.anchor_survey import MATTERS_M, AnchorShift, SurveyCheck, TagEpochs, check_survey
from quadlog.positioning.epochs import Epochs, group_epochs

ANCHORS_M = np.array(
    [[0.0, 0.0, 1.2], [8.0, 1.0, 2.2], [7.0, 7.0, 1.2], [1.0, 5.0, 2.2], [4.0, -1.5, 1.2], [3.0, 8.0, 1.8]]
)
BIAS_M = np.array([0.25, 0.0, 0.1, 0.18, 0.3, 0.12])


def log_of(lab, seed: int, walk=None, **options) -> TagEpochs:
    options = {"duration_s": 30, "rate_hz": 8, "bursts": True, "bias_m": BIAS_M} | options
    simulated = lab.simulate(walk or lab.walk_figure_eight, ANCHORS_M, seed, **options)
    return TagEpochs(Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m), lab.TAG_HEIGHT_M)


def check(anchors_m: Float, *logs: TagEpochs) -> SurveyCheck:
    return check_survey(logs, anchors_m, 0.1, 1.0)


def moved(anchors_m: Float, anchor: int, x_m: float, y_m: float) -> Float:
    """Configured so far from where it is."""
    other_m = anchors_m.copy()
    other_m[anchor, :2] += x_m, y_m
    return other_m


def test_a_true_survey_raises_no_alarm(lab):
    for seed in range(3):
        got = check(ANCHORS_M, log_of(lab, seed))
        assert got.consistent
        assert got.checked
        assert got.reason == ""
        assert (got.detectable_m >= MATTERS_M).all()
        assert (got.detectable_m < 1.0).all()


@pytest.mark.parametrize(
    ("x_m", "std_m", "second_x_m", "named"),
    [
        (0.5, 0.10, 0.0, [2]),
        (0.5, 0.20, 0.0, []),  # 2.5 std
        (0.25, 0.05, 0.0, []),  # does not matter
        (0.5, 0.10, 0.45, [2, 4]),  # 5 and 4.5 std: as likely
        (0.5, 0.10, 0.35, [2]),
        (2.0, 0.40, 0.0, []),  # not placed
    ],
)
def test_what_is_named(lab, monkeypatch, x_m, std_m, second_x_m, named):
    found = {2: (x_m, std_m), 4: (second_x_m, 0.1)}

    def fit(log, anchors_m, anchor, *_):
        along_m, along_std_m = found.get(anchor, (0.0, 0.1))
        return AnchorShift(np.array([along_m, 0.0]), along_std_m**2 * np.eye(2), 60.0)

    monkeypatch.setattr(survey_check, "fit_anchor_shift", fit)
    got = check(ANCHORS_M, log_of(lab, 0))
    assert [each.anchor for each in got.shifted] == named
    assert got.detectable_m[0] == pytest.approx(0.32)


@pytest.mark.parametrize(("anchor", "x_m", "y_m"), [(0, 0.7, 0.0), (3, 0.0, -0.7), (4, 1.5, 2.0)])
def test_a_shifted_anchor_is_named_and_placed(lab, anchor, x_m, y_m):
    got = check(moved(ANCHORS_M, anchor, x_m, y_m), log_of(lab, 1))
    assert [each.anchor for each in got.shifted] == [anchor]
    assert not got.swapped
    assert got.checked
    shifted = got.shifted[0]
    error_m = shifted.place_m - ANCHORS_M[anchor, :2]
    assert np.hypot(*error_m) < 0.3
    assert error_m @ np.linalg.solve(shifted.covariance_m2, error_m) < 9.2  # 99 % of two degrees of freedom
    np.testing.assert_allclose(shifted.shift_m, [-x_m, -y_m], atol=0.3)
    assert shifted.distance_m == pytest.approx(np.hypot(x_m, y_m), abs=4 * shifted.distance_std_m)


def test_swapped_anchors_are_named_before_any_shift(lab):
    got = check(ANCHORS_M[[0, 4, 2, 3, 1, 5]], log_of(lab, 2))
    assert got.swapped == ((1, 4),)
    assert not got.shifted
    assert not got.consistent
    assert not got.checked
    assert np.isinf(got.detectable_m).all()


def test_renumbered_anchors(lab):
    got = check(np.roll(ANCHORS_M, 1, axis=0), log_of(lab, 3))
    assert got.turned == (1,)
    assert not got.consistent


def test_a_large_shift_does_not_pass_for_a_swap(lab):
    """With four anchors a swap explains half of it; the displacement explains all."""
    four_m = lab.SQUARE_M
    for seed, anchor in ((0, 0), (1, 2)):
        simulated = lab.simulate(lab.walk_figure_eight, four_m, seed, duration_s=30, rate_hz=8)
        log = TagEpochs(Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m), lab.TAG_HEIGHT_M)
        got = check(moved(four_m, anchor, 2.5, 2.5), log)
        assert not got.swapped
        assert anchor in [each.anchor for each in got.shifted]


def test_names_follow_the_order_of_anchors(lab):
    log, order = log_of(lab, 4), np.array([5, 2, 0, 1, 4, 3])
    wrong_m = moved(ANCHORS_M, 2, -0.6, 0.6)
    straight = check(wrong_m, log).shifted
    epochs = Epochs(log.epochs.t_ns, log.epochs.last_ns, log.epochs.range_m[:, order])
    mixed = check(wrong_m[order], TagEpochs(epochs, log.height_m)).shifted
    assert [order[each.anchor] for each in mixed] == [each.anchor for each in straight] == [2]
    np.testing.assert_allclose(mixed[0].shift_m, straight[0].shift_m, atol=5e-3)


def test_tags_are_weighed_together(lab):
    """A tag that heard an anchor from afar and one that walked about: what the second knows counts."""
    far = log_of(lab, 5, lambda t_s: np.array([4.0, 3.0]) + 0.3 * np.column_stack([np.sin(t_s / 2), np.cos(t_s / 2)]))
    near = log_of(lab, 6)
    wrong_m = moved(ANCHORS_M, 3, 0.5, -0.5)
    one, both, turned = check(wrong_m, near), check(wrong_m, far, near), check(wrong_m, near, far)
    assert [each.anchor for each in both.shifted] == [3]
    np.testing.assert_allclose(both.shifted[0].shift_m, one.shifted[0].shift_m, atol=0.1)
    np.testing.assert_allclose(both.shifted[0].shift_m, turned.shifted[0].shift_m, rtol=1e-9)


def test_a_standing_tag_accuses_nobody(lab):
    for anchors_m in (ANCHORS_M, moved(ANCHORS_M, 3, 0.5, -0.5)):
        got = check(
            anchors_m,
            log_of(
                lab,
                7,
                lambda t_s: np.tile([3.0, 3.0], (len(t_s), 1)),
            ),
        )
        assert got.consistent
        assert not got.checked
        assert got.reason == "the tags stood still"


@pytest.mark.parametrize(
    ("n_anchors", "duration_s", "reason"),
    [(3, 30, "3 of 6 anchors were heard"), (6, 4, "32 epochs have 4 ranges"), (6, 12, "12 s of ranges")],
)
def test_what_cannot_be_checked_says_why(lab, n_anchors, duration_s, reason):
    log = log_of(lab, 8, duration_s=duration_s)
    log.epochs.range_m[:, n_anchors:] = np.nan
    got = check(ANCHORS_M, log)
    assert not got.checked
    assert got.consistent
    assert got.reason.startswith(reason)
    assert np.isinf(got.detectable_m).all()


def test_no_tag_and_an_empty_log():
    none = np.empty(0, dtype=np.int64)
    for logs in ((), (TagEpochs(Epochs(none, none, np.empty((0, 6))), 0.6),)):
        got = check(ANCHORS_M, *logs)
        assert not got.checked
        assert got.reason.startswith("0 of 6 anchors")


@pytest.fixture(scope="module")
def trolley_logs(trolley) -> list[TagEpochs]:
    return [TagEpochs(group_epochs(trolley.series, tag, np.arange(8), 0.05), 0.97) for tag in range(3)]


def test_the_trolleys_survey_is_right(trolley, trolley_logs):
    """Real biases of 0.1 to 0.3 m and real reflections: each tag and all together find nothing."""
    for logs in (trolley_logs, *([log] for log in trolley_logs)):
        got = check(trolley.anchors_m, *logs)
        assert got.checked
        assert got.consistent
        assert (got.detectable_m < 0.45).all()


@pytest.mark.parametrize("anchor", range(8))
def test_half_a_metre_on_a_real_anchor_is_named(trolley, trolley_logs, anchor):
    angle = np.radians(77 * anchor)
    got = check(moved(trolley.anchors_m, anchor, 0.5 * np.cos(angle), 0.5 * np.sin(angle)), trolley_logs[0])
    assert [each.anchor for each in got.shifted] == [anchor]
    assert np.hypot(*(got.shifted[0].place_m - trolley.anchors_m[anchor, :2])) < 0.2


@pytest.mark.parametrize("pair", [(0, 1), (2, 6)])
def test_two_real_anchors_swapped_are_named_by_one_tag(trolley, trolley_logs, pair):
    order = np.arange(8)
    order[list(pair)] = pair[::-1]
    got = check(trolley.anchors_m[order], trolley_logs[1])
    assert got.swapped == (pair,)
    assert not got.turned
