"""The walk of a run over its maps, seen from above, and the moments that are worth a look."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.results import view
from quadlog.results.run import Run
from quadlog.results.text import sig, value_text

if TYPE_CHECKING:
    from pandas import DataFrame

AROUND_M, AROUND_SHARE = 1.5, 0.1
"""Margin of the first view around the walk: so much, or a share of the longer side of a short one."""
STANDS_M = 1.0
"""A robot that moves less stands; then the first view is all that it saw."""
NEAR_S = 1.0
"""Fixes and late ranges are shown at instants within this time."""
LATE = "late ranges (NLOS)"


def walk_scene(run: Run) -> view.Scene | None:
    """Everything that moved, on the maps it moved on; None where nothing did."""
    tracks, walls, ways = list(_tracks(run)), list(_walls(run)), list(_reference(run))
    if not tracks:
        return None
    layers: list[view.Layer] = [*walls, *_anchors(run), *_fixes(run), *_late_ranges(run)]
    layers += [*_plans(run), *ways, *tracks, *_errors(run)]
    moved: list[Any] = [*ways, *tracks]
    walked = [(way.x, way.y) for way in moved]
    left, right, bottom, top = view.extent_of(*walked, margin=0.0)
    side = max(right - left, top - bottom)
    extent = view.extent_of(*walked, margin=min(AROUND_M, max(AROUND_SHARE * side, 0.5)))
    places: Any = [([anchor.x_m], [anchor.y_m]) for anchor in run.config.uwb.anchors]
    places += [(box[:2], box[2:]) for box in map(_filled, walls[:1])]
    whole = view.extent_of(*walked, *places, margin=AROUND_M)
    if walls and side < STANDS_M:
        extent = _filled(walls[0])
    body, known = run.config.robot.body_m[:2], dict(_activity(run))
    return view.Scene(layers, extent, body=body, whole=whole, moments=_moments(run), activity=known)


def _tracks(run: Run) -> Iterator[view.Track]:
    poses = None if run.simulated else run.table("poses")
    shown: Any = [(_target(run), "target", "target", "person"), (poses, "robot", "robot", "body"),
                  (run.table("control"), "simulated robot", "resim", "body")]  # fmt: skip
    for table, label, color, shape in shown:
        if (rows := _located(table)) is not None:
            names = "seconds x_m y_m" + " yaw_rad" * ("yaw_rad" in rows)
            seconds, x_m, y_m, *yaw = view.break_gaps(*columns_of(rows, names))
            yield view.Track(label, color, seconds, x_m, y_m, yaw[0] if yaw else None, shape)


def _target(run: Run) -> DataFrame | None:
    """None also where it is the robot's own future, which lies on the robot's track."""
    target = run.table("target")
    return None if target is None or set(target["source"].unique()) == {"ahead"} else target


def columns_of(table: DataFrame, names: str) -> Iterator[Any]:
    """The columns (N,) of these names, separated by spaces."""
    return (table[name].to_numpy() for name in names.split())


def _located(table: DataFrame | None) -> DataFrame | None:
    """The rows with a position, in time; None without any."""
    rows = None if table is None else table[np.isfinite(table["x_m"]) & np.isfinite(table["y_m"])]
    return None if rows is None or not len(rows) else rows.sort_values("seconds", kind="stable")


def _reference(run: Run) -> Iterator[view.Lines]:
    """The reference, unless it lies in another frame or the run is a course; and the other track."""
    truth = None if run.simulated or run.metric("ate_rmse_m") is None else run.trajectory("reference")
    other = _located(run.table("other_poses"))
    if truth is not None:
        yield line(
            "reference", "text", *view.break_gaps(run.seconds(truth.t_ns), *truth.position_m[:, :2].T)[1:], variant=1
        )
    if other is not None:
        yield line("other track", "olive", *view.break_gaps(*columns_of(other, "seconds x_m y_m"))[1:], variant=2)


def _walls(run: Run) -> Iterator[Any]:
    if run.maps is not None:
        share, origin_m, cell_m = run.maps.occupancy
        seen = np.where(share > 0, share, np.nan)
        yield view.Raster("walls, whole run", "wall", seen, tuple(origin_m.tolist()), cell_m, 0.0, 1.0)
        yield view.Windows("map at this instant", "cell", run.seconds(run.maps.t_ns), run.maps)


def _filled(raster: view.Raster) -> tuple[float, float, float, float]:
    """Around all cells that have a value."""
    row, column = np.nonzero(np.isfinite(raster.values))
    x, y = raster.origin[0] + raster.cell * column, raster.origin[1] + raster.cell * row
    return view.extent_of((x, y), (x + raster.cell, y + raster.cell))


def _anchors(run: Run) -> Iterator[view.Layer]:
    if anchors := run.config.uwb.anchors:
        x_m, y_m = np.array([(anchor.x_m, anchor.y_m) for anchor in anchors]).T
        yield view.Marks("anchors", "soft", x_m, y_m, "triangle", names=[str(anchor.id) for anchor in anchors])


def position_errors(run: Run) -> DataFrame | None:
    """The poses that have an error, with ref_x_m and ref_y_m as control has them, and error_m; None without any."""
    errors, poses = run.table("uwb_errors"), run.table("poses")
    if errors is None or poses is None or not (errors["source"] == "track").any():
        return None
    track = errors[(errors["source"] == "track") & (errors["tag"] == errors["tag"].min())]
    both = poses.merge(track[["t_ns", "error_x_m", "error_y_m"]], on="t_ns")
    both = both.assign(ref_x_m=both["x_m"] - both["error_x_m"], ref_y_m=both["y_m"] - both["error_y_m"])
    return both.assign(error_m=np.hypot(both["error_x_m"], both["error_y_m"]))


def error_scene(run: Run) -> view.Scene | None:
    """The robot's track in the colours of its error: of positions against a reference, else of the simulated walk."""
    walk, table, what = walk_scene(run), position_errors(run), "position error (m)"
    if table is None:
        table, what = run.table("control"), "distance to the path (m)"
    if walk is None or table is None:
        return None
    rows = table.dropna(subset=["x_m", "y_m", "error_m"]).sort_values("seconds", kind="stable")
    seconds, x_m, y_m, error_m = view.break_gaps(*columns_of(rows, "seconds x_m y_m error_m"))
    track = view.Track("robot", "robot", seconds, x_m, y_m, values=(what, error_m))
    walls = [layer for layer in walk.layers if isinstance(layer, view.Raster)]
    return view.Scene([*walls, *_anchors(run), track], walk.extent) if len(rows) > 1 else None


def _fixes(run: Run) -> Iterator[view.Layer]:
    """Fixes of the moment, those that the track leaves out in another colour, with their 95 % ellipses."""
    fixes = run.table("fixes")
    if fixes is None:
        return
    fixes = fixes[fixes["x_m"].notna()].sort_values("seconds", kind="stable")
    outlier = fixes["outlier"].to_numpy()
    for label, color, rows in (("UWB fixes", "fix", fixes[~outlier]), ("outlying fixes", "olive", fixes[outlier])):
        if len(rows):
            seconds, x_m, y_m = columns_of(rows, "seconds x_m y_m")
            yield view.Marks(label, color, x_m, y_m, seconds=seconds - NEAR_S, until=seconds + NEAR_S)
    seconds, x_m, y_m, *spread_m2 = columns_of(fixes, "seconds x_m y_m cov_xx_m2 cov_xy_m2 cov_yy_m2")
    later = np.append(seconds, np.inf)[np.searchsorted(seconds, seconds + EPOCH_S, side="right")]
    until = np.minimum(later, seconds + view.GAP_S)
    yield view.Marks(ELLIPSES, "fix", x_m, y_m, "ring", seconds, until, *_axes_95(*spread_m2))


def _late_ranges(run: Run) -> Iterator[view.Layer]:
    """Circles about the anchors whose ranges of the moment are late: most likely not in line of sight."""
    ranges = run.table("ranges")
    if ranges is None:
        return
    places_m = {anchor.id: (anchor.x_m, anchor.y_m) for anchor in run.config.uwb.anchors}
    late = ranges[is_late(run, ranges) & ranges["anchor"].isin(places_m)]
    if len(late):
        x_m, y_m = np.array([places_m[anchor] for anchor in late["anchor"].tolist()]).T
        seconds = late["seconds"].to_numpy()
        until, radius_m = seconds + NEAR_S / 4, late["range_m"].to_numpy()
        yield view.Marks(LATE, "note", x_m, y_m, "ring", seconds, until, radius_m, 0 * radius_m, radius_m, hidden=True)


LATE_STD = 3.0
"""A range is late if it is longer than predicted by more standard deviations of its link."""


def is_late(run: Run, ranges: DataFrame) -> view.Array:
    """Which rows (N,) of the table ranges are late."""
    link, links = ["tag", "anchor"], run.table("links")
    if links is None:
        return np.zeros(len(ranges), np.bool_)
    std_m = ranges[link].merge(links.drop_duplicates(link), how="left", on=link)["range_std_m"].to_numpy()
    return np.asarray(ranges["range_m"] - ranges["predicted_m"] > LATE_STD * std_m)


def _plans(run: Run) -> Iterator[view.Lines]:
    """The plan of each instant; of a simulated walk its course."""
    wanted = [("paths", "plan, recorded walk", "fix", 1, 0), ("resim_paths", "plan, simulated walk", "plan", 0, 12)]
    for name, label, color, variant, shown in wanted:
        if (paths := run.table(name)) is not None and not run.simulated:
            first, x_m, y_m = plan_ways(paths)
            seconds = paths["seconds"].to_numpy()[first[:-1]]
            yield view.Lines(label, color, first, x_m, y_m, seconds, variant, shown)
        elif paths is not None:
            yield line("course", "note", *columns_of(paths, "x_m y_m"), variant=1)


def plan_ways(paths: DataFrame) -> tuple[view.Array, view.Array, view.Array]:
    """Each replan's way, rows first[k] to first[k + 1] of x and y: the smooth one where there is one."""
    smooth = paths["smooth_x_m"].notna().groupby(paths["t_ns"]).transform("any")
    x_m, y_m = (np.where(smooth, paths[f"smooth_{axis}_m"], paths[f"{axis}_m"]) for axis in "xy")
    return np.append(np.flatnonzero(np.append(True, np.diff(paths["t_ns"]) != 0)), len(paths)), x_m, y_m


def _errors(run: Run) -> Iterator[view.Layer]:
    """The line from the simulated robot to the nearest point of its reference path: the error itself; contacts."""
    control, contacts = run.table("control"), run.table("contacts")
    if control is not None and control["ref_x_m"].notna().any():
        seconds, *ends = view.break_gaps(*columns_of(control, "seconds x_m ref_x_m y_m ref_y_m"))
        x, y = (np.stack(pair, axis=1).ravel() for pair in (ends[:2], ends[2:]))
        first = np.arange(0, len(x) + 1, 2)
        yield view.Lines("distance to the path", "bad", first, x, y, seconds, shown=0, measured=True)
    if contacts is not None:
        hits = contacts["collision"].to_numpy()
        for label, color, rows in (("contact", "bad", hits), ("cell inside the body", "olive", ~hits)):
            if rows.any():
                x_m, y_m = columns_of(contacts[rows], "x_m y_m")
                yield view.Marks(label, color, x_m, y_m, "cross")


CAUSES = {
    "appeared": "appeared inside the body",
    "fell": "the robot fell",
    "no_plan": "there was no plan",
    "old_plan": "no newer plan was found",
    "beyond_plan": "beyond the plan's end",
    "planned": "the plan leads there",
    "cut_corner": "the robot cut a corner of its plan",
    "unseen": "the map did not show it at that instant",
    "turning": "the body turned beside its plan",
}
"""Of contacts, by their code; runs of earlier versions have the words."""


def _moments(run: Run) -> list[view.Moment]:
    """Contacts, collisions first, and the worst instant of each metric, tag, bound and gap after the first of them."""
    table, words, contacts = run.table("contacts"), (("no collision", ""), ("collision", "collisions")), []
    if table is not None:
        rows: Any = table.sort_values("collision", ascending=False, kind="stable").itertuples()
        for row in rows:
            place = (row.x_m, row.y_m, row.x_m, row.y_m)
            contacts.append(
                view.Moment(row.seconds, CAUSES.get(row.cause, row.cause), *words[row.collision], line=place)
            )
    known = {moment.seconds: moment for moment in contacts}  # one for all metrics of one error
    for theme, name in ((theme, name) for theme, names in THEMES.items() for name in names if name not in _AS_GOOD):
        metric, label = run.metrics.get(name), CATALOGUE[name].label
        if metric is not None and metric.worst_t_ns is not None:
            seconds, worst = float(run.seconds(np.array([metric.worst_t_ns]))[0]), metric.worst
            value = "" if worst is None else value_text(name, abs(worst), metric.unit)
            what = label if label.startswith(("nearest", "largest")) else f"worst {label}"
            if name == "clearance_min_m" and worst is not None and worst < 0:
                what, value = "body", f"{value} inside an obstacle"
            drawn = {} if worst is None else _claim(run, name, float(worst), metric.worst_t_ns)
            shows = (LATE,) if theme == "Position" else ()
            known.setdefault(seconds, view.Moment(seconds, what, value, name, shows, **drawn))
    worst_ones = [*(of for of in known.values() if of not in contacts), *_worst_of_tags(run), *_gaps(run)]
    return [*contacts[:MOST_CONTACTS], *worst_ones, *contacts[MOST_CONTACTS:]][:MOST_MOMENTS]


MOST_CONTACTS, MOST_MOMENTS = 6, 200
"""Contacts before the worst instants, and all."""
_AS_GOOD = ("ate_aligned_rmse_m", "ate_time_corrected_rmse_m", "plan_error_m", "following_distance_mean_m",
            "uwb_nis", "uwb_bias_m", "rpe_rmse_m", "reference_time_offset_s")  # fmt: skip
"""Metrics whose worst instant shows no more than that of another one, or nothing that the map draws."""
_FIXES = ("UWB fixes", "outlying fixes", ELLIPSES := "95 % ellipse of the fix")
_WALKED = ("max_error_m", "eta_m", "sigma_m", "cross_track_rmse_m", "clearance_min_m")
_PLAN = ("plans", "start_x_m", "start_y_m", ("plan, simulated walk",))
_PLACES = {"uwb_residual_m": ("fixes", "x_m", "y_m", _FIXES), "suboptimality_mean": _PLAN, "expanded_mean": _PLAN}
"""Table and columns of the place of a worst sample that is no length on the map, and what else is of its kind."""
AGREES_M = 0.01
"""A line is drawn for a value that differs from its length by no more."""


def _claim(run: Run, name: str, worst: float, t_ns: int) -> dict[str, Any]:
    """`line`, `ring` and `hides` of the worst sample of a metric; nothing of one that has no place on the map."""
    if name in _PLACES:
        table, x, y, kind = _PLACES[name]
        row = _row(run, table, t_ns)
        return {} if row is None else {"line": (row[x], row[y]) * 2, "hides": kind}
    if name == "heading_rmse_rad" and (row := _row(run, "control", t_ns)) is not None:
        course = np.exp(1j * (row.yaw_rad - row.heading_error_rad))  # one metre of where the path leads
        return {"line": (row.x_m, row.y_m, row.x_m + course.real, row.y_m + course.imag)}
    if name in ("uwb_nees", "uwb_coverage_95"):
        return _claimed_error(run, "track", t_ns)
    drawn, truth = dict[str, Any](), run.trajectory("reference")
    if name == "uwb_rmse_m":
        drawn = _claimed_error(run, "fixes", t_ns)
    elif name == "ate_rmse_m" and truth is not None and (row := _row(run, "poses", t_ns)) is not None:
        drawn = {"line": (row.x_m, row.y_m, *truth.position_m[int(np.abs(truth.t_ns - t_ns).argmin()), :2].tolist())}
    elif name in _WALKED and (row := _row(run, "control", t_ns)) is not None:
        drawn = {"line": (row.x_m, row.y_m, row.ref_x_m, row.ref_y_m)}
        if name == "clearance_min_m":
            drawn, worst = _nearest_obstacle(run, worst, t_ns, row), max(worst, 0.0)
    x0, y0, x1, y1 = drawn.get("line", [np.nan] * 4)
    return drawn if abs(np.hypot(x1 - x0, y1 - y0) - abs(worst)) <= AGREES_M else {}


def _row(run: Run, name: str, t_ns: int, **equal: Any) -> Any:
    """The first row of a table at an instant in which columns equal these; None without one."""
    table = run.table(name)
    for key, value in (equal | {"t_ns": t_ns}).items() if table is not None else ():
        table = table[table[key] == value]  # type: ignore[index]
    return None if table is None or not len(table) else table.iloc[0]


def _claimed_error(run: Run, source: str, t_ns: int, **of_tag: int) -> dict[str, Any]:
    """From a fix, or the track, to the truth, and the 95 % ellipse that it claims."""
    error = _row(run, "uwb_errors", t_ns, source=source, **of_tag)
    place, spread = _row(run, "poses", t_ns), _row(run, "pose_uncertainty", t_ns)
    if error is not None and source == "fixes":
        place = spread = _row(run, "fixes", t_ns, tag=error.tag)
    if error is None or place is None:
        return {}
    at = (place.x_m, place.y_m)
    axes_m = [np.nan] if spread is None else _axes_95(spread.cov_xx_m2, spread.cov_xy_m2, spread.cov_yy_m2)
    ring = (*at, *map(float, axes_m)) if np.isfinite(axes_m).all() else ()
    return {"line": (*at, at[0] - error.error_x_m, at[1] - error.error_y_m), "ring": ring, "hides": _FIXES}


def _nearest_obstacle(run: Run, clearance_m: float, t_ns: int, body: Any) -> dict[str, Any]:
    """From the simulated body, a rectangle, to the cell that is as near as said; a point where that lies inside."""
    maps, half = run.maps, complex(*run.config.robot.body_m[:2]) / 2
    at = -1 if maps is None else int(np.searchsorted(maps.t_ns, t_ns, side="right")) - 1
    if maps is None or at < 0:
        return {}
    share, origin_m, cell_m = maps.occupancy
    grids = (maps.origin_m[at], maps.cell_m, maps.occupied(at)), (origin_m, cell_m, share > 0)
    cells_m = np.concatenate([base + size * (np.argwhere(of)[:, ::-1] + 0.5) for base, size, of in grids])
    pose, turn = body.x_m + 1j * body.y_m, np.exp(1j * body.yaw_rad)
    seen = (cells_m @ [1, 1j] - pose) / turn  # x + iy in the frame of the body
    edge = np.clip(seen.real, -half.real, half.real) + 1j * np.clip(seen.imag, -half.imag, half.imag)
    depth_m = np.maximum(np.minimum(half.real - np.abs(seen.real), half.imag - np.abs(seen.imag)), 0.0)
    gap_m = np.abs(seen - edge) - depth_m - maps.cell_m / 2
    if not len(gap_m) or (off_m := np.abs(gap_m - clearance_m)).min() > AGREES_M:
        return {}
    seen, edge, gap = (of[off_m.argmin()] for of in (seen, edge, gap_m))
    ends = pose + turn * (edge + np.array([0, max(gap, 0.0) / max(abs(seen - edge), 1e-9)]) * (seen - edge))
    return {"line": (ends[0].real, ends[0].imag, ends[1].real, ends[1].imag)}


def _gaps(run: Run) -> Iterator[view.Moment]:
    """Where positions are missing, the longest first."""
    rows = _located(run.table("poses"))
    seconds = np.zeros(1) if rows is None else rows["seconds"].to_numpy()
    for at in np.argsort(-np.diff(seconds))[:MOST_CONTACTS].tolist():
        if (gap_s := float(seconds[at + 1] - seconds[at])) > view.GAP_S:
            yield view.Moment(float(seconds[at]), "no position for", f"{sig(gap_s, 2)} s", "gap")


def _worst_of_tags(run: Run) -> Iterator[view.Moment]:
    """Where the track is farthest outside of its 95 % bound, and the largest error of each of several tags."""
    errors = run.table("uwb_errors")
    if errors is None:
        return
    track = errors[errors["source"] == "track"].dropna(subset=["error_x_m", "error_y_m"])
    t_ns, seconds, tags, bound_m, x_m, y_m = columns_of(track, "t_ns seconds tag bound_m error_x_m error_y_m")
    error_m = np.hypot(x_m, y_m)
    beyond = np.divide(error_m, bound_m, out=np.zeros(len(track)), where=bound_m > 0)
    found = []
    if (most := float(beyond.max(initial=0.0))) > 1:
        found.append((beyond.argmax(), "farthest outside of the 95 % bound", f"{sig(most, 2)} × the bound", "bound"))
    known = np.unique(tags).tolist()
    for tag in known if len(known) > 1 else []:
        at = np.where(tags == tag, error_m, -1.0).argmax()
        found.append((at, f"worst error of tag {tag}", f"{sig(float(error_m[at]))} m", f"tag {tag}"))
    for at, what, value, name in found:
        drawn = _claimed_error(run, "track", int(t_ns[at]), tag=int(tags[at]))
        yield view.Moment(float(seconds[at]), what, value, name, (LATE,), **drawn)


_ROLES = {"lidar": "scans", "UWB": "ranges", "positions": "poses", "target": "target", "joints": "joints",
          "plans": "plans"}  # fmt: skip


def _activity(run: Run) -> Iterator[tuple[str, Sequence[tuple[float, float]]]]:
    """When there was data of each role."""
    for label, name in _ROLES.items():
        table = _target(run) if name == "target" else run.table(name)
        if table is not None and not run.simulated:
            seconds = np.sort(table["seconds"].to_numpy())
            cut = np.flatnonzero(np.diff(seconds) > view.GAP_S)
            starts, ends = seconds[np.append(0, cut + 1)], seconds[np.append(cut, -1)]
            yield label, list(zip(starts.tolist(), ends.tolist(), strict=True))


def line(label: str, color: str, x: view.Array, y: view.Array, *, variant: int = 0) -> view.Lines:
    """One still polyline."""
    return view.Lines(label, color, np.array([0, len(x)]), x, y, variant=variant)


SCALE_95 = 2.4477
"""From the standard to the 95 % ellipse in two dimensions: √5.991."""
EPOCH_S = 0.02
"""Fixes of several tags within this time belong together."""


def _axes_95(xx_m2: view.Array, xy_m2: view.Array, yy_m2: view.Array) -> tuple[view.Array, view.Array, view.Array]:
    """along, cross and aside (N,) of 95 % ellipses from their covariances (N,)."""
    along_m = np.sqrt(np.maximum(xx_m2, 1e-12))
    cross_m = xy_m2 / along_m
    aside_m = np.sqrt(np.maximum(yy_m2 - cross_m**2, 0.0))
    return SCALE_95 * along_m, SCALE_95 * cross_m, SCALE_95 * aside_m
