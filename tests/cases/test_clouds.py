"""Clouds that are not as they should be, from the file to the map: skipped and counted, or refused, and never drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.lib import recfunctions

from quadlog.mapping.grid import window_at
from quadlog.results.arrays import load_maps
from quadlog.simulation.synthetic.recording import LIDAR_TOPIC, START_NS
from quadlog.simulation.worlds.world import occupied_centres
from tests.lab.clouds import CLOUD, RECORDING, SCANS, SOURCES, Points, encoded, from_obstacle, rows, sensed
from tests.lab.recordings import Row, written

BAD = (2, 3, 7, 11)
FALSE_SHARE = {"range_image": 0.005, "paper": 0.02}
"""Occupied cells with nothing there; the paper's filter keeps more false points of a thin scan."""
METHODS = tuple(FALSE_SHARE)


def places(done: Any) -> list[tuple[int, np.ndarray]]:
    """Time and occupied centres (N, 2) of every map."""
    maps = load_maps(done.run)
    return [
        (each.t_ns, occupied_centres(each.occupied, window_at(each.origin_m, maps.cell_m, maps.shape))) for each in maps
    ]


def from_anything(t_ns: int, places_m: np.ndarray) -> np.ndarray:
    """How far places (N, 2) are from what stands there and from the people, who go a few centimetres meanwhile."""
    t_s, site = np.array([(t_ns - START_NS) * 1e-9 + 0.05]), RECORDING.site
    away = [from_obstacle(each, places_m) for each in site.obstacles]
    for person in (site.person, site.passer_by):
        away.append(np.linalg.norm(places_m - person.at(t_s).position_m, axis=1) - 0.4)
    return np.min(away, axis=0)


PointChange = Callable[[Points], "Points | None"]


def as_sensed(points: Points) -> Points:
    return points


@pytest.fixture
def mapped(tmp_path: Path, replayed: Any) -> Callable[..., Any]:
    """Replays the recording with some clouds changed (None: left out), others beside them."""

    def go(
        change: PointChange | Mapping[int, PointChange] = as_sensed,
        *flags: str,
        which: Iterable[int] = range(SCANS),
        beside: Iterable[Row] = (),
        claimed: int | None = None,
    ) -> Any:
        changes = change if isinstance(change, Mapping) else dict.fromkeys(which, change)

        def of_cloud(n: int, log_ns: int, scan: Any) -> tuple[int, Any]:
            points = changes.get(n, as_sensed)(sensed(scan))
            said = claimed if n in changes else None
            return log_ns, None if points is None else encoded(points, scan.cloud.stamp_ns, claimed=said)

        messages = sorted([*rows(of_cloud), *beside], key=itemgetter(1))
        return replayed(written(tmp_path / "log.mcap", messages), *SOURCES, *flags)

    return go


def by(method: str, memory: str = "log_odds") -> list[str]:
    return ["--set", f"lidar.method={method}", "--set", f"grid.memory={memory}"]


@pytest.fixture(scope="session")
def sound_maps() -> dict[Any, Any]:
    return {}


def maps_of(done: Any) -> list[bytes]:
    return [(done.run / name).read_bytes() for name in ("maps.npz", "map.pgm", "map.yaml", "ground.npz")]


def left_out(points: Points) -> None:
    return None


def filled(value: float) -> PointChange:
    def change(points: Points) -> Points:
        for name in "xyz":
            points[name] = value
        return points

    return change


def high_up(count: int) -> PointChange:
    """The first few points well above the ground: each would be an obstacle."""
    return lambda points: points[points["z"] > 0.1][:count]


def spoilt(points: Points) -> Points:
    """A bad point before every good one."""
    both = np.repeat(points, 2)
    for name in "xyz":
        both[name][::2] = np.resize([np.nan, np.inf, 0.0, 1e30], len(points))
    return both


def thinned(points: Points) -> Points:
    rng = np.random.default_rng(len(points))
    return points[np.sort(rng.permutation(len(points))[: int(len(points) * rng.uniform(0.3, 1))])]


def timed(scale: float) -> PointChange:
    """Times that are given in another unit."""

    def change(points: Points) -> Points:
        points["time"] *= scale
        return points

    return change


def without_times(points: Points) -> Points:
    return recfunctions.drop_fields(points, "time", usemask=False)


def big_endian(points: Points) -> Points:
    """Against the flag that the message has."""
    return points.astype(points.dtype.newbyteorder(">"))


def no_rings(points: Points) -> Points:
    return recfunctions.drop_fields(points, "ring", usemask=False)


def in_a_plane(points: Points) -> Points:
    """The beam next to the horizon, as a 2-D lidar's driver sends it."""
    flat = points[points["ring"] == 7]
    flat["z"] = 0.0
    return flat


def radar(topic: str, count: int) -> list[Row]:
    """A RADAR's clouds: other fields, its own rate, and nothing where it says."""
    kind = np.dtype([(name, "<f4") for name in ("x", "y", "z", "velocity", "rcs")])
    made, rng = [], np.random.default_rng(1)
    for stamp_ns in range(START_NS, START_NS + 1_600_000_000, 77_000_000):
        points = np.zeros(count, kind)
        points["x"], points["y"], points["z"] = rng.uniform([[1], [-5], [0]], [[20], [5], [2]], (3, count))
        made.append((topic, stamp_ns + 10_000_000, CLOUD, encoded(points, stamp_ns, "radar")))
    return made


NOTHING_TO_SEE = (filled(np.nan), filled(-np.inf), filled(0.0), filled(1e30), high_up(0), high_up(1), high_up(10))
AT = dict(zip((2, 3, 6, 7, 9, 11, 13), NOTHING_TO_SEE, strict=True))


class Case(NamedTuple):
    """Clouds, and what comes of them: exit code, the only warning, counts, a note; `as_if`: the maps are these ones."""

    change: Any = as_sensed
    options: Mapping[str, Any] = {}
    flags: tuple[str, ...] = ()
    code: int = 0
    warning: str = ""
    counts: Mapping[str, int] = {}
    note: str = ""
    as_if: Any = None
    honest: bool = False
    """Nothing false is drawn."""


SOUND: tuple[Any, dict[str, Any]] = (as_sensed, {})
CASES = {
    "nothing to see": Case(
        AT, warning="7 of 16 scans: fewer than 20 points", counts={"scans": 16, "scans_without_points": 7},
        note="9 of 9 scans classified", as_if=(left_out, {"which": tuple(AT)}),
    ),
    "starts late": Case(
        high_up(0), {"which": range(7)}, warning="7 of 16 scans: fewer than 20 points",
        as_if=(left_out, {"which": range(7)}),
    ),
    "bad points": Case(spoilt, as_if=SOUND),
    "bad points and no rings, paper": Case(
        lambda points: no_rings(spoilt(points)), flags=("lidar.method=paper",), as_if=SOUND
    ),
    "times in microseconds": Case(timed(1e6), as_if=SOUND),
    "times as shares of a scan": Case(timed(10), as_if=SOUND),
    "times in no unit": Case(
        timed(30), warning="16 of 16 scans are not deskewed: time of points spans", as_if=(without_times, {})
    ),
    "big-endian without a word": Case(big_endian, warning=f"{LIDAR_TOPIC}: is_bigendian is wrong", as_if=SOUND),
    "no rings": Case(no_rings, note="by beams, from the points' elevations", honest=True),
    "of many sizes": Case(thinned, honest=True),
    "of many sizes, paper": Case(thinned, flags=("lidar.method=paper",), honest=True),
    "all empty": Case(high_up(0), code=1, warning="all its 16 scans are empty"),
    "all empty but wanted": Case(
        filled(0.0), flags=(f"topics.lidar={LIDAR_TOPIC}",), warning="16 of 16 scans: fewer than 20 points"
    ),
    "more claimed than there": Case(
        as_sensed, {"which": BAD, "claimed": 1_000_000}, code=3, counts={"scans": 12}, as_if=(left_out, {"which": BAD})
    ),
    "a radar of few points": Case(options={"beside": radar("/ars430", 30)}, as_if=SOUND),
    "two that could be": Case(
        options={"beside": radar("/ars430", 400)}, code=1, warning=f"or  --set topics.lidar={LIDAR_TOPIC}"
    ),
    "two, one chosen": Case(
        options={"beside": radar("/ars430", 400)}, flags=(f"topics.lidar={LIDAR_TOPIC}",), as_if=SOUND
    ),
    "late beside a radar": Case(
        high_up(0), {"which": range(7), "beside": radar("/ars430", 30)}, code=1, warning="--set topics.lidar=/ars430"
    ),
    "a radar alone": Case(left_out, {"beside": radar("/ars430", 19)}, warning="a radar rather than a lidar"),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_what_clouds_draw(name, mapped, sound_maps):
    case = CASES[name]
    flags = [word for each in case.flags for word in ("--set", each)]
    done = mapped(case.change, *flags, **case.options)
    assert done.code == case.code, done.err
    if done.code == 1:
        assert case.warning in done.err
        return
    of_scans = [text for text in done.warned if "scans" in text or LIDAR_TOPIC in text]
    assert [case.warning in text for text in of_scans] == ([True] if case.warning else [])
    assert case.counts.items() <= done.record["counts"].items()
    assert any(case.note in note for note in done.record["notes"])
    if case.honest:
        assert share_false(places(done)) < FALSE_SHARE[case.flags[0].partition("=")[2] if case.flags else "range_image"]
    if case.as_if:
        change, options = case.as_if
        key = (change, str(options), case.flags)
        if key not in sound_maps:
            sound_maps[key] = maps_of(mapped(change, *flags, **options))
        assert maps_of(done) == sound_maps[key]


def share_false(maps: list[tuple[int, np.ndarray]]) -> float:
    """Of all occupied cells, those with nothing within 0.3 m of them."""
    off = np.concatenate([from_anything(t_ns, centres_m) for t_ns, centres_m in maps])
    assert len(off) > 1000
    return float(np.mean(off > 0.3))


def test_without_memory_a_scan_that_shows_nothing_frees_nothing(mapped):
    """An all-free map would send the robot through walls."""
    done = mapped(filled(np.nan), *by("range_image", "scan"), which=BAD)
    assert len(places(done)) == SCANS - len(BAD)
    assert all(len(centres_m) > 100 for _, centres_m in places(done))


def test_a_log_of_scans_that_show_nothing_has_no_map(mapped):
    done = mapped(high_up(1), "--until", "report")
    assert (done.code, len(load_maps(done.run)), (done.run / "map.pgm").exists()) == (0, 0, False)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("which", [range(SCANS), BAD], ids=["all", "some"])
def test_2d_scans_draw_what_they_hit_and_are_said_to_know_no_ground(mapped, method, which):
    """Their plane is no ground, and their returns lie at the mount's height, which is not given here: they block."""
    done = mapped(in_a_plane, *by(method), "--set", "lidar.mount.z_m=0.0001", which=which)
    assert (done.code, done.record["counts"]["scans_without_ground"]) == (0, len(which))
    assert any(f"{len(which)} of 16 scans: no ground is found, as in a 2-D scan" in text for text in done.warned)
    assert not done.table("scans")["n_ground"][list(which)].any()
    # What a person who walked away leaves behind would be false as well.
    assert share_false(places(done)) < FALSE_SHARE[method]
    assert min((from_anything(t_ns, centres_m) < 0.15).sum() for t_ns, centres_m in places(done)) > 60
