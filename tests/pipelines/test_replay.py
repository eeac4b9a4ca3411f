from __future__ import annotations

import json
import shutil
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from evo.core import metrics as evo_metrics
from evo.core import sync
from evo.tools import file_interface

from quadlog.config.file import load_config
from quadlog.errors import AlreadyExists, EmptyWindow, MissingInput
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.replay import finished_outcome, replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.results.arrays import load_maps
from quadlog.simulation.synthetic.follow import synthesize

CONTRACT_FILES = {
    *("run.json", "config.toml", "metrics.json", "report.html", "derived.mcap", "foxglove-layout.json"),
    *("fixes.parquet", "ranges.parquet", "poses.parquet", "target.parquet", "scans.parquet", "plans.parquet"),
    *("paths.parquet", "astar.parquet", "control.parquet", "clearances.parquet", "resim_plans.parquet"),
    "contacts.parquet",
    "resim_paths.parquet",
    *("maps.npz", "cloud_samples.npz", "ground.npz", "trajectory.tum", "map.pgm", "map.yaml"),
    *("links.parquet", "dilution.npz", "uwb_errors.parquet", "innovations.parquet", "pose_uncertainty.parquet"),
}
SHORT_S = 3.0
pytestmark = pytest.mark.usefixtures("without_pictures")  # but the shared runs have them


def table(run, name):
    return dict(pq.read_table(run / f"{name}.parquet").to_pandas().items())


def test_every_file_of_the_contract_is_there_and_nothing_half_written(short_run):
    names = {path.name for path in short_run.run.iterdir() if path.is_file()}
    assert names == CONTRACT_FILES | {"reference.tum"}
    assert {path.suffix for path in (short_run.run / "plots").iterdir()} == {".png"}
    assert short_run.exit_code == 0


def test_tables_agree_with_each_other(short_run):
    run = short_run.run
    scans, plans, control = table(run, "scans"), table(run, "plans"), table(run, "control")
    maps = load_maps(run)
    assert len(scans["t_ns"]) == round(SHORT_S * 10)
    parts = scans["n_outlier"] + scans["n_ground"] + scans["n_obstacle"]
    assert (parts <= scans["n_valid"]).all()
    assert (scans["n_valid"] <= scans["n_raw"]).all()
    assert len(maps) == len(scans["t_ns"])
    assert set(plans["t_ns"]) <= set(maps.t_ns.tolist())
    assert (plans["cost"] >= plans["optimal_cost"]).all()
    assert np.allclose(control["error_m"], np.abs(control["cross_track_m"]), equal_nan=True)
    assert np.allclose(np.diff(control["t_ns"]), 20e6, atol=1)
    assert control["tau_00_nm"].notna().all()
    assert not control["fallen"].any()


def test_run_json_tells_how_the_run_came_about(short_run, fixtures):
    record = json.loads((short_run.run / "run.json").read_text())
    assert record["recorded_s"] == pytest.approx(SHORT_S, abs=0.1)
    assert [stage["name"] for stage in record["stages"]] == [
        *("ingest", "position", "filter", "map", "plan", "control", "report")
    ]
    assert record["input"]["size_bytes"] == (fixtures / "follow.mcap").stat().st_size
    assert {topic["role"] for topic in record["topics"]} >= {"lidar", "uwb", "odometry", "reference"}
    assert all(topic["why"] for topic in record["topics"])
    assert record["realtime_factor"] > 0


def test_the_effective_config_gives_the_same_run(short_run, tmp_path, follow_request, saved):
    config = load_config(short_run.run / "config.toml", environ={})
    request = replace(follow_request(tmp_path / "again"), config=config)
    replay(request, Silent())
    there = {name: each for name, each in saved(short_run.run).items() if not name.startswith("plots/")}
    assert there == saved(tmp_path / "again")


def test_poses_follow_the_truth_and_evo_agrees(whole_run):
    reference = file_interface.read_tum_trajectory_file(str(whole_run.run / "reference.tum"))
    estimate = file_interface.read_tum_trajectory_file(str(whole_run.run / "trajectory.tum"))
    paired = sync.associate_trajectories(reference, estimate, max_diff=0.01)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data(paired)
    rmse_m = ape.get_statistic(evo_metrics.StatisticsType.rmse)
    assert whole_run.metrics["ate_rmse_m"]["value"] == pytest.approx(rmse_m, abs=1e-9)
    assert rmse_m < 0.25


def test_the_map_holds_the_obstacles_that_were_there(whole_run, from_obstacle):
    site = synthesize(seed=0, duration_s=0.2, azimuth_steps=8).site
    maps = load_maps(whole_run.run)
    hits = {}
    for each in maps:
        for row, col in np.argwhere(each.occupied):
            cell = tuple(np.rint(each.origin_m / maps.cell_m).astype(int) + np.array([col, row]))
            hits[cell] = hits.get(cell, 0) + 1
    often = np.array([cell for cell, count in hits.items() if count >= 20]) * maps.cell_m + maps.cell_m / 2
    assert len(often) > 50
    distances = np.min([from_obstacle(obstacle, often) for obstacle in site.obstacles], axis=0)
    assert np.mean(distances < 0.4) > 0.9


def test_until_stops_there_and_reports_what_there_is(located_run):
    names = {path.name for path in located_run.run.iterdir() if path.is_file()}
    assert {"fixes.parquet", "poses.parquet", "metrics.json", "run.json", "report.html"} <= names
    assert not {"scans.parquet", "maps.npz", "plans.parquet", "control.parquet"} & names
    assert "uwb_rmse_m" in located_run.metrics
    assert "eta_m" not in located_run.metrics


@pytest.mark.parametrize(
    ("until", "last_file"), [("ingest", "config.toml"), ("filter", "scans.parquet"), ("map", "maps.npz")]
)
def test_every_stage_can_be_the_last(tmp_path, until, last_file, follow_request):
    outcome = replay(follow_request(tmp_path / "run", until=until, duration_s=0.5), Silent())
    assert (outcome.run / last_file).is_file()
    assert (outcome.run / "run.json").is_file()
    assert not (outcome.run / "control.parquet").exists()


def test_control_and_report_know_the_number_of_their_steps(tmp_path, follow_request, fixtures):
    steps, totals = [], {}

    class Counting(Silent):
        def begin(self, stage, total):
            steps.append(stage)
            totals[stage] = total

        def advance(self, recorded_s=None):
            steps.append(steps[-1])

    config = load_config(fixtures / "follow.toml", ["simulation.controller=kinematic"], {})
    replay(replace(follow_request(tmp_path / "run", duration_s=0.5), config=config), Counting())
    for stage in ("control", "report"):
        assert steps.count(stage) - 1 == totals[stage] > 1


def test_start_and_duration_cut_the_recording(tmp_path, follow_request):
    outcome = replay(follow_request(tmp_path / "run", start_s=2.0, duration_s=1.0, until="filter"), Silent())
    whole_ns = 1_767_225_600_000_000_000
    for name in ("scans", "poses", "ranges"):
        t_s = (table(outcome.run, name)["t_ns"] - whole_ns) * 1e-9
        assert t_s.min() >= 2.0 - 1e-6
        assert t_s.max() < 3.0 + 1e-6
    assert len(table(outcome.run, "scans")["t_ns"]) == 10


def test_an_existing_run_is_refused_resumed_or_replaced(tmp_path, follow_request, fixtures):
    request = follow_request(tmp_path / "run", until="position", duration_s=0.5)
    first = replay(request, Silent())
    with pytest.raises(AlreadyExists, match="--force"):
        replay(request, Silent())

    before = (first.run / "run.json").stat().st_mtime_ns
    resumed = replay(replace(request, existing=Existing.RESUME), Silent())
    assert resumed.metrics == first.metrics
    assert (first.run / "run.json").stat().st_mtime_ns == before

    changed = replace(request, config=load_config(fixtures / "follow.toml", ["uwb.smooth=false"], {}))
    assert finished_outcome(changed) is None
    replay(replace(changed, existing=Existing.RESUME), Silent())
    assert not tomllib.loads((first.run / "config.toml").read_text())["uwb"]["smooth"]
    replay(replace(request, existing=Existing.FORCE), Silent())
    assert tomllib.loads((first.run / "config.toml").read_text())["uwb"]["smooth"]


def test_a_resumed_run_holds_nothing_of_another_one(tmp_path, short_run, follow_request):
    run = Path(shutil.copytree(short_run.run, tmp_path / "run"))
    assert (run / "plots" / "tracking_error.png").exists()
    shorter = follow_request(run, duration_s=0.4, until="position")
    resumed = replay(replace(shorter, existing=Existing.RESUME), Silent())
    assert "eta_m" not in resumed.metrics
    assert not (run / "control.parquet").exists()
    assert not (run / "plots" / "tracking_error.png").exists()


def test_a_run_with_unset_values_in_its_config_is_recognised(tmp_path, follow_request, fixtures):
    config = load_config(fixtures / "follow.toml", ["uwb.tags=[{id=0, role='robot'}, {id=1, role='person'}]"], {})
    request = replace(follow_request(tmp_path / "run", duration_s=0.5, until="position"), config=config)
    replay(request, Silent())
    assert finished_outcome(request) is not None


def test_a_replay_that_cannot_work_harms_no_earlier_run(tmp_path, follow_request, fixtures):
    request = follow_request(tmp_path / "run", duration_s=0.5, until="position")
    first = replay(request, Silent())
    nothing = replace(request, options=replace(request.options, start_s=100.0), existing=Existing.FORCE)
    with pytest.raises(EmptyWindow, match=r"lasts 12\.0 s"):
        replay(nothing, Silent())
    assert finished_outcome(request).metrics == first.metrics


def test_a_target_by_uwb_beside_a_robot_by_odometry(tmp_path, follow_request, fixtures):
    config = load_config(fixtures / "follow.toml", ["topics.position=odometry", "topics.target=uwb"], {})
    request = replace(follow_request(tmp_path / "run", until="position"), config=config)
    outcome = replay(request, Silent())
    assert set(table(outcome.run, "target")["source"]) == {"uwb"}
    assert set(table(outcome.run, "poses")["source"]) == {"odometry"}
    # Odometry is in its own frame: its distance to a truth in map would be a wrong number.
    assert "ate_rmse_m" not in outcome.metrics
    assert "rpe_rmse_m" in outcome.metrics


def test_what_a_causal_run_says_of_the_past_does_not_depend_on_the_future(tmp_path, follow_request, fixtures):
    config = load_config(fixtures / "follow.toml", ["uwb.smooth=false", "uwb.calibrate=false"], {})
    short, long = (
        replay(replace(follow_request(tmp_path / str(s), until="position", duration_s=s), config=config), Silent())
        for s in (1.5, 3.0)
    )
    early, late = table(short.run, "poses"), table(long.run, "poses")
    count = len(early["t_ns"]) - 2
    for name in ("x_m", "y_m", "yaw_rad"):
        np.testing.assert_allclose(early[name][:count], late[name][:count], atol=1e-9)


def test_anchors_at_wrong_places_are_named(tmp_path, follow_request):
    """Silence where they are right; two that are swapped; one that is displaced by a metre."""
    request = follow_request(tmp_path, until="position", duration_s=12.0)
    right = request.config.uwb.anchors
    swapped = [right[0], right[1].model_copy(update={"id": 2}), right[2].model_copy(update={"id": 1}), right[3]]
    displaced = [*right[:2], right[2].model_copy(update={"x_m": 18.4, "y_m": 15.4}), right[3]]
    said = []
    for k, anchors in enumerate((right, swapped, displaced)):
        uwb = request.config.uwb.model_copy(update={"anchors": anchors})
        config = request.config.model_copy(update={"uwb": uwb})
        replay(replace(request, run=tmp_path / str(k), config=config), kept := Kept())
        said.append([line for line in kept.lines if "[[uwb.anchors]]" in line])
    assert said[0] == []
    assert any("anchors 2 and 1 seem to be swapped" in line for line in said[1])
    assert any("to tag 0 count as NLOS" in line for line in said[1])
    assert len(said[2]) == 1
    assert "anchor 2 seems to stand at x_m = 17.5" in said[2][0]


def test_a_wall_taken_for_the_ground_is_told_and_is_no_ground(tmp_path, follow_request, fixtures):
    """By the paper's method only: quadlog's own takes none."""
    config = load_config(fixtures / "follow.toml", [], {}, preset="paper")
    paper = replay(replace(follow_request(tmp_path / "run", until="map"), config=config), Silent())
    record = json.loads((paper.run / "run.json").read_text())
    steep = record["counts"]["scans_with_steep_ground"]
    scans = table(paper.run, "scans")
    assert steep == (scans["ground_nz"] < np.cos(np.radians(45))).sum() > 0
    assert any(f"{steep} of {record['counts']['scans']} scans" in text for text in record["warnings"])
    height_m = np.load(paper.run / "ground.npz")["height_m"]
    assert np.nanpercentile(np.abs(height_m), 99) < 0.4  # walls of 1.5 m and more, when they are counted as ground


def test_no_wall_is_taken_for_the_ground_and_the_scans_say_how_they_were_seen(whole_run):
    record = json.loads((whole_run.run / "run.json").read_text())
    assert "scans_with_steep_ground" not in record["counts"]
    assert "120 of 120 scans classified by beams, from the points' ring numbers" in record["notes"]
    assert any(note.startswith("tag 0: velocities by odometry steady its track") for note in record["notes"])
    scans = table(whole_run.run, "scans")
    assert scans["ground_nz"].min() > np.cos(np.radians(5))


def test_what_was_seen_stays_in_the_map_until_it_is_seen_through(tmp_path, follow_request, fixtures):
    """Without memory cells flicker from scan to scan; with it few of those that were there are gone the next time."""
    kept = {}
    for memory in ("log_odds", "scan"):
        config = load_config(fixtures / "follow.toml", [f"grid.memory={memory}"], {})
        run = replay(replace(follow_request(tmp_path / memory, until="map", duration_s=2.0), config=config), Silent())
        maps = list(load_maps(run.run))
        pairs = [(a, b) for a, b in pairwise(maps) if (a.origin_m == b.origin_m).all()]
        kept[memory] = np.mean([(a.occupied & b.occupied).sum() / a.occupied.sum() for a, b in pairs])
    assert kept["log_odds"] > 0.9 > kept["scan"]


def test_choices_that_decided_the_result_stand_in_run_json_and_on_the_page(short_run):
    record = json.loads((short_run.run / "run.json").read_text())
    assert "robot position from uwb, target from uwb" in record["notes"]
    assert any(note.startswith(("heading from imu", "heading from odometry")) for note in record["notes"])
    assert "robot position from uwb, target from uwb" in (short_run.run / "report.html").read_text()


def test_topics_in_run_json_are_those_that_were_used(tmp_path, follow_request, fixtures):
    config = load_config(fixtures / "follow.toml", ["topics.position=odometry", "topics.target=ahead"], {})
    request = replace(follow_request(tmp_path / "run", until="position", duration_s=0.5), config=config)
    record = json.loads((replay(request, Silent()).run / "run.json").read_text())
    assert {topic["role"] for topic in record["topics"]} == {"odometry", "reference"}


def test_a_recording_without_the_chosen_source_says_so_before_anything_is_removed(tmp_path, follow_request, fixtures):
    request = follow_request(tmp_path / "run", duration_s=0.5)
    config = load_config(fixtures / "follow.toml", ["topics.position=tf"], {})
    with pytest.raises(MissingInput, match=r"topics\.position = 'tf'"):
        replay(replace(request, config=config), Silent())
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("position", "target", "source"),
    [("odometry", "ahead", "odometry"), ("fixed", "fixed", "fixed"), ("uwb", "/truth/person/pose", "uwb")],
)
def test_other_sources_of_position_and_target(tmp_path, position, target, source, follow_request, fixtures):
    overrides = [f"topics.position={position}", f"topics.target={target}", "topics.target_x_m=3.0"]
    config = load_config(fixtures / "follow.toml", overrides, {})
    request = replace(follow_request(tmp_path / "run", duration_s=1.0), config=config)
    outcome = replay(request, Silent())
    poses, targets = table(outcome.run, "poses"), table(outcome.run, "target")
    assert set(poses["source"]) == {source}
    assert set(targets["source"]) == {target}
    assert table(outcome.run, "plans")["found"].any()


def test_position_from_a_tum_file(short_run, tmp_path, follow_request, fixtures):
    config = load_config(fixtures / "follow.toml", [f"topics.position={short_run.run / 'trajectory.tum'}"], {})
    request = replace(follow_request(tmp_path / "run", until="position"), config=config)
    outcome = replay(request, Silent())
    assert set(table(outcome.run, "poses")["source"]) == {"file"}
    same = np.allclose(table(outcome.run, "poses")["x_m"], table(short_run.run, "poses")["x_m"], atol=1e-6)
    assert same


def test_a_causal_run_differs_from_a_smoothed_one(short_run, tmp_path, follow_request, fixtures):
    config = load_config(fixtures / "follow.toml", ["uwb.smooth=false"], {})
    outcome = replay(replace(follow_request(tmp_path / "run", until="position"), config=config), Silent())
    smoothed, causal = (table(run, "poses")["x_m"] for run in (short_run.run, outcome.run))
    assert len(smoothed) == len(causal)
    assert not np.allclose(smoothed, causal, atol=1e-3)


def test_log_stamps_shift_the_scans_by_their_latency(tmp_path, follow_request):
    header = replay(follow_request(tmp_path / "header", until="filter", duration_s=1.0), Silent())
    log = replay(follow_request(tmp_path / "log", until="filter", duration_s=1.0, stamp="log"), Silent())
    first = [table(each.run, "scans")["t_ns"][0] for each in (header, log)]
    assert 0 < (first[1] - first[0]) * 1e-9 < 0.2


def test_a_truncated_recording_is_replayed_as_far_as_it_goes(tmp_path, fixtures):
    damaged = tmp_path / "follow.mcap"
    damaged.write_bytes((fixtures / "follow.mcap").read_bytes()[:2_500_000])
    config = load_config(fixtures / "follow.toml", environ={})
    request = ReplayRequest(damaged, tmp_path / "run", config, ReplayOptions(until="map"), plots=False)
    kept = Kept()
    outcome = replay(request, kept)
    assert outcome.exit_code == 3
    assert any(line.startswith("lost: ") for line in kept.lines)
    assert "truncated" in json.loads((outcome.run / "run.json").read_text())["losses"][0]["cause"]
    assert 5 < len(table(outcome.run, "scans")["t_ns"]) < 60
