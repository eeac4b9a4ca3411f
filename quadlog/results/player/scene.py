"""What stands where at each instant of a run, from its saved tables alone, thinned to a bounded size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Int
from quadlog.results.plots.run_data import MAX_COORDINATE_CELLS, RunData, Table
from quadlog.results.plots.style import thin_points
from quadlog.results.plots.trajectory import is_ahead
from quadlog.results.run.maps import MapSequence
from quadlog.results.text.numbers import count

STEP_S = 0.04
"""Least time between two poses: 25 a second are interpolated to what a screen shows."""
MAX_POSES = 6000
MAX_REPLANS = 1200
MAX_PATH_POINTS, MAX_COURSE_POINTS = 48, 2000
"""Of each of many paths; of few paths, such as the course of a simulated walk, together."""
MAX_MAPS = 1200
MAX_MAP_BYTES = 8 << 20
"""Of all windows together, a bit a cell."""
MAX_CLOUDS, MAX_CLOUD_POINTS = 24, 2500
MAX_CONTACTS = 200
HOLD_S = 1.0
"""Across a longer gap nothing is interpolated, and what was last seen disappears."""
CLOUD_S = 1.0
"""How long the obstacle points of a sample scan are shown."""
FARTHEST_M = 1e6
LONGEST_S = 1e6
LEGS = 4
STANDS_N = 1.0
"""Vertical force from which a foot counts as standing."""
NOT_KNOWN = -1
OBSTACLE = "obstacle"
_SPACE_M = 0.02
"""Half a cell of the finest usual grid: obstacle points nearer to each other look the same from above."""


@dataclass(frozen=True, slots=True)
class DrawnTrack:
    """Poses over time: seconds (N,) rising, x_m, y_m (N,) in map, yaw_rad (N,) NaN where unknown.

    key: name of the table. run: A or B where two runs are in one scene, else empty. body: drawn as a footprint. feet:
    (N,) which feet stand, a bit for each leg in the order FL, FR, RL, RR, or NOT_KNOWN; lookahead_m: (N,), NaN where
    there is none. Both are empty where the table has none.
    """

    key: str
    label: str
    color: str
    seconds: Float
    x_m: Float
    y_m: Float
    yaw_rad: Float
    body: bool
    feet: Int = field(default_factory=lambda: np.empty(0, np.int64))
    lookahead_m: Float = field(default_factory=lambda: np.empty(0))
    run: str = ""


@dataclass(frozen=True, slots=True)
class Paths:
    """Planned paths: path k, made at seconds[k], is rows first[k] to first[k + 1] of x_m, y_m.

    walker: key of the DrawnTrack that was to walk it, of the same run. main: the ones that were followed.
    """

    label: str
    color: str
    walker: str
    seconds: Float
    first: Int
    x_m: Float
    y_m: Float
    main: bool = False
    run: str = ""


@dataclass(frozen=True, slots=True)
class Windows:
    """Some of the run's maps: index (W,) into maps, seconds (W,), cell (W, 2) column and row of each lower-left corner.

    Columns and rows are counted from origin_m (2,) in map, in cells of the maps. color: of occupied cells.
    """

    maps: MapSequence
    index: Int
    seconds: Float
    cell: Int
    origin_m: Float
    color: str = "text"


@dataclass(frozen=True, slots=True)
class Cloud:
    """Obstacle points of one sample scan, x_m, y_m (N,) in map."""

    seconds: float
    x_m: Float
    y_m: Float
    color: str = "target"


@dataclass(frozen=True, slots=True)
class DrawnContact:
    """Where the re-simulated body touched an occupied cell, from when until when."""

    seconds: float
    until_s: float
    x_m: float
    y_m: float
    clearance_m: float
    cause: str
    collision: bool
    run: str = ""


@dataclass(frozen=True, slots=True)
class Scene:
    """A run, or two, over seconds since the start, from_s to until_s.

    windows: the maps of the run, of two runs those of both. thinned: what was left out, in words.
    """

    from_s: float
    until_s: float
    tracks: Sequence[DrawnTrack]
    paths: Sequence[Paths]
    windows: Sequence[Windows]
    clouds: Sequence[Cloud]
    contacts: Sequence[DrawnContact]
    body_m: tuple[float, float] | None
    thinned: Sequence[str]

    def extent_m(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top of all that moved, was planned or was touched."""
        lines: list[DrawnTrack | Paths] = [*self.tracks, *self.paths]
        x_m = np.concatenate([*(each.x_m for each in lines), [each.x_m for each in self.contacts]])
        y_m = np.concatenate([*(each.y_m for each in lines), [each.y_m for each in self.contacts]])
        return float(x_m.min()), float(x_m.max()), float(y_m.min()), float(y_m.max())


def scene_of(run: RunData) -> Scene | None:
    """The run as a scene; None for a run in which nothing moves. Raises NotARun for damaged files."""
    thinned: list[str] = []
    tracks = [track for track in (_track(run, *each, thinned) for each in _walkers(run)) if track is not None]
    if not tracks:
        return None
    from_s = min(float(track.seconds[0]) for track in tracks)
    until_s = max(float(track.seconds[-1]) for track in tracks)
    if not 0 < until_s - from_s <= LONGEST_S:
        return None
    paths = [each for each in (_paths(run, *of, thinned) for of in _plans(run)) if each is not None]
    return Scene(
        from_s=from_s,
        until_s=until_s,
        tracks=tracks,
        paths=[*paths[:-1], *(replace(last, main=True) for last in paths[-1:])],
        windows=_windows(run, thinned),
        clouds=_clouds(run, thinned),
        contacts=_contacts(run, thinned),
        body_m=_body(run),
        thinned=thinned,
    )


def _body(run: RunData) -> tuple[float, float] | None:
    """Length and width of the body, where they are sizes that can be drawn."""
    size_m = run.body_m()
    return size_m if size_m is not None and all(0 < each <= FARTHEST_M for each in size_m) else None


def _walkers(run: RunData) -> list[tuple[str, str, str]]:
    """Table, label and colour of all that moves, the first drawn below the others."""
    if run.simulated:
        return [("control", "simulated robot", "resim")]
    # A target that is the robot's own future lies on its line, and nobody walked there.
    target = [] if is_ahead(run.table("target")) else [("target", "target", "target")]
    return [*target, ("poses", "logged robot", "robot"), ("control", "re-simulated robot", "resim")]


def _plans(run: RunData) -> list[tuple[str, str, str, str]]:
    """Table, label, colour and walker of the planned paths."""
    if run.simulated:
        return [("paths", "course", "note", "control")]
    return [("paths", "plan of the log", "fix", "poses"), ("resim_paths", "plan followed", "plan", "control")]


def _track(run: RunData, name: str, label: str, color: str, thinned: list[str]) -> DrawnTrack | None:
    table = run.table(name)
    if table is None:
        return None
    seconds = run.seconds(table["t_ns"])
    there = _near(table["x_m"], table["y_m"])
    rows = np.flatnonzero(there)
    if not len(rows):
        return None
    rows = rows[np.argsort(seconds[rows], kind="stable")]
    step_s = max(STEP_S, float(seconds[rows[-1]] - seconds[rows[0]]) / MAX_POSES)
    if step_s > STEP_S:
        thinned.append(f"a pose of the {label} every {step_s:.2g} s")
    _, first = np.unique(np.floor((seconds[rows] - seconds[rows[0]]) / step_s + 1e-6), return_index=True)
    rows = np.append(rows[first], rows[-1]) if first[-1] != len(rows) - 1 else rows[first]
    taken = {column: table[column][rows] for column in table}
    yaw_rad = taken.get("yaw_rad", np.full(len(rows), np.nan))
    body = "yaw_rad" in table and _body(run) is not None
    lookahead_m = taken.get("lookahead_m", np.empty(0))
    return DrawnTrack(
        name, label, color, seconds[rows], taken["x_m"], taken["y_m"], yaw_rad, body, _feet(taken), lookahead_m
    )


def _near(x_m: Float, y_m: Float) -> NDArray[np.bool_]:
    """Which points (N,) are places in metres; NaN is none."""
    return (np.abs(x_m) <= FARTHEST_M) & (np.abs(y_m) <= FARTHEST_M)


def _feet(table: Table) -> Int:
    """Bits (N,) of the feet that press on the ground; empty for a robot without."""
    forces = [table.get(f"fz_{leg}_n") for leg in range(LEGS)]
    if any(force is None or not np.isfinite(force).any() for force in forces):
        return np.empty(0, np.int64)
    forces_n = np.array(forces, np.float64)
    bits = np.sum((forces_n > STANDS_N) << np.arange(LEGS)[:, None], axis=0)
    return np.where(np.isfinite(forces_n).all(axis=0), bits, NOT_KNOWN)


def _paths(run: RunData, name: str, label: str, color: str, walker: str, thinned: list[str]) -> Paths | None:
    """Paths as they are walked: smoothed where the table has that, of MAX_REPLANS replans evenly over the run."""
    table = run.table(name)
    if table is None:
        return None
    smooth = np.isfinite(table["smooth_x_m"]) & np.isfinite(table["smooth_y_m"])
    starts = np.flatnonzero(np.append(True, np.diff(table["t_ns"]) != 0))
    chosen = thin_points(len(starts), MAX_REPLANS)
    if len(chosen) < len(starts):
        thinned.append(f"{count(len(chosen))} of {count(len(starts))} paths of the {label}")
    ends = np.append(starts[1:], len(table["t_ns"]))
    most = max(MAX_PATH_POINTS, MAX_COURSE_POINTS // len(chosen))
    kept = []
    for start, end in zip(starts[chosen].tolist(), ends[chosen].tolist(), strict=True):
        rows = np.arange(start, end)
        curve = "smooth_" if smooth[rows].any() else ""
        x_m, y_m = table[f"{curve}x_m"][rows], table[f"{curve}y_m"][rows]
        rows = np.flatnonzero(_near(x_m, y_m))
        rows = rows[thin_points(len(rows), most)]
        kept.append((x_m[rows], y_m[rows]))
    first = np.cumsum([0, *(len(x_m) for x_m, _ in kept)])
    x_m, y_m = (np.concatenate(each) for each in zip(*kept, strict=True))
    return Paths(label, color, walker, run.seconds(table["t_ns"])[starts[chosen]], first, x_m, y_m)


def _windows(run: RunData, thinned: list[str]) -> list[Windows]:
    maps = run.maps
    if maps is None:
        return []
    sane = np.flatnonzero((np.abs(maps.origin_m) < MAX_COORDINATE_CELLS * maps.cell_m).all(axis=1))
    each_bytes = maps.shape[0] * ((maps.shape[1] + 7) // 8)
    chosen = sane[thin_points(len(sane), min(MAX_MAPS, MAX_MAP_BYTES // each_bytes))]
    if not len(chosen):
        return []
    if len(chosen) < len(sane):
        thinned.append(f"{count(len(chosen))} of {count(len(sane))} maps")
    origin_m = maps.origin_m[chosen].min(axis=0)
    cell = np.rint((maps.origin_m[chosen] - origin_m) / maps.cell_m).astype(np.int64)
    return [Windows(maps, chosen, run.seconds(maps.t_ns[chosen]), cell, origin_m)]


def _clouds(run: RunData, thinned: list[str]) -> list[Cloud]:
    """Obstacle points of the sample scans that have a pose, in map; one of those that share a cell of _SPACE_M."""
    samples, classes = run.cloud_samples
    found, halved = [], False
    for sample in (samples[k] for k in thin_points(len(samples), MAX_CLOUDS)):
        is_obstacle = np.array([name.lower() == OBSTACLE for name in classes], np.bool_)[sample.label]
        xy_m = sample.xyz_m[is_obstacle][:, :2].astype(np.float64)
        cos, sin = np.cos(sample.yaw_rad), np.sin(sample.yaw_rad)
        xy_m = xy_m @ np.array([[cos, sin], [-sin, cos]]) + (sample.x_m, sample.y_m)
        xy_m = xy_m[_near(xy_m[:, 0], xy_m[:, 1])]
        x, y = np.rint(xy_m / _SPACE_M).astype(np.int64).T
        xy_m = xy_m[np.sort(np.unique((x << 32) + y, return_index=True)[1])]
        kept = xy_m[thin_points(len(xy_m), MAX_CLOUD_POINTS)]
        halved |= len(kept) < len(xy_m)
        if len(kept):
            seconds = float(run.seconds(np.array([sample.t_ns]))[0])
            found.append(Cloud(seconds, kept[:, 0], kept[:, 1]))
    if halved:
        thinned.append(f"{count(MAX_CLOUD_POINTS)} obstacle points of a scan")
    return found


def _contacts(run: RunData, thinned: list[str]) -> list[DrawnContact]:
    table = run.table("contacts")
    if table is None:
        return []
    near = np.flatnonzero(_near(table["x_m"], table["y_m"]))
    if len(near) > MAX_CONTACTS:
        thinned.append(f"the first {count(MAX_CONTACTS)} of {count(len(near))} contacts")
    from_s = run.seconds(table["t_ns"])
    return [
        DrawnContact(
            seconds=float(from_s[k]),
            until_s=float(from_s[k] + max(np.nan_to_num(table["duration_s"][k]), 0.0)),
            x_m=float(table["x_m"][k]),
            y_m=float(table["y_m"][k]),
            clearance_m=float(table["clearance_m"][k]),
            cause=str(table["cause"][k]),
            collision=bool(table["collision"][k]),
        )
        for k in near[:MAX_CONTACTS].tolist()
    ]


def row_at(seconds: Float, instant_s: float) -> int:
    """The last row of seconds (N,), rising, that is not later; -1 where all are."""
    return int(np.searchsorted(seconds, instant_s, side="right")) - 1


def pose_at(track: DrawnTrack, instant_s: float) -> tuple[float, float, float] | None:
    """x_m, y_m, yaw_rad (NaN where unknown), interpolated; None where nothing was seen for HOLD_S."""
    row = row_at(track.seconds, instant_s)
    if row < 0:
        return None
    following = min(row + 1, len(track.seconds) - 1)
    gap_s = float(track.seconds[following] - track.seconds[row])
    if not 0 < gap_s <= HOLD_S:
        held = instant_s - track.seconds[row] <= HOLD_S
        return (float(track.x_m[row]), float(track.y_m[row]), float(track.yaw_rad[row])) if held else None
    share = float(instant_s - track.seconds[row]) / gap_s
    x_m, y_m = (float(v[row] + share * (v[following] - v[row])) for v in (track.x_m, track.y_m))
    turned = (track.yaw_rad[following] - track.yaw_rad[row] + np.pi) % (2 * np.pi) - np.pi
    return x_m, y_m, float(track.yaw_rad[row] + share * turned)


def lookahead_point(path_m: Float, x_m: float, y_m: float, lookahead_m: float) -> tuple[float, float]:
    """Where the path (K, 2), K >= 1, from its point nearest to the robot on, first is lookahead_m away; else its end.

    The controller may have chosen a nearer one, to keep the line to it free; no table has that.
    """
    away_m = np.hypot(path_m[:, 0] - x_m, path_m[:, 1] - y_m)
    start = int(away_m.argmin())
    beyond = np.flatnonzero(away_m[start:] >= lookahead_m)
    if not len(beyond):
        return float(path_m[-1, 0]), float(path_m[-1, 1])
    k = start + int(beyond[0])
    if k == start:
        return float(path_m[k, 0]), float(path_m[k, 1])
    share = (lookahead_m - away_m[k - 1]) / (away_m[k] - away_m[k - 1])
    x, y = path_m[k - 1] + share * (path_m[k] - path_m[k - 1])
    return float(x), float(y)
