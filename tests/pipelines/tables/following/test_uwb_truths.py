from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from quadlog.pipelines.tables.following.uwb_ranges import (
    PERSON,
    ROBOT,
    STATIONS_M,
    TAGS,
    distance_group,
    height_group,
    truth_group,
)
from quadlog.results.papers.table import PaperRow, RowGroup


def row(group: RowGroup, *words: str) -> PaperRow:
    (found,) = [each for each in group.rows if all(word in each.quantity for word in words)]
    return found


@pytest.mark.parametrize("tag", TAGS)
def test_the_fitted_truths_are_scipys(tag):
    def misses(place_m):
        return np.linalg.norm(place_m - STATIONS_M[:, :2], axis=1) - tag.distance_m

    fitted_m = least_squares(misses, [1.0, 0.5], xtol=1e-14).x
    group = truth_group()
    for axis, name in enumerate("xy"):
        got = row(group, f"{tag.name} tag, {name} (m)")
        assert got.paper == tag.printed_m[axis]
        assert got.ours == pytest.approx(fitted_m[axis], abs=2e-6)
        assert got.reproduces is False
        assert "Erratum" in got.note


def test_only_the_corrected_truths_fit_the_printed_distances():
    """The misses are those of the errata, each computed by hand from Pythagoras."""
    group = truth_group()
    expected = {
        ("robot", "as printed"): np.array([4.8, 0.8, 41.76**0.5]) - ROBOT.distance_m,
        ("robot", "other tag"): np.array([3.2, 0.8, 36.64**0.5]) - ROBOT.distance_m,
        ("robot", "corrected"): np.array([6.4**0.5, 3.2**0.5, 5.2]) - ROBOT.distance_m,
        ("person", "as printed"): np.array([3.2, 0.8, 36.64**0.5]) - PERSON.distance_m,
        ("person", "other tag"): np.array([4.8, 0.8, 41.76**0.5]) - PERSON.distance_m,
        ("person", "corrected"): np.array([11.52**0.5, 8.32**0.5, 3.6]) - PERSON.distance_m,
    }
    for (tag, which), miss_m in expected.items():
        got = row(group, f"{tag} tag at", which)
        assert got.ours == pytest.approx(np.sqrt(np.mean(miss_m**2)), abs=1e-12)
        assert got.paper is None
        assert ("Erratum" in got.note) == (which != "corrected")
        assert (got.ours < 0.03) == (which == "corrected")


def test_one_printed_distance_is_wrong():
    rows = distance_group().rows
    assert len(rows) == 6
    assert [each.reproduces for each in rows] == [True] * 5 + [False]
    assert rows[5].ours == pytest.approx(3.6, abs=1e-12)
    assert rows[5].paper == 3.55
    assert "3.60" in rows[5].note


def test_a_forgotten_height_costs_the_direct_fit_alone():
    group = height_group()
    ignored = row(group, "height ignored, Gauss-Newton", "mean")
    assert ignored.ours == pytest.approx(0.065, abs=0.003)
    assert row(group, "height ignored, Gauss-Newton", "largest").ours > 0.3
    for which in ("height ignored, linear", "height known, Gauss-Newton"):
        assert row(group, which, "largest").ours <= 1e-6
        assert row(group, which, "largest").note == ""


def test_the_cost_of_a_forgotten_height_is_scipys():
    """At one place, by an optimizer we did not write."""
    place_m = np.array([3.0, 0.5])
    slant_m = np.hypot(np.linalg.norm(place_m - STATIONS_M[:, :2], axis=1), 0.6)
    fitted_m = least_squares(lambda p: np.linalg.norm(p - STATIONS_M[:, :2], axis=1) - slant_m, place_m).x
    off_m = np.linalg.norm(fitted_m - place_m)
    assert 0.01 < off_m < row(height_group(), "height ignored, Gauss-Newton", "largest").ours
