"""following-uwb: ranges and coordinates of two standing tags [Following, Figs 5, 9-12]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.claims import Claim, Figures, Group, Point, Study, StudyTable, grid
from quadlog.pipelines.tables.judge import EXACT, SIZE, Judge, not_comparable, number, rests
from quadlog.positioning.fixes import solve_fixes
from quadlog.positioning.two_way_ranging import averaged_range_m, general_range_m, measured_times

RANGE_STD_M = 0.1
"""What [Following] reports of its ranges. Its raw ranges are not published, so this is what ours are drawn with."""
STATIONS_M = np.array([[0.0, -2.4, 0.0], [0.0, 1.6, 0.0], [6.0, 0.0, 0.0]])
"""Heights are not printed for this experiment; the distances say that the tags were level with the stations."""


@dataclass(frozen=True, slots=True)
class PaperTag:
    """A tag of the experiment: where the paper says it was, where its distances (3,) say it was, and its figures.

    fitted_to: the stations, from 1, whose distances true_m is found from.
    """

    printed_m: tuple[float, float]
    true_m: tuple[float, float]
    distance_m: tuple[float, float, float]
    fitted_to: tuple[int, ...]
    figures: tuple[str, str]


TAGS = {
    "robot": PaperTag((0.0, 2.4), (0.8, 0.0), (2.53, 1.79, 5.20), (1, 2, 3), ("Fig. 9", "Fig. 12")),
    "person": PaperTag((0.0, 0.8), (2.4, 0.0), (3.39, 2.88, 3.55), (1, 2), ("Fig. 10", "Fig. 11")),
}


def distances(place_m: tuple[float, float]) -> Float:
    """(3,) from the stations to a tag at (2,), z = 0."""
    distance_m: Float = np.linalg.norm(STATIONS_M - [*place_m, 0.0], axis=1)
    return distance_m


def measure(what: str, tag: str | None = None, fixes: int = 0, seed: int = 0) -> Figures:
    """One batch of fixes of a standing tag, what its printed distances say, or errors of two-way ranging."""
    if what == "ranging":
        return ranging()
    assert tag is not None
    return printed_site(tag) if what == "site" else batch(tag, fixes, seed)


def batch(tag: str, fixes: int, seed: int) -> Figures:
    """Root mean squares over so many epochs at the corrected truth: of ranges, and of coordinates by its method."""
    true_m = TAGS[tag].true_m
    rng = np.random.default_rng([seed, 1, list(TAGS).index(tag)])
    range_m = distances(true_m) + RANGE_STD_M * rng.standard_normal((fixes, 3))
    found = {f"range_{k + 1}_m": off for k, off in enumerate(_rms(range_m - distances(true_m)))}
    fixes_m = solve_fixes("paper", STATIONS_M, range_m, 0.0, RANGE_STD_M, np.inf).position_m
    return found | {f"{axis}_m": off for axis, off in zip("xy", _rms(fixes_m - true_m), strict=True)}


def _rms(errors_m: Float) -> list[float]:
    rms_m: list[float] = np.sqrt(np.nanmean(errors_m**2, axis=0)).tolist()
    return rms_m


def printed_site(tag: str) -> Figures:
    """The Gauss-Newton fix of a tag's printed distances, and the distances from its corrected place."""
    of = TAGS[tag]
    fix_m = solve_fixes("gauss_newton", STATIONS_M, np.array([of.distance_m]), 0.0, 0.01, np.inf).position_m[0]
    found = {f"{axis}_m": round(float(value), 6) for axis, value in zip("xy", fix_m, strict=True)}
    return found | {f"distance_{k + 1}_m": float(each) for k, each in enumerate(distances(of.true_m))}


REPLIES_S = {"equal replies of 300 µs": (3e-4, 3e-4), "replies of 300 and 1000 µs": (3e-4, 1e-3)}
CLOCK_ERRORS = (20e-6, -20e-6)
FAR_M = 50.0
FORMS = {"general form": general_range_m, "mean of four": averaged_range_m}


def ranging() -> Figures:
    """Errors of either form, in mm, sizes."""
    return {
        f"{form}, {called}": round(1e3 * abs(float(range_m(measured_times(FAR_M, replies_s, CLOCK_ERRORS))) - FAR_M), 6)
        for called, replies_s in REPLIES_S.items()
        for form, range_m in FORMS.items()
    }


DRAWN_SO = rests(number(RANGE_STD_M, 0.1), "Drawn so.")
SPREAD = rests(
    number(RANGE_STD_M, 0.1), "Ours is the range noise, drawn as printed, times what the stations' places make of it."
)
FITTED = "The corrected truth is fitted to these distances."
TRANSPOSED = "Erratum: x and y of both tags are transposed in print, and the tags are in the wrong order."
DISTANCE_355 = "Erratum: 3.60 is right; the tag's two other distances fit the corrected truth."


def site_rows(name: str, tag: PaperTag) -> list[Claim]:
    """Where a tag was."""
    where = {"what": "site", "tag": name}
    rows = [
        Claim(f"{name} tag, {axis} (m)", f"{axis}_m", where, number(value, 0.1), EXACT, why_not=TRANSPOSED)
        for axis, value in zip("xy", tag.printed_m, strict=True)
    ]
    for station, printed_m in enumerate(tag.distance_m, start=1):
        judge: Judge = not_comparable(printed_m, FITTED) if station in tag.fitted_to else number(printed_m, 0.01)
        quantity = f"distance of the {name} tag from station {station} (m)"
        rows.append(Claim(quantity, f"distance_{station}_m", where, judge, EXACT, why_not=DISTANCE_355))
    return rows


def noise_rows(name: str, tag: PaperTag) -> list[Claim]:
    """Errors of ranges and coordinates of a tag that stands."""
    where, (of_ranges, of_places) = {"what": "fixes", "tag": name}, tag.figures
    rows = [
        Claim(f"{of_ranges}: error, {name} to station {k}, rms (m)", f"range_{k}_m", where, DRAWN_SO, SIZE, of="ranges")
        for k in (1, 2, 3)
    ]
    return rows + [
        Claim(f"{of_places}: {axis} error of the {name}, rms (m)", f"{axis}_m", where, SPREAD, SIZE, of="coordinates")
        for axis in "xy"
    ]


BATCHES = 20


def table(fast: bool, seed: int) -> StudyTable:
    """fast: a tenth of the fixes."""
    fixes = 500 if fast else 5000
    points: list[Point] = [*grid(what=["site"], tag=TAGS), {"what": "ranging"}]
    points += grid(what=["fixes"], tag=TAGS, fixes=[fixes], seed=range(BATCHES * seed, BATCHES * (seed + 1)))
    return StudyTable(
        title="UWB positioning with three stations [Following, Figs 5, 9 to 12]",
        caption="Two tags stand still among three stations. How far off are ranges and coordinates, and how far off "
        "need they be? Simulated, because the paper's ranges are not published.",
        sizes=f"{BATCHES} batches of {fixes} fixes of each tag, seed {seed}.",
        study=Study(measure, points),
        groups=[
            Group(
                "Where the tags were",
                "Coordinates: the Gauss-Newton fix of the printed distances. Distances: from the right places, robot "
                "(0.8, 0) and person (2.4, 0).",
                [row for name, tag in TAGS.items() for row in site_rows(name, tag)],
            ),
            Group(
                "Figs 9 to 12: ranges and coordinates",
                f"The paper finds errors of about {RANGE_STD_M:g} m in both. Ours are drawn so, which confirms "
                "nothing, of coordinates neither; these are by its method, weights read as 1/d. Means over batches; "
                "intervals: Student.",
                [row for name, tag in TAGS.items() for row in noise_rows(name, tag)],
            ),
            Group(
                "Fig. 5: double-sided two-way ranging",
                f"Size of the error at {FAR_M:g} m with clocks that are 20 ppm fast and slow. The paper's formula is "
                "lost; the mean of both sides' times is common, and right for equal replies alone.",
                [Claim(f"{name} (mm)", name, {"what": "ranging"}, statistic=EXACT) for name in ranging()],
            ),
        ],
    )
