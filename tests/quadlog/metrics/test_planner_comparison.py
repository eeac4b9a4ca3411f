from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats

from quadlog.metrics.intervals import corrected_confidence, fewest_values, median_interval
from quadlog.metrics.planning import Comparison, PlannerRow, compare_planners
from quadlog.results.studies.planners import PLANNERS

NAN = float("nan")


def compare(table: dict[str, Any], **options: Any) -> Comparison:
    return compare_planners(table, **options)


def row_of(comparison: Comparison, planner: str) -> PlannerRow:
    return next(row for row in comparison.rows if row.planner == planner)


def test_a_row_has_the_columns_of_planners_parquet() -> None:
    assert [field.name for field in fields(PlannerRow)] == PLANNERS.names


def test_by_hand(make_replans: Any) -> None:
    """Two episodes of four replans; ia_star fails one that costs it 900 cells, and starts anew three times."""
    table = make_replans(
        {"astar": [[100, 80, 60, 40], [90, 90, 90, 90]], "ia_star": [[100, 10, 900, 10], [45, 15, 15, 15]]},
        found={"ia_star": [[True, True, False, True], [True] * 4]},
        from_scratch={"ia_star": [[True, False, True, False], [True, False, False, True]]},
        cost={"ia_star": [[100, 110, NAN, 100], [100, 100, 100, 0]]},
        optimal_cost={"ia_star": [[100, 100, NAN, 100], [100, 100, NAN, 0]]},
        us={"ia_star": [[9, 1, 999, 2], [8, 3, 4, 5]]},
        length_m={"ia_star": [[1, 2, NAN, 3], [4, 5, 6, 7]]},
        turn_rad={"ia_star": [[0, 0, NAN, 1], [1, 1, 1, 1]]},
    )
    comparison = compare(table, incremental={"ia_star"})
    assert (comparison.paired_replans, comparison.paired_episodes) == (7, 2)
    row = row_of(comparison, "ia_star")
    assert (row.source, row.episodes, row.replans, row.success_rate) == ("maze", 2, 8, 7 / 8)
    # Work is counted over all replans, the failed one too.
    assert (row.expanded_total, row.generated_total, row.touched_total) == (1110, 2220, 8880)
    assert row.expanded_mean == 1110 / 8
    # Paired: (100 + 80 + 40) / (100 + 10 + 10), and 360 / 90.
    assert_allclose(comparison.ratios["ia_star"].of_episodes, [220 / 120, 4.0])
    assert row.ratio_expanded == pytest.approx((220 / 120 + 4) / 2)
    assert (row.ratio_low, row.ratio_high) == (None, None), "two episodes are too few"
    # Of five paths with an optimum above zero one is 10 % too dear.
    assert row.suboptimality_mean == pytest.approx(0.1 / 5)
    assert row.suboptimality_p95 == pytest.approx(0.08)
    assert row.fallback_share == 2 / 6
    assert row.us_median == 4
    assert row.us_p95 == pytest.approx(np.percentile([9, 1, 2, 8, 3, 4, 5], 95))
    assert (row.length_m_total, row.turn_rad_total) == (28, 5)
    astar = row_of(comparison, "astar")
    assert (astar.ratio_expanded, astar.ratio_low, astar.ratio_high) == (1, None, None)
    assert (astar.success_rate, astar.length_m_total, astar.fallback_share) == (1, 7, None)


@pytest.mark.parametrize("counted", ["expanded", "generated", "touched"])
def test_what_is_counted_can_be_chosen(make_replans: Any, counted: str) -> None:
    table = make_replans({"astar": [[60]], "ia_star": [[10]]}, generated={"astar": 60, "ia_star": 20})
    ratio = row_of(compare(table, counted=counted), "ia_star").ratio_expanded
    assert ratio == {"expanded": 6, "generated": 3, "touched": 6}[counted]


def test_an_episode_without_a_cell_has_no_ratio_and_is_left_out(make_replans: Any) -> None:
    table = make_replans({"astar": [[8], [6], [0], [9]], "lpa_star": [[4], [0], [0], [3]]})
    comparison = compare(table)
    assert_allclose(comparison.ratios["lpa_star"].of_episodes, [2, NAN, NAN, 3])
    row = row_of(comparison, "lpa_star")
    assert (row.ratio_expanded, row.ratio_low, row.ratio_high) == (2.5, None, None)


def test_nothing_solved_together_gives_no_paired_figure(make_replans: Any) -> None:
    found = {"astar": [[True, False]], "ia_star": [[False, True]]}
    comparison = compare(make_replans({"astar": [[8, 8]], "ia_star": [[4, 4]]}, found=found))
    for row in comparison.rows:
        absent = [name for name, value in asdict(row).items() if value is None]
        assert absent == [
            *("ratio_expanded", "ratio_low", "ratio_high", "suboptimality_mean", "suboptimality_p95"),
            *("fallback_share", "us_median", "us_p95", "length_m_total", "turn_rad_total"),
        ]
        assert row.success_rate == 0.5


def test_costs_summed_in_another_order_are_optimal(make_replans: Any) -> None:
    steps = [1, 2**0.5] * 7
    dear, cheap = sum(steps), sum(sorted(steps))
    assert dear != cheap
    table = make_replans({"astar": [[1]]}, cost={"astar": cheap}, optimal_cost={"astar": dear})
    assert compare(table).rows[0].suboptimality_mean == 0


def test_replans_of_one_episode_are_a_series_in_time(make_replans: Any) -> None:
    draw = np.random.default_rng(0)
    cells = {"astar": draw.integers(90, 110, (1, 200)), "ia_star": draw.integers(15, 25, (1, 200))}
    row = row_of(compare(make_replans(cells)), "ia_star")
    assert row.ratio_low is not None
    assert row.ratio_high is not None
    assert 4.6 < row.ratio_low < row.ratio_expanded < row.ratio_high < 5.4
    few = row_of(compare(make_replans({name: each[:, :19] for name, each in cells.items()})), "ia_star")
    assert few.ratio_expanded is not None
    assert (few.ratio_low, few.ratio_high) == (None, None)


def test_rows_that_do_not_match_are_refused(make_replans: Any) -> None:
    table = make_replans({"astar": [[1, 2]], "ia_star": [[3, 4]]})
    shorter = {name: column[:-1] for name, column in table.items()}
    twice = table | {"replan": np.zeros(4, dtype=int)}
    mixed = table | {"source": np.array(["a", "a", "a", "b"], dtype=object)}
    for wrong, said in (
        (shorter, "ia_star has not the same"),
        (twice, "astar has a replan twice"),
        (mixed, "not on 2"),
    ):
        with pytest.raises(ValueError, match=said):
            compare(wrong)
    with pytest.raises(ValueError, match="not on 0"):
        compare({name: column[:0] for name, column in table.items()})


cells_of_three = st.integers(1, 5).flatmap(
    lambda episodes: st.integers(1, 25).flatmap(
        lambda replans: st.lists(
            st.lists(st.integers(0, 10_000), min_size=episodes * replans, max_size=episodes * replans).map(
                lambda flat: np.array(flat).reshape(episodes, replans)
            ),
            min_size=3,
            max_size=3,
        )
    )
)


@given(cells_of_three, st.integers(1, 7), st.randoms(use_true_random=False))
def test_invariants(make_replans: Any, cells: list[np.ndarray], factor: int, shuffle: Any) -> None:
    named = dict(zip(("astar", "ia_star", "d_star_lite"), cells, strict=True))
    found = {name: each % 5 != 0 for name, each in named.items()}
    table = make_replans(named, found=found)
    plain = compare(table)
    # The baseline compared with itself is 1, always.
    own = plain.ratios["astar"].of_episodes if plain.ratios else np.empty(0)
    assert np.all(own[np.isfinite(own)] == 1)
    baseline = row_of(plain, "astar")
    assert {baseline.ratio_expanded, baseline.ratio_low, baseline.ratio_high} <= {1.0, None}
    # Neither the order of the rows nor that of the planners matters.
    order = list(range(len(table["found"])))
    shuffle.shuffle(order)
    shuffled = compare({name: column[order] for name, column in table.items()})
    assert sorted(plain.rows, key=lambda row: row.planner) == sorted(shuffled.rows, key=lambda row: row.planner)
    # Another planner that solves all changes nothing for these.
    more = compare(make_replans(named | {"dijkstra": cells[0] + 1}, found=found))
    assert more.rows[:3] == plain.rows
    # With all cells times a factor ratios stay and totals grow.
    scaled = compare(make_replans({name: factor * each for name, each in named.items()}, found=found))
    for row, larger in zip(plain.rows, scaled.rows, strict=True):
        assert larger.expanded_total == factor * row.expanded_total
        assert_allclose(_ratio_of(larger), _ratio_of(row), rtol=1e-12)
        if row.ratio_low is not None:
            assert row.ratio_low <= row.ratio_expanded <= row.ratio_high  # type: ignore[operator]


@pytest.mark.parametrize(("n", "ranks"), [(5, None), (6, (1, 6)), (20, (6, 15)), (41, (14, 28))])
def test_the_interval_of_a_median_is_that_of_the_sign_test(n: int, ranks: tuple[int, int] | None) -> None:
    """Ranks as in tables of the binomial law, P(Binomial(n, 1/2) < k) <= 0.025."""
    found = median_interval(np.random.default_rng(0).permutation(np.arange(1.0, n + 1)))
    assert found == ranks
    if ranks is not None:
        assert stats.binom.cdf(ranks[0] - 1, n, 0.5) <= 0.025 < stats.binom.cdf(ranks[0], n, 0.5)


def test_the_fewest_values_that_have_an_interval() -> None:
    for comparisons in range(1, 30):
        confidence = corrected_confidence(comparisons)
        n = fewest_values(confidence)
        assert median_interval(np.arange(float(n)), confidence) == (0, n - 1)
        assert median_interval(np.arange(float(n - 1)), confidence) is None


def _ratio_of(row: PlannerRow) -> np.ndarray:
    return np.array([row.ratio_expanded, row.ratio_low, row.ratio_high], dtype=np.float64)
