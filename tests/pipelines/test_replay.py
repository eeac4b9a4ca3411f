"""A replay of the committed recording: its files, against the truth that came with it, and what each option changes."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import MissingInput, QuadlogError
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import finished_outcome, replay
from quadlog.pipelines.request import Existing
from quadlog.results.arrays import load_maps
from quadlog.results.tables import read_table
from quadlog.simulation.synthetic.follow import synthesize
from tests.lab.clouds import from_obstacle
from tests.pipelines.conftest import FIXTURES, SHORT_S, fixture_request, results_of

CONTRACT_FILES = {
    *("run.json", "config.toml", "metrics.json", "report.html", "derived.mcap", "foxglove-layout.json"),
    *("fixes.parquet", "ranges.parquet", "poses.parquet", "target.parquet", "scans.parquet", "plans.parquet"),
    *("paths.parquet", "astar.parquet", "control.parquet", "clearances.parquet", "resim_plans.parquet"),
    *("contacts.parquet", "resim_paths.parquet", "maps.npz", "cloud_samples.npz", "ground.npz", "trajectory.tum"),
    *("map.pgm", "map.yaml", "links.parquet", "uwb_errors.parquet", "innovations.parquet"),
    *("pose_uncertainty.parquet", "reference.tum"),
}
START_NS = 1_767_225_600_000_000_000


@pytest.fixture
def replayed(tmp_path):
    """Replays the beginning of the recording with settings and options into a new folder, without pictures."""
    count = iter(range(100))

    def go(*sets, preset=None, progress=None, **options):
        config = load_config(FIXTURES / "follow.toml", list(sets), preset=preset)
        request = fixture_request(tmp_path / str(next(count)), **({"until": "position"} | options))
        return replay(replace(request, config=config, plots=False), progress or Silent())

    return go


def test_every_file_of_the_contract_is_there_and_nothing_half_written(short_run, located_run):
    assert {path.name for path in short_run.run.iterdir() if path.is_file()} == CONTRACT_FILES
    assert {path.suffix for path in (short_run.run / "plots").iterdir()} == {".png"}
    names = {path.name for path in located_run.run.iterdir() if path.is_file()}
    assert {"fixes.parquet", "poses.parquet", "metrics.json", "run.json", "report.html"} <= names
    assert not {"scans.parquet", "maps.npz", "plans.parquet", "control.parquet"} & names
    assert "eta_m" not in located_run.metrics


def test_tables_agree_with_each_other(short_run):
    scans, plans, control = (read_table(short_run.run, name) for name in ("scans", "plans", "control"))
    maps = load_maps(short_run.run)
    assert len(scans["t_ns"]) == len(maps) == round(SHORT_S * 10)
    parts = scans["n_outlier"] + scans["n_ground"] + scans["n_obstacle"]
    assert (parts <= scans["n_valid"]).all()
    assert (scans["n_valid"] <= scans["n_raw"]).all()
    assert set(plans["t_ns"]) <= set(maps.t_ns.tolist())
    assert (plans["cost"] >= plans["optimal_cost"]).all()
    assert np.allclose(control["error_m"], np.abs(control["cross_track_m"]), equal_nan=True)
    assert np.allclose(np.diff(control["t_ns"]), 20e6, atol=1)
    assert np.isfinite(control["tau_00_nm"]).all()
    assert not control["fallen"].any()


def test_run_json_and_the_page_say_how_the_run_came_about(short_run, replayed):
    record = json.loads((short_run.run / "run.json").read_text())
    assert record["recorded_s"] == pytest.approx(SHORT_S, abs=0.1)
    stages = ["ingest", "position", "filter", "map", "plan", "control", "report"]
    assert [stage["name"] for stage in record["stages"]] == stages
    assert record["input"]["size_bytes"] == (FIXTURES / "follow.mcap").stat().st_size
    assert {topic["role"] for topic in record["topics"]} >= {"lidar", "uwb", "odometry", "reference"}
    assert all(topic["why"] for topic in record["topics"])
    assert "robot position from uwb, target from uwb" in record["notes"]
    assert "robot position from uwb, target from uwb" in (short_run.run / "report.html").read_text()
    other = replayed("topics.position=odometry", "topics.target=ahead", duration_s=0.5)
    topics = json.loads((other.run / "run.json").read_text())["topics"]
    assert {topic["role"] for topic in topics} == {"odometry", "reference"}


def test_the_effective_config_gives_the_same_run(short_run, tmp_path):
    config = load_config(short_run.run / "config.toml")
    replay(replace(fixture_request(tmp_path / "again"), config=config, plots=False), Silent())
    there = {name: each for name, each in results_of(short_run.run).items() if not name.startswith("plots/")}
    assert there == results_of(tmp_path / "again")


def test_poses_are_true_and_the_map_holds_the_obstacles_that_were_there_and_no_wall_is_ground(whole_run):
    assert whole_run.metrics["ate_rmse_m"]["value"] < 0.25
    site, maps, hits = synthesize(seed=0, duration_s=0.2, azimuth_steps=8).site, load_maps(whole_run.run), {}
    for each in maps:
        for row, col in np.argwhere(each.occupied):
            cell = tuple(np.rint(each.origin_m / maps.cell_m).astype(int) + np.array([col, row]))
            hits[cell] = hits.get(cell, 0) + 1
    often = np.array([cell for cell, count in hits.items() if count >= 20]) * maps.cell_m + maps.cell_m / 2
    assert len(often) > 50
    assert np.mean(np.min([from_obstacle(each, often) for each in site.obstacles], axis=0) < 0.4) > 0.9
    record = json.loads((whole_run.run / "run.json").read_text())
    assert "120 of 120 scans classified by beams, from the points' ring numbers" in record["notes"]
    assert any(note.startswith("tag 0: velocities by odometry steady its track") for note in record["notes"])
    assert read_table(whole_run.run, "scans")["ground_nz"].min() > np.cos(np.radians(5))


def test_a_wall_taken_for_the_ground_is_said_and_is_no_ground(replayed):
    """By the paper's method only: quadlog's own takes none."""
    paper = replayed(preset="paper", until="map")
    record = json.loads((paper.run / "run.json").read_text())
    steep = record["counts"]["scans_with_steep_ground"]
    assert steep == (read_table(paper.run, "scans")["ground_nz"] < np.cos(np.radians(45))).sum() > 0
    assert any(f"{steep} of {record['counts']['scans']} scans" in text for text in record["warnings"])
    height_m = np.load(paper.run / "ground.npz")["height_m"]
    assert np.nanpercentile(np.abs(height_m), 99) < 0.4  # walls of 1.5 m and more, when they are counted as ground


def test_start_and_duration_cut_the_recording_by_the_clock_that_is_chosen(replayed):
    first_s = {}
    for stamp in ("header", "log"):
        run = replayed(start_s=2.0, duration_s=1.0, until="filter", stamp=stamp).run
        for name in ("scans", "poses", "ranges"):
            t_s = (read_table(run, name)["t_ns"] - START_NS) * 1e-9
            assert (t_s.min() >= 2.0 - 1e-6, t_s.max() < 3.0 + 1e-6) == (True, True)
        first_s[stamp] = (read_table(run, "scans")["t_ns"][0] - START_NS) * 1e-9
    assert 0 < (first_s["log"] - first_s["header"]) % 0.1 < 0.1  # scans are logged when they are complete


def test_a_replay_that_cannot_work_says_so_and_harms_no_earlier_run(tmp_path):
    request = fixture_request(tmp_path / "run", duration_s=0.5, until="position")
    first = replay(request, Silent())
    nothing = replace(request, options=replace(request.options, start_s=100.0), existing=Existing.FORCE)
    with pytest.raises(QuadlogError, match=r"lasts 12\.0 s"):
        replay(nothing, Silent())
    without = load_config(FIXTURES / "follow.toml", ["topics.position=tf"])
    for folder in (tmp_path / "run", tmp_path / "new"):
        with pytest.raises(MissingInput, match=r"topics\.position = 'tf'"):
            replay(replace(request, run=folder, config=without, existing=Existing.FORCE), Silent())
    assert not (tmp_path / "new").exists()
    assert finished_outcome(request).metrics == first.metrics


@pytest.mark.parametrize(
    ("position", "target", "source"),
    [
        ("odometry", "ahead", "odometry"),
        ("odometry", "uwb", "odometry"),
        ("fixed", "fixed", "fixed"),
        ("uwb", "/truth/person/pose", "uwb"),
        ("FILE", "uwb", "file"),
    ],
)
def test_other_sources_of_position_and_target(position, target, source, short_run, replayed):
    chosen = str(short_run.run / "trajectory.tum") if position == "FILE" else position
    sets = [f"topics.position={chosen}", f"topics.target={target}", "topics.target_x_m=3.0"]
    outcome = replayed(*sets, until="plan", duration_s=1.0)
    poses = read_table(outcome.run, "poses")
    assert (set(poses["source"]), set(read_table(outcome.run, "target")["source"])) == ({source}, {target})
    assert read_table(outcome.run, "plans")["found"].any()
    # Odometry is in its own frame: its distance to a truth in map would be a wrong number.
    assert ("ate_rmse_m" in outcome.metrics) == (source in ("uwb", "file"))
    if source == "file":
        there = read_table(short_run.run, "poses")["x_m"][: len(poses["x_m"])]
        np.testing.assert_allclose(poses["x_m"], there, atol=1e-6)


def test_a_causal_run_is_no_smoothed_one_and_does_not_depend_on_the_future(short_run, replayed):
    causal = ("uwb.smooth=false", "uwb.calibrate=false")
    early, late = (read_table(replayed(*causal, duration_s=s).run, "poses") for s in (1.5, 3.0))
    count = len(early["t_ns"]) - 2
    for name in ("x_m", "y_m", "yaw_rad"):
        np.testing.assert_allclose(early[name][:count], late[name][:count], atol=1e-9)
    smoothed = read_table(short_run.run, "poses")
    assert not np.allclose(smoothed["x_m"], late["x_m"], atol=1e-3)


def test_what_was_seen_stays_in_the_map_until_it_is_seen_through(replayed):
    """Without memory cells flicker from scan to scan; with it few of those that were there are gone the next time."""
    kept = {}
    for memory in ("log_odds", "scan"):
        maps = list(load_maps(replayed(f"grid.memory={memory}", until="map", duration_s=2.0).run))
        pairs = [(a, b) for a, b in pairwise(maps) if (a.origin_m == b.origin_m).all()]
        kept[memory] = np.mean([(a.occupied & b.occupied).sum() / a.occupied.sum() for a, b in pairs])
    assert kept["log_odds"] > 0.9 > kept["scan"]


def test_a_resimulated_walk_on_simpler_forces_says_so(replayed, monkeypatch):
    """A solver without an answer, and feet that may not carry the robot."""
    monkeypatch.setattr("quadlog.control.locomotion.force_qp._OPTIMAL", None)
    run = replayed("mpc.f_max_n=21.0", until="control", duration_s=0.5).run
    record = json.loads((run / "run.json").read_text())
    failed = record["counts"]["mpc_failed"] + record["counts"]["wbc_failed"]
    assert f"{failed} QPs failed; simpler forces were used: see counts" in record["warnings"]
    assert any("two feet of mpc.f_max_n = 21 N may not carry it" in text for text in record["warnings"])


NO_WALK = "simulation.controller=none"
TAGS = "uwb.tags=[{id=0, role='robot', x_m=-0.07}, {id=1, role='person', height_m=1.3}]"
CONFIGURATIONS = {
    "kinematic": (None, "plan", ["simulation.controller=kinematic"]),
    "fpmw": (None, "control", ["simulation.disturbances.push_n=60.0"]),
    "fpm": (None, "control", ["simulation.controller=fpm", "simulation.gait=walk", "grid.extent=run"]),
    "odometry": (None, "control", ["topics.position=odometry", "topics.target=ahead", "grid.memory=scan", NO_WALK]),
    "fixed": (None, "control", ["topics.position=fixed", "topics.target=fixed", "lidar.level=false", NO_WALK]),
    "lidar": (None, "plan", ["topics.position=lidar", "topics.target=ahead", "grid.dilation=body"]),
    "causal": (None, "map", ["uwb.smooth=false", "uwb.method=huber", "uwb.odometry=true", "lidar.odometry=true"]),
    "tags": (None, "map", [TAGS, "smoothing.enabled=false", "lidar.mount.z_m=0.5"]),
    "papers'": ("paper", "control", [NO_WALK]),
    "papers' filter": ("paper", "filter", []),
}


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_a_stage_needs_no_key_that_it_is_not_given(name, replayed):
    """A stage sees the keys that its result's name is made of, and no others, whatever is configured."""
    preset, until, sets = CONFIGURATIONS[name]
    assert replayed(*sets, preset=preset, until=until, duration_s=0.5).exit_code == 0
