"""Figs 9 to 12 of [Following]: how far ranges and coordinates of two standing tags are off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.judging import compare, rms_interval
from quadlog.pipelines.tables.uwb_site import (
    LINEAR_METHODS,
    METHODS,
    RANGE_STD_M,
    STATIONS_M,
    TAGS,
    PaperTag,
    cramer_rao,
    distances,
    draw_ranges,
)
from quadlog.positioning.trilateration import solve_fixes
from quadlog.results.paper_rows import PaperRow, RowGroup

CLAIMED_M = 0.1
"""[Following] says of ranges and of coordinates that their error stays at about this."""


@dataclass(frozen=True, slots=True)
class StandingTag:
    """A tag that stands still: range_m (N, 3), and the fixes (N, 2) that each method makes of the same ranges."""

    tag: PaperTag
    range_m: Float
    fix_m: dict[str, Float]

    @property
    def bound_m2(self) -> Float:
        """(2, 2) Cramér-Rao bound."""
        bound: Float = cramer_rao(np.array([self.tag.true_m]), STATIONS_M)[0]
        return bound


def stand(tag: PaperTag, n_fixes: int, rng: np.random.Generator) -> StandingTag:
    """Draw n_fixes epochs at the corrected truth and fix them with every method; a fix without solution is NaN."""
    range_m = draw_ranges(np.tile(tag.true_m, (n_fixes, 1)), STATIONS_M, rng)
    fix_m = {
        method: solve_fixes(method, STATIONS_M, range_m, 0.0, RANGE_STD_M, np.inf).position_m for method in METHODS
    }
    return StandingTag(tag, range_m, fix_m)


def range_group(standing: list[StandingTag]) -> RowGroup:
    """Figs 9 and 10."""
    rows = []
    for each in standing:
        error_m = each.range_m - distances(np.array([each.tag.true_m]), STATIONS_M)
        for station in range(3):
            rms_m, interval = rms_interval(error_m[:, station] ** 2)
            quantity = f"{each.tag.range_figure}: range error, {each.tag.name} to station {station + 1}, rms (m)"
            rows.append(PaperRow(quantity, rms_m, CLAIMED_M, *interval, note="Drawn so."))
    text = (
        f"The paper finds errors of about {CLAIMED_M:g} m and publishes no ranges. Ours are drawn with a standard "
        f"deviation of {RANGE_STD_M:g} m, so these rows state what everything below starts from; they confirm nothing."
    )
    return RowGroup("Figs 9 and 10: ranges", text, tuple(rows))


def coordinate_group(standing: list[StandingTag]) -> RowGroup:
    """Figs 11 and 12, with every method and the bound that none can beat."""
    rows = []
    for each in standing:
        for axis, name in enumerate("xy"):
            what = f"{each.tag.coordinate_figure}: {name} error of the {each.tag.name}"
            bound_m = float(np.sqrt(each.bound_m2[axis, axis]))
            rows.append(PaperRow(f"{what}, Cramér-Rao bound (m)", bound_m))
            rows += [_error_row(each, axis, method, f"{what}, {method}, rms (m)") for method in METHODS]
    rows.append(_weighting_row(standing))
    text = (
        f"Coordinates of tags that stand at the corrected truths, from ranges with a standard deviation of "
        f"{RANGE_STD_M:g} m. The paper says that its errors stay at about {CLAIMED_M:g} m; that is compared with the "
        "method it describes, paper, whose weights are read as 1/d. Intervals are analytic, from the spread of the "
        "squared errors."
    )
    return RowGroup("Figs 11 and 12: coordinates", text, tuple(rows))


def _error_row(each: StandingTag, axis: int, method: str, quantity: str) -> PaperRow:
    error_m = each.fix_m[method][:, axis] - each.tag.true_m[axis]
    solved = np.isfinite(error_m)
    rms_m, interval = rms_interval(error_m[solved] ** 2)
    note = "" if solved.all() else f"{int((~solved).sum())} of {len(solved)} epochs have no fix."
    if method != "paper":
        return PaperRow(quantity, rms_m, None, *interval, note=note)
    direct_m = float(np.sqrt(np.nanmean((each.fix_m["gauss_newton"][:, axis] - each.tag.true_m[axis]) ** 2)))
    why_not = f"Three stations give the linear fix no choice; a direct fit of the same ranges has {direct_m:.3f} m."
    return compare(quantity, CLAIMED_M, 0.1, rms_m, interval, note, why_not)


def _weighting_row(standing: list[StandingTag]) -> PaperRow:
    apart_m = max(
        float(np.nanmax(np.linalg.norm(each.fix_m[method] - each.fix_m["linear"], axis=1)))
        for each in standing
        for method in LINEAR_METHODS
    )
    return PaperRow(
        "largest distance between the linear, weighted and paper fixes of the same ranges (m)",
        round(apart_m, 9),
        note="To the nanometre. Two equations in two unknowns have one solution, whatever their weights.",
    )


def stand_all(n_fixes: int, seed: int) -> list[StandingTag]:
    """Both tags, each with draws of its own."""
    return [stand(tag, n_fixes, np.random.default_rng([seed, 1, number])) for number, tag in enumerate(TAGS)]
