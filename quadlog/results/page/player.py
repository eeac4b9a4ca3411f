"""The player of a page: a run's scene as JSON, with its numbers and maps as one deflated block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from quadlog.messages import Float, Int
from quadlog.results.page.metric_cards import plain_name
from quadlog.results.page.packing import NO_YAW, UNIT_M, UNIT_S, Packing
from quadlog.results.player.moments import Moment, moments_of
from quadlog.results.player.scene import CLOUD_S, HOLD_S, NOT_KNOWN, DrawnContact, Scene, Windows, scene_of
from quadlog.results.player.two_scenes import two_moments, two_scenes
from quadlog.results.plots.run_data import RunData
from quadlog.results.text.numbers import short

UNIT_RAD = 1e-4
"""What 1 stands for in the packed yaws."""


def player_of(run: RunData) -> dict[str, Any] | None:
    """All that player.js and player.html.jinja need, as plain JSON; None for a run in which nothing moves.

    Raises NotARun for damaged files.
    """
    scene = scene_of(run)
    return None if scene is None else _player(scene, run.anchors(), moments_of(run, scene))


def player_of_two(a: RunData, b: RunData, parting: Sequence[Moment]) -> dict[str, Any] | None:
    """The same of two runs on their common clock, in one scene. parting: instants at which they part."""
    of_a, of_b = scene_of(a), scene_of(b)
    scene = two_scenes(of_a, of_b)
    if scene is None:
        return None
    both = [[] if each is None else moments_of(run, each) for run, each in ((a, of_a), (b, of_b))]
    moments = [*(each for each in parting if scene.from_s <= each.seconds <= scene.until_s), *two_moments(*both)]
    return _player(scene, sorted({*a.anchors(), *b.anchors()}), moments)


def _player(scene: Scene, anchors: Sequence[tuple[int, float, float]], moments: Sequence[Moment]) -> dict[str, Any]:
    """The scene as plain JSON.

    packed: base64 of deflated bytes: the columns one after the other, then the maps. lengths: of each column, in
    order. A column is the differences of its integers, zigzag-coded in 32 bits, lowest bytes of all first, then the
    next higher ones: small steps make long runs of zeros. A map is the exclusive or with the map before it, packed by
    numpy.packbits along x; column and row of a cell are taken modulo the window's, so that what stays in a sliding
    window stays at its place. The maps of two runs follow one another.
    """
    packing = Packing()
    tracks = [
        {"key": each.key, "run": each.run, "label": each.label, "color": each.color, "body": each.body,
         "t": packing.add(each.seconds, UNIT_S), "x": packing.add(each.x_m, UNIT_M), "y": packing.add(each.y_m, UNIT_M),
         "yaw": packing.add_integers(_yaws(each.yaw_rad)), "feet": packing.add_integers(each.feet),
         "lookahead": packing.add_integers(_or(each.lookahead_m / UNIT_M, NOT_KNOWN))}
        for each in scene.tracks
    ]  # fmt: skip
    paths = [
        {"label": each.label, "color": each.color, "walker": each.walker, "run": each.run, "main": each.main,
         "t": packing.add(each.seconds, UNIT_S), "first": packing.add_integers(each.first),
         "x": packing.add(each.x_m, UNIT_M), "y": packing.add(each.y_m, UNIT_M)}
        for each in scene.paths
    ]  # fmt: skip
    clouds = [
        {"t": each.seconds, "color": each.color, "x": packing.add(each.x_m, UNIT_M),
         "y": packing.add(each.y_m, UNIT_M)}
        for each in scene.clouds
    ]  # fmt: skip
    windows = [_windows(each, packing) for each in scene.windows]
    for each in scene.windows:
        _add_maps(each, packing)
    return {
        "from": scene.from_s,
        "until": scene.until_s,
        "hold": {"track": HOLD_S, "cloud": CLOUD_S},
        "tracks": tracks,
        "paths": paths,
        "clouds": clouds,
        "windows": windows,
        "contacts": [_contact(each) for each in scene.contacts],
        "anchors": [{"label": str(anchor), "x": x_m, "y": y_m} for anchor, x_m, y_m in anchors],
        "body": scene.body_m,
        "extent": scene.extent_m(),
        "moments": [_moment(each) for each in moments],
        "feet": any(len(each.feet) for each in scene.tracks),
        "lookahead": any(bool(np.isfinite(each.lookahead_m).any()) for each in scene.tracks),
        "note": _note(scene),
        "lengths": packing.lengths,
        "packed": packing.finish(),
    }


def _yaws(yaw_rad: Float) -> Int:
    wrapped = (yaw_rad + np.pi) % (2 * np.pi) - np.pi
    return _or(wrapped / UNIT_RAD, NO_YAW)


def _or(values: Float, otherwise: int) -> Int:
    """Whole numbers (N,), `otherwise` for those that do not exist or do not fit."""
    fits = np.abs(values) < 2**30
    return np.where(fits, np.rint(np.where(fits, values, 0)), otherwise).astype(np.int64)


def _windows(windows: Windows, packing: Packing) -> dict[str, Any]:
    """Size, place and time of each window, without its cells."""
    maps, (rows, columns) = windows.maps, windows.maps.shape
    placed = {
        "t": packing.add(windows.seconds, UNIT_S),
        "column": packing.add_integers(windows.cell[:, 0]),
        "row": packing.add_integers(windows.cell[:, 1]),
    }
    origin_m = windows.origin_m.tolist()
    size = {"rows": rows, "columns": columns, "cell": maps.cell_m}
    return placed | size | {"x": origin_m[0], "y": origin_m[1], "color": windows.color}


def _add_maps(windows: Windows, packing: Packing) -> None:
    maps, (rows, columns) = windows.maps, windows.maps.shape
    before = np.zeros((rows, (columns + 7) // 8), np.uint8)
    for index, (column, row) in zip(windows.index.tolist(), windows.cell.tolist(), strict=True):
        bits = np.packbits(np.roll(maps.occupied(index), (row % rows, column % columns), axis=(0, 1)), axis=1)
        packing.add_bytes((bits ^ before).tobytes())
        before = bits


def _moment(of: Moment) -> dict[str, Any]:
    """A button of the player; metrics by their names in plain words, metric: as the tables call them."""
    shown = asdict(of) | {"value": _value(of.value, of.unit), "metric": ""}
    if of.kind == "worst":
        *run, metric = of.what.split(": ")
        words = ": ".join([*run, plain_name(metric)])
        shown |= {"what": words, "metric": metric, "also": [plain_name(name) for name in of.also]}
    return shown


def _contact(of: DrawnContact) -> dict[str, Any]:
    place = {"x": of.x_m, "y": of.y_m, "collision": of.collision, "run": of.run}
    return {"seconds": of.seconds, "until": of.until_s} | place


def _value(value: float | None, unit: str) -> str:
    return "" if value is None else f"{short(value)} {unit}".strip().replace("-", "\N{MINUS SIGN}")


def _note(scene: Scene) -> str:
    """What was thinned, as one sentence; empty where nothing was."""
    return f"Thinned for this page: {'; '.join(scene.thinned)}." if scene.thinned else ""
