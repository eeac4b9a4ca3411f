"""Through `locate`, where the choices of dimension, side and method come together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.errors import AnchorsCollinear, MissingInput, UnknownName
from quadlog.positioning.fix.trilateration import METHODS
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, TagResult, locate

SETTINGS = LocateSettings(calibrate=False)
TOWERS_M = np.array([[0.0, 0, 0.3], [8, 0, 3.0], [8, 7, 0.3], [0, 7, 3.0], [4, -1, 3.0], [4, 8, 0.3]])
ROW_M = np.array([[0.0, 0, 1.2], [4, 0, 1.2], [9, 0, 1.2]])


def anchors_at(position_m: np.ndarray) -> Anchors:
    return Anchors(np.arange(len(position_m)), position_m, np.zeros(len(position_m)))


def locate_one(lab, walk, anchors_m: np.ndarray, settings: LocateSettings, height_m: float = 0.6) -> tuple:
    simulated = lab.simulate(walk, anchors_m, seed=11)
    located: TagResult = locate(simulated.series, anchors_at(anchors_m), [TagInfo(0, height_m)], settings).tags[0]
    return simulated, located


def test_a_wrong_height_does_no_harm_where_the_anchors_tell_it(lab) -> None:
    simulated, found = locate_one(lab, lab.walk_figure_eight, TOWERS_M, SETTINGS, height_m=1.1)
    assert found.height_solved
    assert np.median(found.fixes.z_m) == pytest.approx(lab.TAG_HEIGHT_M, abs=0.05)
    # The track also estimates a bias that all links share, which a wrong height looks like at first.
    assert np.median(found.track.z_m) == pytest.approx(lab.TAG_HEIGHT_M, abs=0.1)
    assert found.track.z_std_m.max() < 0.5
    _, believed = locate_one(lab, lab.walk_figure_eight, TOWERS_M, replace(SETTINGS, height="given"), height_m=1.1)
    assert not believed.height_solved
    assert (believed.fixes.z_m == 1.1).all()
    truth_m = simulated.truth_at(found.track.t_ns)
    assert lab.rmse(found.track.position_m - truth_m) < 0.8 * lab.rmse(believed.track.position_m - truth_m)


def test_anchors_at_one_height_tell_none(lab) -> None:
    _, found = locate_one(lab, lab.walk_figure_eight, lab.SQUARE_M, SETTINGS)
    assert not found.height_solved
    assert (found.track.z_std_m == 0).all()


def test_a_height_solved_for_takes_four_ranges(lab) -> None:
    simulated = lab.simulate(lab.walk_straight, TOWERS_M, seed=2)
    three = simulated.series
    keep = (three.anchor < 3) | (three.t_ns > simulated.t_ns[300])
    ranges = replace(
        three, t_ns=three.t_ns[keep], tag=three.tag[keep], anchor=three.anchor[keep], range_m=three.range_m[keep]
    )
    settings = replace(SETTINGS, height="solved")
    found = locate(ranges, anchors_at(TOWERS_M), [TagInfo(0, 0.6)], settings).tags[0]
    assert found.n_too_few == 301


def walk_beside(t_s: np.ndarray) -> np.ndarray:
    """From 2 m left of the row of anchors to 4 m, and back."""
    return np.stack([2 + 0.4 * t_s, 3 + np.cos(t_s / 2)], axis=1)


@pytest.mark.parametrize(("side", "sign"), [("left", 1), ("right", -1)])
def test_anchors_on_a_line_give_the_side_that_was_asked_for(lab, side: str, sign: int) -> None:
    simulated, found = locate_one(lab, walk_beside, ROW_M, replace(SETTINGS, mirror=side))
    expected_m = simulated.truth_at(found.track.t_ns) * [1, sign]
    assert lab.rmse(found.track.position_m - expected_m) < 0.1
    fixed = found.fixes.solved
    assert fixed.mean() > 0.95
    assert lab.rmse(found.fixes.position_m[fixed] - simulated.position_m[fixed] * [1, sign]) < 0.3


def test_without_a_side_they_are_refused(lab) -> None:
    with pytest.raises(AnchorsCollinear, match=r"uwb\.mirror"):
        locate_one(lab, walk_beside, ROW_M, SETTINGS)
    with pytest.raises(MissingInput):
        locate_one(lab, walk_beside, ROW_M[:2], replace(SETTINGS, mirror="left"))


def test_methods_differ_and_an_unknown_one_is_named(lab) -> None:
    makes = set()
    for method in METHODS:
        simulated, found = locate_one(lab, lab.walk_figure_eight, lab.SQUARE_M, replace(SETTINGS, method=method))
        assert found.fixes.solved.all()
        assert lab.rmse(found.fixes.position_m - simulated.position_m) < 0.16
        makes.add(found.fixes.position_m.tobytes())
    assert len(makes) == len(METHODS)
    with pytest.raises(UnknownName, match="huber"):
        locate_one(lab, lab.walk_straight, lab.SQUARE_M, replace(SETTINGS, method="best"))
