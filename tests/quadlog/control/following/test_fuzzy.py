from __future__ import annotations

import numpy as np
import pytest
import skfuzzy
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.following.lookahead import CORRECTED, PRINTED, SETS, infer

CENTRES = np.arange(-3.0, 4.0)
GRID = np.stack(np.meshgrid(np.linspace(-3, 3, 61), np.linspace(-3, 3, 61), indexing="ij")).reshape(2, -1)
# The textbook's fuzzy-PID table of delta K_d, rows e, columns ec.
TEXTBOOK_K_D = """
PS NS NB NB NB NM PS
PS NS NB NM NM NS ZO
ZO NS NM NM NS NS ZO
ZO NS NS NS NS NS ZO
ZO ZO ZO ZO ZO ZO ZO
PB NS PS PS PS PS PB
PB PM PM PM PS PS PB
"""
universe = st.floats(-3, 3)
rules = st.lists(st.integers(0, 6), min_size=98, max_size=98).map(
    lambda cells: np.array(cells, dtype=np.int64).reshape(2, 7, 7)
)


def clipped_sets(e, ec, rules_of_one):
    """(7,): how far each output set holds, over all 49 rules."""
    heights, of_e, of_ec = np.zeros(7), *(np.maximum(1 - np.abs(each - CENTRES), 0) for each in (e, ec))
    np.maximum.at(heights, rules_of_one, np.minimum(of_e[:, None], of_ec))
    return heights


WIDE = np.linspace(-3, 3, 601)
TRIANGLES = np.stack([skfuzzy.trimf(WIDE, [centre - 1, centre, centre + 1]) for centre in CENTRES])


@given(universe, universe, rules)
def test_both_centroids_against_all_49_rules_and_scikit_fuzzy(e, ec, tables):
    for output in range(2):
        heights = clipped_sets(e, ec, tables[output])
        points = np.sum(heights * CENTRES) / np.sum(heights)
        assert infer(e, ec, tables, "points")[output] == pytest.approx(points, abs=1e-12)
        area_centre = skfuzzy.centroid(WIDE, np.minimum(heights[:, None], TRIANGLES).max(axis=0))
        assert infer(e, ec, tables, "continuous")[output] == pytest.approx(area_centre, abs=1e-3)


def breaks_of_monotony(rules_of_one):
    """The cells without which no row and no column rises anywhere."""
    falls = (np.diff(rules_of_one, axis=0) <= 0).all() and (np.diff(rules_of_one, axis=1) <= 0).all()
    if falls:
        return []
    mended = []
    for i in range(7):
        for j in range(7):
            for k in range(7):
                other = rules_of_one.copy()
                other[i, j] = k
                if (np.diff(other, axis=0) <= 0).all() and (np.diff(other, axis=1) <= 0).all():
                    mended.append((SETS[i], SETS[j], SETS[k]))
    return mended


def test_what_is_wrong_with_the_printed_tables():
    assert breaks_of_monotony(PRINTED[0]) == [("NS", "PM", "NS"), ("NS", "PM", "ZO")]
    assert breaks_of_monotony(CORRECTED[0]) == []
    assert np.count_nonzero(PRINTED[0] != CORRECTED[0]) == 1
    textbook = np.array([[SETS.index(name) for name in row.split()] for row in TEXTBOOK_K_D.strip().splitlines()]).T
    assert np.count_nonzero(PRINTED[1] == textbook) == 44
    assert np.argwhere(CORRECTED[1] != textbook).tolist() == [[3, 3]]
    assert SETS[CORRECTED[1][3, 3]] == "ZO"
    assert (np.diff(CORRECTED[1][2:5], axis=1) >= 0).all()


def test_the_published_look_aheads():
    """l = 2 + k_v v^2 + k_w v at 0.5 m/s, over the whole universe."""
    weights = np.array([0.5**2, 0.5])
    grid = GRID.T.tolist()
    points, continuous = (np.array([infer(*at, PRINTED, each) for at in grid]) for each in ("points", "continuous"))
    look_aheads = 2 + continuous @ weights
    assert (look_aheads.min(), look_aheads.max()) == pytest.approx((0.917, 3.583), abs=5e-4)
    look_aheads = 2 + points @ weights
    assert (look_aheads.min(), look_aheads.max()) == (0.75, 3.75)
    for centroid in ("points", "continuous"):
        assert 2 + np.dot(infer(0, 0, PRINTED, centroid), weights) == pytest.approx(1.5)
        assert 2 + np.dot(infer(0, 0, CORRECTED, centroid), weights) == pytest.approx(2)
    apart = points - continuous
    assert np.abs(apart).max(axis=0) == pytest.approx([0.80, 1.11], abs=0.01)
    assert np.abs(apart @ weights).max() == pytest.approx(0.57, abs=0.005)
