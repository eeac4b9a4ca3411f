"""The scenes of a run, seen from above: the walk over its maps, and one scan."""

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

AROUND_M = 2.0
"""Margin of the first view around the walk."""
STANDS_M = 1.0
"""A robot that moves less stands; then the first view is all that it saw."""
NEAR_S = 1.0
"""Fixes and late ranges are shown at instants within this time."""
MOST_OBSTACLES = 6000
"""Obstacle points of all saved scans together."""
LATE, OBSTACLES = "late ranges (NLOS)", "obstacle points"
CLASSES = {"ground": "fix", "obstacle": "target", "outlier": "note"}
"""Colours of the classes of points; all others are soft."""


def walk_scene(run: Run) -> view.Scene | None:
    """Everything that moved, on the maps it moved on; None where nothing did."""
    tracks, walls, ways = list(_tracks(run)), list(_walls(run)), list(_reference(run))
    if not tracks:
        return None
    layers: list[view.Layer] = [*walls, *_scans(run), *_anchors(run), *_course(run), *_fixes(run), *_late_ranges(run)]
    layers += [*_plans(run), *ways, *tracks, *_errors(run), *_contacts(run)]
    extent = _extent(run, [*ways, *tracks], walls)
    body = run.config.robot.length_m, run.config.robot.width_m
    return view.Scene(layers, extent, body=body, moments=_moments(run), activity=list(_activity(run)))


def _extent(
    run: Run, ways: Sequence[view.Track | view.Lines], walls: Sequence[view.Raster]
) -> tuple[float, float, float, float]:
    """Around the ways and the anchors near them; around all that was seen by a robot that stands."""
    walked = [(way.x, way.y) for way in ways]
    left, right, bottom, top = view.extent_of(*walked, margin=AROUND_M)
    side = max(right - left, top - bottom)
    if walls and side < STANDS_M + 2 * AROUND_M:
        return _filled(walls[0])
    x_m, y_m = np.array([(anchor.x_m, anchor.y_m) for anchor in run.config.uwb.anchors]).reshape(-1, 2).T
    near = (np.abs(x_m - (left + right) / 2) < side) & (np.abs(y_m - (bottom + top) / 2) < side)
    return view.extent_of(*walked, (x_m[near], y_m[near]), margin=AROUND_M)


def _tracks(run: Run) -> Iterator[view.Track]:
    target = run.table("target")
    # The robot's own future lies on its own track.
    if target is not None and set(target["source"].unique()) != {"ahead"}:
        yield from _track(target, "target", "target", shape="person")
    if not run.simulated:
        yield from _track(run.table("poses"), "robot", "robot")
    yield from _track(run.table("control"), "simulated robot", "resim")


def _track(table: DataFrame | None, label: str, color: str, **look: Any) -> Iterator[view.Track]:
    """The rows of a table that have a position."""
    rows = _located(table)
    if rows is None:
        return
    names = [name for name in ("x_m", "y_m", "yaw_rad") if name in rows]
    columns: Any = view.break_gaps(rows["seconds"].to_numpy(), *columns_of(rows, " ".join(names)))
    yield view.Track(label, color, *columns, **look)


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
        _, x_m, y_m = view.break_gaps(run.seconds(truth.t_ns), *truth.position_m[:, :2].T)
        yield line("reference", "text", x_m, y_m, 1)
    if other is not None:
        _, x_m, y_m = view.break_gaps(*columns_of(other, "seconds x_m y_m"))
        yield line("other track", "olive", x_m, y_m, 2)


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


def error_scene(run: Run) -> view.Scene | None:
    """The robot's track in the colours of its error: of positions against a reference, else of the simulated walk."""
    errors, poses, control, walk = run.table("uwb_errors"), run.table("poses"), run.table("control"), walk_scene(run)
    if walk is None:
        return None
    if errors is not None and poses is not None and (errors["source"] == "track").any():
        of_track = errors[(errors["source"] == "track") & (errors["tag"] == errors["tag"].min())]
        table = poses.merge(of_track[["t_ns", "error_x_m", "error_y_m"]], on="t_ns")
        table, what = table.assign(error_m=np.hypot(table["error_x_m"], table["error_y_m"])), "position error (m)"
    elif control is not None:
        table, what = control, "distance to the path (m)"
    else:
        return None
    rows = table.dropna(subset=["x_m", "y_m", "error_m"]).sort_values("seconds", kind="stable")
    seconds, x_m, y_m, error_m = view.break_gaps(*columns_of(rows, "seconds x_m y_m error_m"))
    track = view.Track("robot", "robot", seconds, x_m, y_m, values=(what, error_m))
    walls = [layer for layer in walk.layers if isinstance(layer, view.Raster)]
    return view.Scene([*walls, *_anchors(run), track], walk.extent) if len(rows) > 1 else None


def _scans(run: Run) -> Iterator[view.Layer]:
    """Obstacle points of the saved scans, about their instants."""
    saved = run.arrays("cloud_samples")
    names = [] if saved is None else saved["classes"].tolist()
    if saved is None or "obstacle" not in names:
        return
    scan = np.repeat(np.arange(len(saved["t_ns"])), np.diff(saved["offset"]))
    known = np.isfinite(saved["xyz_m"]).all(axis=1) & np.isfinite(saved["x_m"][scan])
    keep = np.flatnonzero(known & (saved["label"] == names.index("obstacle")))
    keep = keep[view.thin_evenly(len(keep), MOST_OBSTACLES)]
    scan, ahead_m, left_m = scan[keep], *saved["xyz_m"][keep, :2].T
    seconds, cos, sin = run.seconds(saved["t_ns"])[scan], np.cos(saved["yaw_rad"][scan]), np.sin(saved["yaw_rad"][scan])
    x_m = saved["x_m"][scan] + cos * ahead_m - sin * left_m
    y_m = saved["y_m"][scan] + sin * ahead_m + cos * left_m
    if len(keep):
        yield view.Marks(OBSTACLES, "note", x_m, y_m, seconds=seconds - NEAR_S, until=seconds + NEAR_S, hidden=True)


def _course(run: Run) -> Iterator[view.Layer]:
    paths = run.table("paths")
    if run.simulated and paths is not None:
        x_m, y_m = columns_of(paths, "x_m y_m")
        yield line("course", "note", x_m, y_m, 1)


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
    seconds = fixes["seconds"].to_numpy()
    later = np.append(seconds, np.inf)[np.searchsorted(seconds, seconds + EPOCH_S, side="right")]
    until = np.minimum(later, seconds + view.GAP_S)
    yield _ellipses("95 % ellipse of the fix", "fix", fixes, seconds=seconds, until=until)


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
    wanted = [("paths", "plan, recorded walk", "fix", 1, 0), ("resim_paths", "plan, simulated walk", "plan", 0, 12)]
    for name, label, color, variant, shown in [] if run.simulated else wanted:
        paths = run.table(name)
        if paths is not None:
            first, x_m, y_m = plan_ways(paths)
            seconds = paths["seconds"].to_numpy()[first[:-1]]
            yield view.Lines(label, color, first, x_m, y_m, seconds, variant, shown)


def plan_ways(paths: DataFrame) -> tuple[view.Array, view.Array, view.Array]:
    """Each replan's way, rows first[k] to first[k + 1] of x and y: the smooth one where there is one."""
    smooth = paths["smooth_x_m"].notna().groupby(paths["t_ns"]).transform("any")
    x_m, y_m = (np.where(smooth, paths[f"smooth_{axis}_m"], paths[f"{axis}_m"]) for axis in "xy")
    return np.append(np.flatnonzero(np.append(True, np.diff(paths["t_ns"]) != 0)), len(paths)), x_m, y_m


def _errors(run: Run) -> Iterator[view.Layer]:
    """The line from the simulated robot to the nearest point of its reference path: the error itself."""
    control = run.table("control")
    if control is not None and control["ref_x_m"].notna().any():
        seconds, *ends = view.break_gaps(*columns_of(control, "seconds x_m ref_x_m y_m ref_y_m"))
        x, y = (np.stack(pair, axis=1).ravel() for pair in (ends[:2], ends[2:]))
        first = np.arange(0, len(x) + 1, 2)
        yield view.Lines("distance to the path", "bad", first, x, y, seconds, shown=0, measured=True)


def _contacts(run: Run) -> Iterator[view.Layer]:
    contacts = run.table("contacts")
    if contacts is not None:
        x_m, y_m = columns_of(contacts, "x_m y_m")
        yield view.Marks("contact", "bad", x_m, y_m, "cross")


def _moments(run: Run) -> list[view.Moment]:
    """Contacts, collisions first, and the worst instant of each metric, tag and bound after the first of them."""
    contacts, table = [], run.table("contacts")
    if table is not None:
        rows = zip(*columns_of(table, "seconds cause collision"), strict=True)
        words, shows = ("no collision", "collision"), (OBSTACLES,)
        contacts = [view.Moment(float(at), cause, words[bool(hit)], shows=shows) for at, cause, hit in rows]
        contacts.sort(key=lambda moment: moment.value != "collision")
    known = {moment.seconds: moment for moment in contacts}
    for theme, names in THEMES.items():
        for name in names:
            metric, label = run.metrics.get(name), CATALOGUE[name].label
            if metric is None or metric.worst_t_ns is None or name in _AS_GOOD:
                continue
            seconds = float(run.seconds(np.array([metric.worst_t_ns]))[0])
            worst = "" if metric.worst is None else value_text(name, abs(metric.worst), metric.unit)
            what = label if label.startswith(("nearest", "largest")) else f"worst {label}"
            # One for all metrics of one error.
            known.setdefault(seconds, view.Moment(seconds, what, worst, name, _SHOWS.get(theme, ())))
    worst_ones = [moment for moment in known.values() if moment.name]
    return [*contacts[:MOST_CONTACTS], *worst_ones, *_worst_of_tags(run), *contacts[MOST_CONTACTS:]]


_SHOWS = {"Position": (LATE,), "Walking": (OBSTACLES,)}
"""Layers that the worst instants of a theme show."""
MOST_CONTACTS = 6
"""Before the worst instants."""
_AS_GOOD = frozenset({
    *("ate_aligned_rmse_m", "ate_time_corrected_rmse_m", "plan_error_m", "following_distance_mean_m"),
    *("uwb_nis", "rpe_rmse_m", "reference_time_offset_s"),
})  # fmt: skip
"""Metrics whose worst instant shows no more than that of another one, or nothing that the map draws."""


def _worst_of_tags(run: Run) -> Iterator[view.Moment]:
    """Where the track is farthest outside of its 95 % bound, and the largest error of each of several tags."""
    errors = run.table("uwb_errors")
    if errors is None:
        return
    track = errors[errors["source"] == "track"].dropna(subset=["error_x_m", "error_y_m"])
    seconds, tags, bound_m, x_m, y_m = columns_of(track, "seconds tag bound_m error_x_m error_y_m")
    error_m = np.hypot(x_m, y_m)
    beyond = np.divide(error_m, bound_m, out=np.zeros(len(track)), where=bound_m > 0)
    if (most := float(beyond.max(initial=0.0))) > 1:
        at, words = float(seconds[beyond.argmax()]), f"{sig(most, 2)} × the bound"
        yield view.Moment(at, "farthest outside of the 95 % bound", words, "", (LATE,))
    known = np.unique(tags).tolist()
    for tag in known if len(known) > 1 else []:
        at, name = int(np.where(tags == tag, error_m, -1.0).argmax()), f"tag {tag}"
        yield view.Moment(float(seconds[at]), f"worst error of {name}", f"{sig(float(error_m[at]))} m", name, (LATE,))


_ROLES = {
    "lidar": "scans", "UWB": "ranges", "positions": "poses", "target": "target", "joints": "joints", "plans": "plans"
}  # fmt: skip


def _activity(run: Run) -> Iterator[view.Activity]:
    """When there was data of each role, contacts, and instants at which the reference path changes."""
    for label, name in _ROLES.items():
        table = run.table(name)
        if table is not None and not run.simulated:
            seconds = np.sort(table["seconds"].to_numpy())
            cut = np.flatnonzero(np.diff(seconds) > view.GAP_S)
            spans = zip(seconds[np.append(0, cut + 1)].tolist(), seconds[np.append(cut, -1)].tolist(), strict=True)
            yield view.Activity(label, spans=list(spans))
    contacts = run.table("contacts")
    if contacts is not None:
        yield view.Activity("contacts", events=list(zip(*columns_of(contacts, "seconds cause"), strict=True)))


def line(label: str, color: str, x: view.Array, y: view.Array, variant: int = 0) -> view.Lines:
    """One still polyline."""
    return view.Lines(label, color, np.array([0, len(x)]), x, y, variant=variant)


SCALE_95 = 2.4477
"""From the standard to the 95 % ellipse in two dimensions: √5.991."""
EPOCH_S = 0.02
"""Fixes of several tags within this time belong together."""


def _ellipses(label: str, color: str, fixes: DataFrame, **times: Any) -> view.Marks:
    x_m, y_m, xx_m2, xy_m2, yy_m2 = columns_of(fixes, "x_m y_m cov_xx_m2 cov_xy_m2 cov_yy_m2")
    along_m = np.sqrt(np.maximum(xx_m2, 1e-12))
    cross_m = xy_m2 / along_m
    aside_m = np.sqrt(np.maximum(yy_m2 - cross_m**2, 0.0))
    axes: dict[str, Any] = {"along": SCALE_95 * along_m, "cross": SCALE_95 * cross_m, "aside": SCALE_95 * aside_m}
    return view.Marks(label, color, x_m, y_m, "ring", **axes, **times)


def scan_scene(run: Run) -> view.Scene | None:
    """The middle one of the saved scans from above, in the frame base, by class, the rarest last."""
    saved = run.arrays("cloud_samples")
    if saved is None or not len(saved["t_ns"]):
        return None
    number = len(saved["t_ns"]) // 2
    rows = slice(*saved["offset"][number : number + 2])
    every, label = saved["xyz_m"][rows, :2].astype(float), saved["label"][rows]
    every, label = every[finite := np.isfinite(every).all(axis=1)], label[finite]
    points = {str(name).lower(): every[label == k] for k, name in enumerate(saved["classes"])}
    layers: list[view.Layer] = [
        view.Marks(f"{name} ({len(of)})", CLASSES.get(name, "soft"), of[:, 0], of[:, 1])
        for name, of in sorted(points.items(), key=lambda item: -len(item[1])) if len(of)
    ]  # fmt: skip
    if not layers:
        return None
    half_m = np.array([run.config.robot.length_m, run.config.robot.width_m]) / 2
    layers.append(line("robot", "robot", *(half_m * [[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]).T))
    reach = max(3.0, float(np.percentile(np.abs(every).max(axis=1), 98)))
    return view.Scene(layers, (-reach, reach, -0.6 * reach, 0.6 * reach), axes=("forward (m)", "left (m)"))
