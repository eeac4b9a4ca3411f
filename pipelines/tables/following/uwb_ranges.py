"""The site of [Following]'s positioning experiment: ranges drawn there, and the truths its distances can mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.intervals import compare, not_comparable, rms_interval
from quadlog.positioning.fix.trilateration import solve_fixes
from quadlog.results.papers.table import PaperRow, RowGroup

RANGE_STD_M = 0.1
"""What [Following] reports of its ranges. Its raw ranges are not published, so this is what ours are drawn with."""
STATIONS_M = np.array([[0.0, -2.4, 0.0], [0.0, 1.6, 0.0], [6.0, 0.0, 0.0]])
"""Heights are not printed for this experiment; the distances say that the tags were level with the stations."""
BOX_LOW_M, BOX_HIGH_M = np.array([0.5, -2.0]), np.array([5.5, 2.0])
"""Where tags may be among the stations: in and around their triangle, but not close to a station."""
BOX_WORDS = "0.5 to 5.5 m by -2 to 2 m"
METHODS = ("linear", "weighted", "paper", "gauss_newton", "huber")
LINEAR_METHODS = ("linear", "weighted", "paper")


@dataclass(frozen=True, slots=True)
class PaperTag:
    """A tag of the experiment: where the paper says it was, where its distances (3,) say it was, and its figures.

    fitted_to: the stations, from 1, whose distances true_m is found from.
    """

    name: str
    printed_m: tuple[float, float]
    true_m: tuple[float, float]
    distance_m: tuple[float, float, float]
    fitted_to: tuple[int, ...]
    range_figure: str
    coordinate_figure: str


ROBOT = PaperTag("robot", (0.0, 2.4), (0.8, 0.0), (2.53, 1.79, 5.20), (1, 2, 3), "Fig. 9", "Fig. 12")
PERSON = PaperTag("person", (0.0, 0.8), (2.4, 0.0), (3.39, 2.88, 3.55), (1, 2), "Fig. 10", "Fig. 11")
TAGS = (ROBOT, PERSON)


def distances(position_m: Float, stations_m: Float) -> Float:
    """(N, A) true distances of tags at (N, 2), z = 0, from stations (A, 3)."""
    offset_m = np.column_stack([position_m, np.zeros(len(position_m))])[:, None, :] - stations_m
    distance_m: Float = np.linalg.norm(offset_m, axis=2)
    return distance_m


def cramer_rao(position_m: Float, stations_m: Float) -> Float:
    """(N, 2, 2) the smallest covariance that any unbiased fix at (N, 2) can have: (sum u u^T / std^2)^-1.

    For tags level with the stations [Following, right form].
    """
    offset_m = position_m[:, None, :] - stations_m[None, :, :2]
    u = offset_m / np.linalg.norm(offset_m, axis=2, keepdims=True)
    bound: Float = RANGE_STD_M**2 * np.linalg.inv(u.swapaxes(1, 2) @ u)
    return bound


def draw_ranges(position_m: Float, stations_m: Float, rng: np.random.Generator) -> Float:
    """(N, A) ranges in line of sight, with normal errors of RANGE_STD_M."""
    true_m = distances(position_m, stations_m)
    return true_m + RANGE_STD_M * rng.standard_normal(true_m.shape)


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
            rows.append(not_comparable(quantity, CLAIMED_M, rms_m, interval, "Drawn so."))
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
        "method it describes, paper, whose weights are read as 1/d: not the noise, but what the stations' places make "
        "of it. Intervals are analytic, from the spread of the "
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


STD_OF_PRINTED_M = 0.01
TAG_BELOW_M = 0.6
"""Stations at 1.2 m, the robot's tag at 0.6 m, as in [Following]'s outdoor experiment."""
GRID_M = 0.05
FITTED = "The corrected truth is fitted to these distances."
ERRATUM_355 = "Erratum: 3.60 is right; the tag's two other distances fit the corrected truth."
ERRATUM = "Erratum: x and y of both tags are transposed in print, and the tags are in the wrong order."


def truth_group() -> RowGroup:
    """Printed coordinates beside those that the printed distances give, and how far each choice misses them."""
    rows = [row for tag in TAGS for row in _coordinate_rows(tag)]
    for tag, other in ((ROBOT, PERSON), (PERSON, ROBOT)):
        rows += [
            _miss_row(tag, tag.printed_m, "as printed"),
            _miss_row(tag, other.printed_m, "printed for the other tag"),
            _miss_row(tag, tag.true_m, "corrected"),
        ]
    return RowGroup(
        "Where the tags were",
        "Stations at (0, -2.4), (0, 1.6) and (6, 0) m. Ours is the Gauss-Newton fix of the three printed distances; "
        "a miss is the rms over the three stations. The distances alone cannot tell whether the tags or the stations "
        "were transposed.",
        tuple(rows),
    )


def distance_group() -> RowGroup:
    """The printed distances beside those from the corrected truths."""
    rows = []
    for tag in TAGS:
        for station, printed_m, true_m in zip((1, 2, 3), tag.distance_m, _distances_at(tag.true_m), strict=True):
            quantity = f"distance of the {tag.name} tag from station {station} (m)"
            if station in tag.fitted_to:
                rows.append(not_comparable(quantity, printed_m, float(true_m), why=FITTED))
            else:
                rows.append(compare(quantity, printed_m, 0.01, float(true_m), why_not=ERRATUM_355))
    text = (
        "Printed distances beside those from the corrected truths, robot (0.8, 0) and person (2.4, 0). The robot's was "
        "found from all three of its distances, the person's from two; what a truth is found from cannot confirm it."
    )
    return RowGroup("Distances between tags and stations", text, tuple(rows))


def height_group() -> RowGroup:
    """The error that slant ranges taken as horizontal make, without any noise, all over the box."""
    position_m = _grid()
    raised_m = STATIONS_M + np.array([0.0, 0.0, TAG_BELOW_M])
    range_m = distances(position_m, raised_m)
    rows = []
    for method, height_m, what in (
        ("gauss_newton", TAG_BELOW_M, "height ignored, Gauss-Newton"),
        ("linear", TAG_BELOW_M, "height ignored, linear"),
        ("gauss_newton", 0.0, "height known, Gauss-Newton"),
    ):
        fixes = solve_fixes(method, raised_m, range_m, height_m, STD_OF_PRINTED_M, np.inf)
        off_m = np.linalg.norm(fixes.position_m - position_m, axis=1)[fixes.solved]
        unsolved = int((~fixes.solved).sum())
        note = f"{unsolved} of {len(position_m)} places have no fix." if unsolved else ""
        rows += [
            PaperRow(f"{what}: mean error (m)", _to_micrometre(off_m.mean()), note=note),
            PaperRow(f"{what}: largest error (m)", _to_micrometre(off_m.max()), note=note),
        ]
    return RowGroup(
        "Slant ranges taken as horizontal",
        f"A tag {TAG_BELOW_M:g} m below the stations, as in the outdoor experiment, at {len(position_m)} places on a "
        f"grid of {GRID_M:g} m over {BOX_WORDS}, no noise. Differences of squared ranges cancel a common height, a "
        "direct fit has to be told.",
        tuple(rows),
    )


def _coordinate_rows(tag: PaperTag) -> list[PaperRow]:
    fixes = solve_fixes("gauss_newton", STATIONS_M, np.array([tag.distance_m]), 0.0, STD_OF_PRINTED_M, np.inf)
    return [
        compare(f"{tag.name} tag, {axis} (m)", printed_m, 0.1, _to_micrometre(fixed_m), why_not=ERRATUM)
        for axis, printed_m, fixed_m in zip("xy", tag.printed_m, fixes.position_m[0], strict=True)
    ]


def _miss_row(tag: PaperTag, place_m: tuple[float, float], which: str) -> PaperRow:
    miss_m = float(np.sqrt(np.mean((_distances_at(place_m) - np.array(tag.distance_m)) ** 2)))
    note = "" if which == "corrected" else "Erratum: no tag was here."
    return PaperRow(
        f"{tag.name} tag at ({place_m[0]:g}, {place_m[1]:g}), {which}: miss of its distances (m)", miss_m, note=note
    )


def _distances_at(place_m: tuple[float, float]) -> Float:
    row: Float = distances(np.array([place_m]), STATIONS_M)[0]
    return row


def _grid() -> Float:
    """(N, 2) places all over the box."""
    x_m, y_m = (np.arange(low, high + GRID_M / 2, GRID_M) for low, high in zip(BOX_LOW_M, BOX_HIGH_M, strict=True))
    return np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)


def _to_micrometre(value_m: float) -> float:
    """Without the last bits, which say nothing and differ between machines."""
    return round(float(value_m), 6)
