"""Where the tags of [Following] were, from its own printed distances, and what a forgotten height would have cost."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.judging import compare
from quadlog.pipelines.tables.uwb_site import (
    BOX_HIGH_M,
    BOX_LOW_M,
    BOX_WORDS,
    PERSON,
    ROBOT,
    STATIONS_M,
    TAGS,
    PaperTag,
    distances,
)
from quadlog.positioning.trilateration import solve_fixes
from quadlog.results.paper_rows import PaperRow, RowGroup

STD_OF_PRINTED_M = 0.01
TAG_BELOW_M = 0.6
"""Stations at 1.2 m, the robot's tag at 0.6 m, as in [Following]'s outdoor experiment."""
GRID_M = 0.05
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
    rows = [
        compare(
            f"distance of the {tag.name} tag from station {station} (m)",
            printed_m,
            0.01,
            float(true_m),
            why_not="Erratum: 3.60 is right; the tag's two other distances fit the corrected truth.",
        )
        for tag in TAGS
        for station, printed_m, true_m in zip((1, 2, 3), tag.distance_m, _distances_at(tag.true_m), strict=True)
    ]
    text = "Printed distances beside those from the corrected truths, robot (0.8, 0) and person (2.4, 0)."
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
