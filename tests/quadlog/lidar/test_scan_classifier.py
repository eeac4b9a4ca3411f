from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.geometry import transform_from_rpy
from quadlog.lidar.classified_scan import PointClass
from quadlog.lidar.paper_method import PaperSettings
from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier
from quadlog.messages import PointCloud
from quadlog.recordings.recording import open_recording
from tests.lab.labelled_scans import labelled_scans

LEVEL = transform_from_rpy(np.array([0.0, 0.0, 0.5]), 0.0, 0.0, 0.0)
ALL_ROUND = RangeImageSettings()
# The constants were chosen on seed 100.
HELD_OUT_SEED = 7
PLACES = ("flat", "undulating", "ramp_15", "ramp_20", "slope_15", "corridor", "wall_ahead", "forest")
EXTREMES = st.sampled_from([0.0, -0.0, 1.0, -2.5, 7.0, 29.0, 1e-30, 1e30, -3e38, np.nan, np.inf, -np.inf])


@pytest.fixture(scope="module")
def scans():
    """name -> held-out labelled scans, two of each place: one standing still and one in mid-gait."""
    return {name: list(labelled_scans(name, HELD_OUT_SEED, 2)) for name in PLACES}


@pytest.fixture(scope="module")
def classified(classify):
    """A function that classifies a labelled scan by itself, as it is or with other rings, mount or places."""

    def made(scan, ring=None, transform=None, xyz_m=None, classifier=None):
        mount = scan.transform_lidar_to_base if transform is None else transform
        points = scan.xyz_lidar_m if xyz_m is None else xyz_m
        return classify(points, scan.ring if ring is None else ring, mount, ALL_ROUND, classifier=classifier)

    return made


def share(wanted: np.ndarray, among: np.ndarray) -> float:
    return np.count_nonzero(wanted & among) / max(np.count_nonzero(among), 1)


def cells_of(xyz_m: np.ndarray) -> set[tuple[int, int]]:
    return {(x, y) for x, y in np.floor(xyz_m[:, :2] / 0.1).astype(int).tolist()}


@pytest.mark.parametrize(("name", "precision", "recall"), [
    ("flat", 0.98, 0.98), ("undulating", 0.98, 0.98), ("ramp_15", 0.97, 0.97), ("ramp_20", 0.97, 0.97),
    ("slope_15", 0.97, 0.97), ("corridor", 0.92, 0.94), ("wall_ahead", 0.96, 0.98), ("forest", 0.96, 0.97),
])  # fmt: skip
def test_held_out_scans(classified, scans, name: str, precision: float, recall: float) -> None:
    """Ground with these shares right and found; outliers; heights; and cells of obstacles, where much is in sight."""
    outliers_of = []
    for scan in scans[name]:
        found = classified(scan)
        assert found.route == "rings"
        looked_at, outlier = found.label > PointClass.CROPPED, found.label == PointClass.OUTLIER
        ground, truth = found.label == PointClass.GROUND, scan.truth == PointClass.GROUND
        assert share(truth, ground) >= precision
        assert share(ground, truth & looked_at) >= recall
        off_m = np.abs(found.height_m - np.where(ground & truth, 0, scan.height_m))
        assert off_m[ground & truth].max() < 0.31
        assert np.quantile(off_m[ground & truth], 0.99) < 0.1
        wrong, real = scan.truth == PointClass.OUTLIER, scan.truth == PointClass.OBSTACLE
        parts = wrong & looked_at, wrong & outlier, looked_at, outlier
        outliers_of.append([np.count_nonzero(each) for each in parts])
        seen = found.label == PointClass.OBSTACLE
        if name in ("flat", "ramp_20", "undulating"):
            assert np.quantile(off_m[(np.hypot(*found.xyz_base_m[:, :2].T) < 6) & real & seen], 0.9) < 0.1
        if name in ("flat", "corridor", "wall_ahead"):
            near = np.abs(found.xyz_base_m[:, :2]).max(axis=1) < 10
            high, truly_high = ((each >= 0.05) & (each <= 1.5) for each in (found.height_m, scan.height_m))
            cells, true_cells = (cells_of(found.xyz_base_m[near & each]) for each in (high & seen, truly_high & real))
            assert len(cells & true_cells) / len(true_cells) >= (0.95 if name == "flat" else 0.99)
            assert len(cells - true_cells) <= 20
    false, found_false, all_of, found_all = np.sum(outliers_of, axis=0)
    assert found_false / false >= 0.85
    assert (found_all - found_false) / (all_of - false) <= 0.003


def test_dust_right_before_the_lidar_has_no_support_from_empty_cells(classify, room_scan) -> None:
    """Their range is 0, and so is near that of dust; the rays beside it return nothing, as under an open sky."""
    xyz_m, ring, *_ = room_scan(LEVEL)
    dust = np.random.default_rng(3).choice(len(ring), 200, replace=False)
    dust_m = xyz_m[dust] * (0.051 / np.linalg.norm(xyz_m[dust], axis=1))[:, None].astype(np.float32)
    xyz_m[np.unique(np.concatenate([dust + 16 * step for step in range(-4, 5)])) % len(ring)] = 0.0
    xyz_m[dust] = dust_m
    found = classify(xyz_m, ring, LEVEL, RangeImageSettings(min_range_m=0.05))
    assert (found.label[dust] == PointClass.OUTLIER).sum() >= 180


WRONG_RINGS = ["none", "random", "short", "column"]
RIGHT_RINGS = ["shuffled", "gaps", "reversed"]


@pytest.mark.parametrize("change", [*WRONG_RINGS, *RIGHT_RINGS, "every second ring", "every second step", "overhead"])
def test_wrong_ring_numbers_are_ignored_and_a_sensor_that_changes_is_noticed(classified, scans, change: str) -> None:
    """What was found out about the beams of earlier scans is not used for those of another sensor."""
    scan, before = scans["wall_ahead"][0], scans["corridor"][0]
    ring, n, random = scan.ring, len(scan.ring), np.random.default_rng(0)
    turn, mount = transform_from_rpy(np.zeros(3), np.pi, 0.0, 0.0), scan.transform_lidar_to_base
    kept = {"every second ring": ring % 2 == 0, "every second step": np.arange(n) // 16 % 2 == 0}.get(change, ring >= 0)
    xyz_m, ring = scan.xyz_lidar_m[kept], ring[kept]
    if change == "overhead":
        xyz_m, mount = (xyz_m @ turn[:3, :3]).astype(np.float32), mount @ turn
    numbers = {
        "none": np.zeros(0),
        "random": random.integers(0, 16, n),
        "short": ring[:-1],
        "column": np.arange(n) // 16,
        "shuffled": random.permutation(16)[ring],
        "gaps": ring * 13 + 5,
        "reversed": 15 - ring,
        "every second ring": ring // 2,
    }.get(change, ring)
    used = ScanClassifier(ALL_ROUND)
    classified(before, classifier=used)
    alone, after = (classified(scan, numbers.astype(np.uint16), mount, xyz_m, each) for each in (None, used))
    assert alone.route == after.route == ("elevations" if change in WRONG_RINGS else "rings")
    assert after.label.tobytes() == alone.label.tobytes()
    assert change not in WRONG_RINGS + RIGHT_RINGS or alone.label.tobytes() == classified(scan).label.tobytes()


def test_a_scan_without_returns_does_not_contradict_the_beams(scans) -> None:
    used, scan = ScanClassifier(ALL_ROUND), scans["corridor"][0]
    clouds = [PointCloud(None, "", scan.xyz_lidar_m * np.float32(each), scan.ring) for each in (1, np.nan)]
    assert [used.classify(cloud, scan.transform_lidar_to_base).route for cloud in clouds] == ["rings", "rings"]


@pytest.mark.parametrize("change", [(180, 0), (0, 90), (0, 200), (180, -40), "shuffled", np.nan, np.inf, 0.0, 1e30])
def test_mount_order_and_bad_points_change_nothing_about_good_points(classified, scans, change) -> None:
    """But for a few: which of the points tell the phase differs, so that these may fall into other cells."""
    scan = scans["wall_ahead"][0]
    xyz_m, mount, order = scan.xyz_lidar_m, scan.transform_lidar_to_base, np.arange(len(scan.ring))
    if isinstance(change, tuple):
        turn = transform_from_rpy(np.zeros(3), *np.deg2rad([change[0], 0.0, change[1]]))
        xyz_m, mount = (xyz_m @ turn[:3, :3]).astype(np.float32), mount @ turn
    elif change == "shuffled":
        order = np.random.default_rng(1).permutation(order)
    else:
        order = np.repeat(order, 2)
    xyz_m, wanted = xyz_m[order], classified(scan).label[order]
    if isinstance(change, float):
        xyz_m[::2], wanted[::2] = change, PointClass.INVALID
    result = classified(scan, ring=scan.ring[order], xyz_m=xyz_m, transform=mount)
    assert result.route == "rings"
    assert (result.label == wanted).mean() > 0.99
    assert ((result.label == PointClass.INVALID) == (wanted == PointClass.INVALID)).all()


@pytest.mark.parametrize(("roll_deg", "pitch_deg", "half_view_deg", "known"), [
    (10, 0, 15, True), (0, 15, 15, True), (-12, 8, 15, True), (180, 0, 15, True), (0, 0, 15, False), (0, 0, 35, False),
])  # fmt: skip
def test_floor_and_walls_are_found_from_a_tilted_or_unknown_mount(
    classify, room_scan, roll_deg: float, pitch_deg: float, half_view_deg: float, known: bool
) -> None:
    height_m = 0.5 if known else 0.9
    mount = transform_from_rpy(np.array([0.0, 0.0, height_m]), *np.deg2rad([roll_deg, pitch_deg, 0.0]))
    xyz_m, ring, floor, _ = room_scan(mount, half_view_deg=half_view_deg)
    result = classify(xyz_m, ring, mount if known else np.eye(4), ALL_ROUND)
    ground = result.label == PointClass.GROUND
    assert result.route == "rings"
    assert min(share(floor, ground), share(ground, floor)) > 0.95
    assert result.ground.normal == pytest.approx([0, 0, 1], abs=0.02)
    assert result.ground.d_m == pytest.approx(0 if known else height_m, abs=0.02)


@pytest.mark.parametrize(("mount", "height_m"), [(LEVEL, 0.5), (np.eye(4), 0.1)], ids=["known", "unknown mount"])
@pytest.mark.parametrize(
    ("ring", "settings", "most_outliers"),
    [(None, ALL_ROUND, 0), (np.zeros(720, np.uint16), ALL_ROUND, 0), (None, PaperSettings(field_of_view_deg=360), 120)],
    ids=["no rings", "rings", "paper"],
)
def test_a_flat_scan_is_all_obstacles(classify, ring, settings, most_outliers, mount, height_m) -> None:
    """Not all of it lies on the floor, whatever the mount is."""
    turn_rad = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    circle_m = 4 * np.column_stack([np.cos(turn_rad), np.sin(turn_rad), np.zeros(720)])
    result = classify(circle_m.astype(np.float32), ring, mount, settings)
    *others, outliers, ground, obstacles = result.counts
    assert (others, ground, outliers + obstacles, result.ground) == ([0, 0], 0, 720, None)
    assert outliers <= most_outliers
    assert result.height_m == pytest.approx(height_m)


def test_a_wall_alone_is_no_ground(classify) -> None:
    """No floor in view: whatever is seen rises, from the first beam on."""
    y, z = (each.ravel() for each in np.meshgrid(np.linspace(-2, 2, 200), np.linspace(-0.4, 0.4, 16)))
    ring = np.round(np.rad2deg(np.arctan2(z, np.hypot(1.2, y))) / 2 + 20).astype(np.uint16)
    result = classify(np.column_stack([np.full(len(y), 1.2), y, z]).astype(np.float32), ring, LEVEL, ALL_ROUND)
    assert result.counts[PointClass.GROUND] < 0.02 * len(ring)


@pytest.mark.parametrize(
    "settings",
    [
        *(RangeImageSettings(), RangeImageSettings(field_of_view_deg=200)),
        *(PaperSettings(field_of_view_deg=each, ground_min_points=3, outlier_neighbours=2) for each in (90, 360)),
    ],
)
@given(
    arrays(np.float32, st.tuples(st.integers(0, 150), st.just(3)), elements=EXTREMES | st.floats(width=32))
    | st.builds(np.full, st.tuples(st.integers(0, 500), st.just(3)), EXTREMES, st.just(np.float32)),
    st.sampled_from(["none", "constant", "counting", "huge", "random"]),
    st.integers(0, 2**32),
    st.floats(-np.pi, np.pi),
    st.floats(-np.pi, np.pi),
)
def test_any_cloud_is_classified(classify, settings, cloud, ring: str, seed: int, roll_rad, pitch_rad) -> None:
    n = len(cloud)
    random = np.random.default_rng(seed).integers(0, 40, n)
    made = {"constant": np.zeros(n), "counting": np.arange(n), "huge": np.full(n, 65535), "random": random}
    numbers = made[ring].astype(np.uint16) if ring in made else None
    mount = transform_from_rpy(np.array([0.0, 0.0, 0.5]), roll_rad, pitch_rad, 0.0)
    scan, again = (classify(cloud, numbers, mount, settings, seed) for _ in range(2))
    with np.errstate(over="ignore", invalid="ignore"):
        range_m = np.linalg.norm(cloud.astype(np.float64), axis=1)
    clear = ~(np.abs(range_m - 0.3) < 1e-3) & ~(np.abs(range_m - 30) < 1e-3)
    valid = (range_m >= 0.3) & (range_m <= 30)
    assert ((scan.label != PointClass.INVALID) == valid)[clear].all()
    assert (np.isfinite(scan.height_m) == (scan.label != PointClass.INVALID)).all()
    x_m, y_m = scan.xyz_base_m[:, :2].T
    beside_deg = np.rad2deg(np.abs(np.arctan2(y_m, x_m))) - settings.field_of_view_deg / 2
    clear = (np.abs(beside_deg) > 0.1) & (np.hypot(x_m, y_m) > 0.01)
    assert ((scan.label == PointClass.CROPPED) == (beside_deg > 0))[clear].all()
    assert scan.ground is None or scan.counts[PointClass.GROUND] >= settings.ground_min_points
    assert again.label.tobytes() == scan.label.tobytes()


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
@pytest.mark.parametrize("name", ["vlp16", "helios16p"])
def test_real_scans_are_split_without_rings(classify, name: str) -> None:
    with open_recording(Path(os.environ["QUADLOG_DATASETS"]) / "lidar_16beam" / f"{name}.mcap") as recording:
        messages = [each.message for each in recording.messages([each.topic for each in recording.channels])]
    for cloud in (each for each in messages if isinstance(each, PointCloud)):
        scan = classify(cloud.xyz_m, None, np.eye(4), ALL_ROUND)
        assert scan.route == "elevations"
        _, _, outliers, ground, obstacles = scan.counts
        assert (ground > 1000, obstacles > 500, scan.ground.normal[2] > 0.97) == (True, True, True)
        assert outliers < 0.1 * (outliers + ground + obstacles)


@pytest.mark.parametrize("slope", [0.0, 0.15, np.tan(np.deg2rad(20))])
@pytest.mark.parametrize("box_height_m", [0.3, 0.8])
def test_a_floor_and_what_stands_on_it_without_beams(classify, slope: float, box_height_m: float) -> None:
    """20,000 points of a floor and of the top of a box of 2 m on it."""
    random = np.random.default_rng(0)
    xy_m = random.uniform(-8, 8, (20_000, 2))
    box = (np.abs(xy_m - [4, 0]) < 1).all(axis=1)
    z_m = slope * xy_m[:, 0] + box_height_m * box + random.normal(0, 0.005, len(xy_m))
    xyz_m = np.column_stack([xy_m, z_m]) - LEVEL[:3, 3]
    result = classify(xyz_m.astype(np.float32), None, LEVEL, ALL_ROUND)
    assert result.route == "height_map"
    looked_at, inside = (result.label > PointClass.OUTLIER) & ~box, (result.label > PointClass.OUTLIER) & box
    assert (result.label[looked_at] == PointClass.GROUND).mean() > 0.95
    assert (result.label[inside] == PointClass.OBSTACLE).mean() > 0.95
    assert np.median(result.height_m[inside]) == pytest.approx(box_height_m, abs=0.1)
